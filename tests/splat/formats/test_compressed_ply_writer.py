"""Writer of SuperSplat's compressed .ply: the reader gets everything back within half a step."""

import numpy as np
import pytest
import torch

from gva_mi.splat.formats.compressed_ply import CHUNK
from gva_mi.splat.formats.compressed_ply_writer import save_compressed_ply
from gva_mi.splat.formats.ply import load_ply
from gva_mi.splat.formats.ply_elements import read_elements
from gva_mi.splat.gaussians import Gaussians

C0 = 0.28209479177387814


def cloud(count, coefficients, seed=0):
    """Make random Gaussians."""
    draw = torch.Generator().manual_seed(seed)
    normal = lambda *shape: torch.randn(*shape, generator=draw)
    return Gaussians(
        means=normal(count, 3) * torch.tensor([3.0, 1.0, 0.1]),
        quats=normal(count, 4) * 3,
        scales=torch.exp(normal(count, 3) - 4),
        opacities=torch.rand(count, generator=draw),
        sh=torch.cat([normal(count, 1, 3), normal(count, coefficients - 1, 3)], dim=1),
    )


def matched(given, tmp_path):
    """Write and read; return what was read, the order of what was given, chunks and extents."""
    path = tmp_path / "a.compressed.ply"
    save_compressed_ply(path, given)
    found, chunk = load_ply(path), read_elements(path)["chunk"]
    assert len(found) == len(given) and len(chunk) == -(-len(given) // CHUNK)
    low, high = (torch.from_numpy(np.stack([chunk[e + a] for a in "xyz"], 1)) for e in
                 ("min_", "max_"))  # fmt: skip
    # Nearest by place and colour, which differ by much more than they are rounded.
    key = lambda g: torch.cat([g.means, g.sh[:, 0]], dim=1).double()
    order = torch.cdist(key(given), key(found)).argmin(1)
    assert len(order.unique()) == len(given)
    return found, order, chunk[order.numpy() // CHUNK], (high - low)[order // CHUNK]


@pytest.mark.parametrize("coefficients", [1, 16])
def test_all_comes_back_within_half_a_step(coefficients, tmp_path):
    given = cloud(700, coefficients)
    found, order, chunk, extent = matched(given, tmp_path)
    steps = torch.tensor([2047.0, 1023.0, 2047.0])
    off = (found.means[order] - given.means).abs()
    assert (off <= 0.5 * extent / steps + 1e-6).all()
    spread = lambda kind, axes: torch.from_numpy(
        np.stack([chunk[f"max_{kind}{a}"] - chunk[f"min_{kind}{a}"] for a in axes], 1)
    )
    off = (found.scales[order].log() - given.scales.log()).abs()
    assert (off <= 0.5 * spread("scale_", "xyz") / steps + 1e-5).all()
    off = (found.sh[order, 0] - given.sh[:, 0]).abs() * C0
    assert (off <= 0.5 * spread("", "rgb") / 255 + 1e-6).all()
    assert (found.opacities[order] - given.opacities).abs().max() <= 0.5 / 255 + 1e-6
    unit = torch.nn.functional.normalize(given.quats)
    unit = unit * torch.sign((unit * found.quats[order]).sum(1, keepdim=True))
    off = (found.quats[order] - unit).abs()
    stored = torch.ones_like(off).scatter_(1, unit.abs().argmax(1, keepdim=True), 0).bool()
    assert off[stored].max() <= 0.5 * 2 * 0.5**0.5 / 1023 + 1e-6
    rest = given.sh[:, 1:].clamp(-4, 4)  # beyond, they are cut off
    assert ((found.sh[order, 1:] - rest).abs() <= 1 / 32 + 1e-6).all()


def test_chunks_hold_neighbours(tmp_path):
    given = cloud(4096, 1)
    path = tmp_path / "a.ply"
    save_compressed_ply(path, given)
    chunk = read_elements(path)["chunk"]
    whole = (given.means.amax(0) - given.means.amin(0)).prod()
    volume = np.prod([chunk[f"max_{a}"] - chunk[f"min_{a}"] for a in "xyz"], axis=0)
    assert np.median(volume) < float(whole) / 8
    again = path.read_bytes()
    save_compressed_ply(path, given)
    assert path.read_bytes() == again
