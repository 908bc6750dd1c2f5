"""Laws of all formats alike: plain colours, covariances, no Gaussians, axes, NaN and infinity."""

from dataclasses import replace

import pytest
import torch

from gva_mi import InputError
from gva_mi.splat import Gaussians, reference
from gva_mi.splat.axes import matrices
from gva_mi.splat.formats import LOAD
from gva_mi.splat.formats.ply import load_ply, save_ply
from gva_mi.splat.formats.spz import load_splat, load_spz, save_splat, save_spz
from gva_mi.splat.formats.stored import finite_ones, with_degree
from gva_mi.splat.kernels.sh import C0

FORMATS = {
    "ply": (save_ply, load_ply), "splat": (save_splat, load_splat), "spz": (save_spz, load_spz),
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


@pytest.mark.parametrize("name", FORMATS)
def test_axes_are_the_same_in_all_formats(tmp_path, name):
    """Places and directions of one flat Gaussian, oblique to all axes."""
    root = torch.tensor([[0.2, 0, 0], [0.1, 0.05, 0], [-0.06, 0.03, 0.01]])
    covars = (root @ root.T)[*torch.triu_indices(3, 3)][None]
    means = torch.tensor([[0.25, -0.5, 0.75]])
    save, load = FORMATS[name]
    save(
        tmp_path / "a", Gaussians(means, None, None, torch.ones(1), torch.ones(1, 3), covars=covars)
    )
    found = load(tmp_path / "a")
    assert torch.allclose(found.means, means, atol=1e-5)
    R = reference.rotation(found.quats[0])
    covariance = R @ torch.diag(found.scales[0].square()) @ R.T
    exact = matrices(covars)[0]
    assert (covariance - exact).abs().max() < 0.08 * exact.abs().max()  # spz: scales to 3.2 %
    assert (covariance - exact).abs().max() < 0.4 * exact[0, 1].abs()  # so that signs are seen


@pytest.mark.parametrize("name", FORMATS)
def test_numbers_that_are_not_finite_are_refused_or_left_out(tmp_path, name):
    """No writer makes a number of NaN; the file that was there stays."""
    save, load = FORMATS[name]
    good = load_given(4)
    for field, value in (("means", torch.nan), ("quats", torch.inf), ("scales", -torch.inf),
                         ("opacities", torch.nan), ("sh", torch.nan), ("means", 1e39),
                         ("quats", torch.zeros(4))):  # fmt: skip
        array = getattr(good, field).double().clone()
        array[2].view(-1)[-1 if isinstance(value, float) else slice(4)] = value
        bad = replace(good, **{field: array})
        (tmp_path / "a").write_text("older")
        with pytest.raises(InputError, match="a: 1 of 4 Gaussians hold NaN .* number 2; expected"):
            save(tmp_path / "a", bad)
        assert (tmp_path / "a").read_text() == "older"
        save(tmp_path / "a", finite_ones(tmp_path, bad))
        assert len(load(tmp_path / "a")) == 3
    with pytest.raises(InputError, match="all 4 Gaussians hold NaN"):
        finite_ones(tmp_path, replace(good, opacities=torch.full((4,), torch.nan)))
    assert finite_ones(tmp_path, good) is good


def load_given(count):
    g = with_degree(diagonal(count), 1)
    unit = torch.tensor([1.0, 0, 0, 0]).repeat(count, 1)
    return replace(g, quats=unit, scales=g.covars[:, [0, 3, 5]].sqrt(), covars=None)


@pytest.mark.parametrize("suffix", LOAD)
def test_a_pointer_of_git_is_named(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    with pytest.raises(InputError, match="a Git LFS pointer instead of the file: git lfs pull"):
        LOAD[suffix](path)
