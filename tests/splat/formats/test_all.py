"""Laws of all formats alike: plain colours, no Gaussians, and Gaussians given by covariances."""

import pytest
import torch

from gva_mi.splat import Gaussians
from gva_mi.splat.formats.compressed_ply_writer import save_compressed_ply
from gva_mi.splat.formats.ply import load_ply, save_ply
from gva_mi.splat.formats.splat import load_splat, save_splat
from gva_mi.splat.formats.spz import load_spz, save_spz
from gva_mi.splat.kernels.sh import C0

FORMATS = {
    "ply": (save_ply, load_ply), "compressed ply": (save_compressed_ply, load_ply),
    "splat": (save_splat, load_splat), "spz": (save_spz, load_spz),
}  # fmt: skip


def diagonal(count):
    """Gaussians of distinct colours, given by diagonal covariances."""
    draw = lambda *size: torch.rand(count, *size, generator=torch.Generator().manual_seed(0))
    covars = torch.zeros(count, 6)
    covars[:, [0, 3, 5]] = (0.01 + 0.02 * draw(3)) ** 2
    return Gaussians(draw(3), None, None, 0.1 + 0.8 * draw(), colors=draw(3), covars=covars)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("count", [0, 1, 50])
def test_plain_colours_and_covariances_come_back(tmp_path, name, count):
    save, load = FORMATS[name]
    given = diagonal(count)
    save(tmp_path / "a", given)
    assert [file.name for file in tmp_path.iterdir()] == ["a"]
    found = load(tmp_path / "a")
    assert len(found) == count
    if not count:
        return
    colors = found.colors if found.sh is None else found.sh[:, 0] * C0 + 0.5
    nearest = torch.cdist(given.means, found.means).argmin(1)
    assert (colors[nearest] - given.colors).abs().max() < 0.005
    assert (found.opacities[nearest] - given.opacities).abs().max() < 0.005
    exact = given.covars[:, [0, 3, 5]].sqrt().sort(dim=1).values
    scales = found.scales[nearest].sort(dim=1).values
    assert (scales / exact).log().abs().max() < 0.04
