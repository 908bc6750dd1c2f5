"""Every benchmark runs at a tiny size; times themselves are not tested."""

import importlib.util
import itertools
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
DEMO_STEPS = ("make_subject", "refine", "fit", "evaluate")
TINY = {"splat": {"gaussians": 300, "size": 64}, "fit": {"gaussians": 300, "size": 32}}


@pytest.fixture(autouse=True)
def checkout(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


@pytest.mark.parametrize("name", TINY)
def test_a_benchmark_runs(name):
    tables = list(import_module(f"benchmarks.{name}").run(1, **TINY[name]))
    assert tables
    for table in tables:
        assert table.rows and len(str(table).splitlines()) == 2 + len(table.rows)
        times = [v for row in table.rows for k, v in row.items() if k.endswith(("ms", "min s"))]
        assert all(time > 0 for time in times)


@pytest.mark.slow
def test_the_steps_of_a_command_have_wall_and_cpu_times():
    """Of the demo, at the size of its own test; the tables before it are those of others."""
    table, pipeline = import_module("benchmarks.table"), import_module("gva_mi.app.pipeline")
    demo = pipeline.DemoOptions(frames=6, size=64, steps=4)
    sizes = table.Sizes(gaussians=(300,), pixels=32, demo=demo)
    *_, steps = itertools.islice(table.run(1, None, sizes), 4)
    assert [row["step"] for row in steps.rows] == [*DEMO_STEPS, "all"]
    *parts, whole = (row["CPU s"] for row in steps.rows)
    assert min(parts) > 0 and sum(parts) == pytest.approx(whole, rel=0.1)


def test_growth_counts_the_pairs_and_restores_the_count_of_threads(monkeypatch):
    growth, before = import_module("benchmarks.growth"), dr.thread_count()
    monkeypatch.setattr(growth, "GAUSSIAN_COUNTS", (40,))
    monkeypatch.setattr(growth, "PICTURE_WIDTHS", ())
    monkeypatch.setattr(growth, "THREAD_SCENES", ((300, 48),))
    monkeypatch.setattr(growth, "_wide", lambda scene, width: scene)
    small = lambda n, size: person_scene(np.random.default_rng(0), min(n, 300), 48)
    monkeypatch.setattr(growth, "person", small)
    larger, threads = growth.run(1)
    few, many = larger.rows
    assert 0 < few["pairs"] < many["pairs"]
    assert few["ns a pair"] == pytest.approx(1e6 * few["min ms"] / few["pairs"])
    assert threads.rows[0]["1 thread, min ms"] > 0 and dr.thread_count() == before


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
    out = cli.works("bench", "splat", "--repeats", 1, "--scene", scene_file)
    assert out.startswith("renderer, 8 Gaussians") and "composite, adjoint" in out
    assert "an option of bench splat" in cli.fails("bench", "fit", "--scene", scene_file)
    monkeypatch.setattr("gva_mi.cli.gradcheck.CHECKOUT", tmp_path)
    err = cli.fails("bench", "fit")
    assert "in the repository" in err and "python -m gva_mi bench fit" in err


@pytest.fixture
def scene_file(tmp_path):
    return few_gaussians(tmp_path / "scene.ply")
