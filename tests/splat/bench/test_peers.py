"""A peer is timed where it draws our picture; what is missing for one is said in a sentence."""

import importlib.util
import math
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch.utils import cpp_extension

from gva_mi.errors import InputError
from gva_mi.splat import render
from gva_mi.splat.bench import BenchOptions, gsplat_peer, opensplat_peer, peers
from gva_mi.splat.bench.machine import Limits
from gva_mi.splat.bench.peers import OURS, SAME, Comparison, beside, measure_peers

LIMITS = Limits(gflops=100.0, gigabytes=10.0, threads=1)


def alike(scene):
    """A peer that draws what we do."""
    return lambda: render(scene.gaussians, scene.camera, scene.options, scene.background).color


def shifted(scene):
    """One whose pixels have their centres somewhere else."""
    camera = scene.camera.cropped(1, 1, scene.camera.width, scene.camera.height)
    return alike(replace(scene, camera=camera))


def misled(scene):
    """One whose picture is right, and whose gradient by the scales is half of what it should be."""
    g = scene.gaussians
    halved = lambda: replace(g, scales=0.5 * (g.scales + g.scales.detach()))
    return lambda: alike(replace(scene, gaussians=halved()))()


def test_a_peer_with_our_picture_is_timed(work):
    found = beside("alike", alike, work, 3)
    assert found.psnr > 100 and found.gaussians == 300
    assert set(found.gradients) == {"means", "quats", "scales", "opacities", "sh"}
    assert max(found.gradients.values()) == 0
    assert found.ratio_least == found.time.least / found.ours.least > 0 and found.ratio > 0
    assert "alike" in found.row() and "not timed" not in found.row()


def test_a_peer_with_another_picture_is_not_timed(work):
    found = beside("shifted", shifted, work, 3)
    assert found.psnr < SAME and found.time is None and found.ratio is None
    assert f"another picture, below {SAME:.0f} dB: not timed" in found.row()
    assert f"{found.psnr:.1f}" in found.row()


def test_gradients_that_differ_are_told(work):
    found = beside("misled", misled, work, 2)
    assert found.gradients["scales"] == pytest.approx(0.5, rel=1e-4)
    assert found.gradients["means"] == 0 and found.time is not None
    assert "5.0e-01 scales" in found.row()


def test_a_comparison_as_table_and_plot(work, tmp_path):
    scenes = [lambda: work.scene]
    named = {"alike": alike, "shifted": shifted}
    compared = Comparison.of(list(measure_peers(named, scenes, 2, LIMITS)))
    assert [found.peer for found in compared.found] == ["alike", "shifted"]
    (bounds,) = compared.bounds
    assert bounds.gaussians == 300 and bounds.operations > 0 and bounds.memory > 0
    # bounds are work over limits: of half the machine, twice the time
    half = replace(LIMITS, gflops=50.0, gigabytes=5.0)
    ((_, slower),) = measure_peers({}, scenes, 2, half)
    assert slower.operations == pytest.approx(2 * bounds.operations)
    assert slower.memory == pytest.approx(2 * bounds.memory)
    table = compared.table()
    assert "alike" in table and "not timed" in table and f"{bounds.memory:.2f}" in table
    lines = compared.lines()
    assert set(lines) == {OURS, "alike"} and lines[OURS][0][0] == 300
    assert all(ms > 0 and math.isfinite(ms) for points in lines.values() for _, ms in points)
    compared.draw(tmp_path / "new" / "peers.png")
    assert (tmp_path / "new" / "peers.png").read_bytes().startswith(b"\x89PNG")


def test_what_a_peer_needs_is_said(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="needs --opensplat-sources DIR, a folder of its sources"):
        peers.load(["opensplat"], None)
    with pytest.raises(InputError, match=f"{tmp_path} holds no project_gaussians.cpp: expected"):
        peers.load(["opensplat"], tmp_path)
    monkeypatch.setattr(gsplat_peer, "installed", lambda: False)
    with pytest.raises(InputError, match="needs the package gsplat, which is not installed"):
        peers.load(["gsplat"], None)
    with pytest.raises(InputError, match="--plot is for --against, not given"):
        BenchOptions(plot=Path("peers.png"))
    with pytest.raises(InputError, match="--opensplat-sources is for --against, not given"):
        BenchOptions(opensplat_sources=tmp_path)
    with pytest.raises(InputError, match="--plot must end in .png or .svg or .pdf, got peers.xyz"):
        BenchOptions(against=("gsplat",), plot=Path("peers.xyz"))


def test_what_compiling_needs_is_said(tmp_path, monkeypatch):
    source = tmp_path / "broken.cpp"
    source.write_text("#error this is broken\n")
    monkeypatch.setenv("TORCH_EXTENSIONS_DIR", str(tmp_path))
    monkeypatch.setattr(cpp_extension, "is_ninja_available", lambda: False)
    monkeypatch.setattr(cpp_extension, "get_cxx_compiler", lambda: "no-compiler")
    with pytest.raises(InputError, match="needs a C.. compiler, and no-compiler is not there"):
        opensplat_peer.compiled("broken", [source], [])
    monkeypatch.setattr(cpp_extension, "get_cxx_compiler", lambda: "python3")
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    with pytest.raises(InputError, match="needs ninja to compile: pip install ninja"):
        opensplat_peer.compiled("broken", [source], [])


def can_compile():
    return shutil.which(cpp_extension.get_cxx_compiler()) and cpp_extension.is_ninja_available()


@pytest.mark.skipif(not can_compile(), reason="no C++ compiler or no ninja")
def test_sources_that_do_not_compile(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_EXTENSIONS_DIR", str(tmp_path))
    source = tmp_path / "broken.cpp"
    source.write_text("#error this is broken\n")
    with pytest.raises(InputError, match="do not compile here: .*this is broken"):
        opensplat_peer.compiled("gva_mi_broken", [source], [])


@pytest.mark.slow
@pytest.mark.skipif(not can_compile(), reason="no C++ compiler or no ninja")
def test_a_program_that_stands_in_for_opensplat(tmp_path, monkeypatch, work):
    """Its functions by name, with their arguments; its picture is empty, and so it is not timed."""
    monkeypatch.setenv("TORCH_EXTENSIONS_DIR", str(tmp_path))
    stand_in(tmp_path / "sources")
    peer = opensplat_peer.load(tmp_path / "sources")
    picture = peer(work.scene)()
    assert picture.shape == work.weights.shape
    torch.testing.assert_close(picture[0, 0], work.scene.background.detach() + 0 * picture[0, 0])
    found = beside("opensplat", peer, work, 2)
    assert found.time is None and found.psnr < SAME


def stand_in(folder):
    """What the binding calls, of nothing: a picture of the background."""
    for name in opensplat_peer.SOURCES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("")
    means, size = "torch::Tensor", "int h, int w"
    (folder / "project_gaussians.hpp").write_text(
        f"""#pragma once
        struct ProjectGaussiansCPU {{
          static std::vector<torch::Tensor> apply({means} m, {means} s, float g, {means} q,
              {means} v, {means} p, float fx, float fy, float cx, float cy, {size}) {{
            return {{m + s + q.sum(1, true), m, m, m, m.index({{"...", 2}})}};
          }}
        }};"""
    )
    (folder / "spherical_harmonics.hpp").write_text(
        f"""#pragma once
        inline int degFromSh(int n) {{ return 3; }}
        struct SphericalHarmonicsCPU {{
          static {means} apply(int degree, {means} d, {means} sh) {{ return sh.sum(1); }}
        }};"""
    )
    (folder / "rasterize_gaussians.hpp").write_text(
        f"""#pragma once
        struct RasterizeGaussiansCPU {{
          static {means} apply({means} x, {means} r, {means} conics, {means} colors, {means} o,
              {means} cov, {means} depths, {size}, {means} behind) {{
            TORCH_CHECK(depths.is_contiguous());
            auto used = x.sum() + colors.sum() + o.sum();
            return behind.expand({{h, w, 3}}) + 0 * used;
          }}
        }};"""
    )


@pytest.mark.skipif(importlib.util.find_spec("gsplat") is None, reason="gsplat is not installed")
def test_gsplats_own_reference_draws_our_picture(work):
    found = beside("gsplat", gsplat_peer.drawing, work, 2)
    assert found.psnr > 80 and max(found.gradients.values()) < 1e-2
