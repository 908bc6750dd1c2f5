"""Every benchmark runs at a tiny size; times themselves are not tested."""

import importlib.util
import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import drjit as dr
import numpy as np
import pytest
import torch
from samples.scenes import few_gaussians

from gva_mi.splat import render
from gva_mi.splat.scene import person_scene

ROOT = Path(__file__).parents[2]
TINY = {
    "splat": {"gaussians": 300, "size": 64, "growth": False},
    "fit": {"gaussians": 300, "size": 32},
    "mesh": {"sizes": (48,)},
    "viewer": {"gaussians": 300},
}


@pytest.fixture(autouse=True)
def checkout(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


@pytest.mark.parametrize("name", TINY)
def test_a_benchmark_runs(name):
    tables = list(import_module(f"benchmarks.{name}").run(1, 0, **TINY[name]))
    assert tables
    for table in tables:
        assert table.rows and len(str(table).splitlines()) == 2 + len(table.rows)
        times = [v for row in table.rows for k, v in row.items() if k.endswith(("ms", "min s"))]
        assert all(time > 0 for time in times)


def test_growth_counts_the_pairs_of_a_picture(monkeypatch):
    splat = import_module("benchmarks.splat")
    monkeypatch.setattr(splat, "COUNTS", (40,))
    monkeypatch.setattr(splat, "WIDTHS", ())
    monkeypatch.setattr(splat, "_wide", lambda scene, width: scene)
    twice = lambda n, size: person_scene(np.random.default_rng(0), min(n, 300), 48)
    few, many = splat._growth(twice, 1).rows
    assert 0 < few["pairs"] < many["pairs"]
    assert few["both ns a pair"] == pytest.approx(1e6 * few["both min ms"] / few["pairs"])


def test_a_picture_of_a_step_adds_its_stages_up(tmp_path):
    bars = import_module("benchmarks.step_picture")
    times = {"pose": 1.0, "splatting": 4.0, f"{bars.LOSS}, with VGG": 8.0}
    times[f"{bars.LOSS}, without"] = 2.0
    rows = [{"": name, "min ms": ms} for name, ms in times.items()]
    (tmp_path / "a.json").write_text(json.dumps([{"title": "a step", "rows": rows}]))
    found = bars.stages_of(tmp_path / "a.json")
    assert found[bars.LOSS] == 8 / 4 + 2 * 3 / 4 and sum(found.values()) == 8.5
    bars.draw({"a": tmp_path / "a.json"}, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_the_count_of_threads_is_restored(monkeypatch):
    splat, before = import_module("benchmarks.splat"), dr.thread_count()
    monkeypatch.setattr(splat, "SHARED", ((300, 48),))
    table = splat.more_threads(lambda n, size: person_scene(np.random.default_rng(0), n, size), 1)
    assert table.rows[0]["1 thread, min ms"] > 0
    assert dr.thread_count() == before


def test_a_renderer_with_another_image_is_not_timed():
    compare = import_module("benchmarks.gsplat_reference").compare
    person = person_scene(np.random.default_rng(0), 300, 48).to(torch.float32)
    draw = lambda s: render(s.gaussians, s.camera, s.options, s.background).color
    same = compare(person, 2, lambda: draw(person))
    assert [row[""] for row in same.rows] == ["ours", "gsplat"] and same.rows[0]["ratio"] == 1
    shifted = replace(person, camera=person.camera.cropped(1, 1, 48, 48))
    other = compare(person, 2, lambda: draw(shifted))
    assert "is not timed" in other.title and "ratio" not in other.rows[0]


@pytest.mark.skipif(importlib.util.find_spec("gsplat") is None, reason="gsplat is not installed")
def test_gsplats_reference_draws_our_picture():
    compare = import_module("benchmarks.gsplat_reference").compare
    person = person_scene(np.random.default_rng(0), 300, 48).to(torch.float32)
    assert compare(person, 2).rows[1]["ratio"] > 0


def test_the_command_runs_the_benchmarks_of_a_checkout(cli, monkeypatch, tmp_path, scene_file):
    out = cli.works(
        "bench", "splat", "--repeats", 1, "--no-growth", "--scene", scene_file,
        "--json", tmp_path / "figures.json",
    )  # fmt: skip
    assert "composite, adjoint" in out
    titles = [table["title"] for table in json.loads((tmp_path / "figures.json").read_text())]
    assert titles[0].startswith("renderer, 8 Gaussians")
    assert "options of bench splat" in cli.fails("bench", "mesh", "--no-growth")
    monkeypatch.setattr("gva_mi.cli.bench.CHECKOUT", tmp_path)
    err = cli.fails("bench", "fit")
    assert "in the repository" in err and "python -m benchmarks fit" in err


@pytest.fixture
def scene_file(tmp_path):
    return few_gaussians(tmp_path / "scene.npz")
