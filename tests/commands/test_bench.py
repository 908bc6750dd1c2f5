"""``gva-mi bench``: what it writes."""

import importlib
import json

import pytest

from gva_mi.body.bench import FRAMES, bench_body
from gva_mi.commands.bench import bench
from gva_mi.errors import InputError
from gva_mi.fit.bench import bench_fit
from gva_mi.splat.bench import BenchOptions
from gva_mi.viewer.bench import bench_viewer


def test_bench_writes_its_figures(scene, tmp_path, capsys):
    few = BenchOptions(repeats=2, calls=2, no_growth=True, no_gsplat=True)
    bench("splat", few, scene=scene, json_file=tmp_path / "new" / "bench.json")
    figures = json.loads((tmp_path / "new" / "bench.json").read_text())
    assert figures["gaussians"] == 8 and figures["growth"] == []
    assert "composite, adjoint" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["splat", "--against", "opensplat"], "needs --opensplat-sources DIR"),
        (["splat", "--against", "opensplat", "--opensplat-sources", "."], "holds no project_gaus"),
        (["splat", "--plot", "peers.png"], "--plot is for --against"),
        (["body", "--against", "gsplat"], "bench body: --against is for splat"),
    ],
)
def test_peers_that_cannot_be_measured_end_in_a_sentence(cli, monkeypatch, tmp_path, words, said):
    monkeypatch.chdir(tmp_path)
    code, _, err = cli("bench", *words)
    last = err.strip().splitlines()[-1]
    assert code == 2 and last.startswith("gva-mi: bench") and said in last


def test_bench_of_the_body_writes_its_figures(monkeypatch, tmp_path, capsys):
    small = lambda repeats, seed: bench_body(repeats, seed, vertices=60)
    monkeypatch.setattr(importlib.import_module("gva_mi.commands.bench"), "bench_body", small)
    bench("body", BenchOptions(repeats=1), json_file=tmp_path / "new" / "body.json")
    figures = json.loads((tmp_path / "new" / "body.json").read_text())
    assert [batch["frames"] for batch in figures["batches"]] == list(FRAMES)
    assert "60 vertices" in capsys.readouterr().out
    with pytest.raises(InputError, match="no --scene"):
        bench("body", BenchOptions(), scene=tmp_path / "scene.npz")


def test_bench_of_a_fit_writes_its_figures(monkeypatch, tmp_path, capsys):
    small = lambda repeats, seed: bench_fit(repeats, seed, gaussians=300, size=32)
    monkeypatch.setattr(importlib.import_module("gva_mi.commands.bench"), "bench_fit", small)
    bench("fit", BenchOptions(repeats=1), json_file=tmp_path / "new" / "fit.json")
    figures = json.loads((tmp_path / "new" / "fit.json").read_text())
    assert figures["gaussians"] == 300 and figures["size"] == 32
    assert 0 < figures["driven"]["least"] < figures["step"]["least"]
    assert figures["reinitialisation"]["least"] > 0
    assert "frames a second" in capsys.readouterr().out


def test_bench_of_a_viewer_writes_its_figures(monkeypatch, tmp_path, capsys):
    small = lambda repeats, seed: bench_viewer(repeats, seed, gaussians=300)
    monkeypatch.setattr(importlib.import_module("gva_mi.commands.bench"), "bench_viewer", small)
    bench("viewer", BenchOptions(repeats=2), json_file=tmp_path / "new" / "viewer.json")
    figures = json.loads((tmp_path / "new" / "viewer.json").read_text())
    assert figures["gaussians"] == 300 and figures["size"] == [640, 360]
    names = [times["name"] for times in figures["updates"]]
    assert names[:2] == ["Gaussians, another pose", "Gaussians, another eye"] and len(names) == 8
    times = {times["name"]: times["least"] for times in figures["updates"]}
    assert 0 < times["mesh, another eye"] < times["mesh, another pose"]
    assert "a second" in capsys.readouterr().out
