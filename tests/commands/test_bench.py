"""``gva-mi bench``: what it writes."""

import json

from gva_mi.commands.bench import bench
from gva_mi.splat.bench import BenchOptions


def test_bench_writes_its_figures(scene, tmp_path, capsys):
    few = BenchOptions(repeats=2, calls=2, no_growth=True, no_gsplat=True)
    bench("splat", few, scene=scene, json_file=tmp_path / "new" / "bench.json")
    figures = json.loads((tmp_path / "new" / "bench.json").read_text())
    assert figures["gaussians"] == 8 and figures["growth"] == []
    assert "composite, adjoint" in capsys.readouterr().out
