"""Laws of all formats: plain colours, covariances, no Gaussians, axes, NaN and infinity."""

from dataclasses import replace

import pytest
import torch
from samples.scenes import some_gaussians

from gva_mi.core.errors import InputError
from gva_mi.splat import Gaussians, reference
from gva_mi.splat.axes import matrices
from gva_mi.splat.formats.ply import load_ply, save_ply
from gva_mi.splat.formats.spz import save_splat, save_spz
from gva_mi.splat.kernels.sh import C0


@pytest.mark.parametrize("count", [0, 1, 50])
def test_plain_colours_and_covariances_come_back(tmp_path, count):
    draw = lambda *size: torch.rand(count, *size, generator=torch.Generator().manual_seed(0))
    covars = torch.zeros(count, 6)
    covars[:, [0, 3, 5]] = (0.01 + 0.02 * draw(3)) ** 2
    colors = draw(3)
    save_ply(tmp_path / "a", Gaussians(draw(3), None, None, 0.1 + 0.8 * draw(), colors=colors,
        covars=covars))  # fmt: skip
    found = load_ply(tmp_path / "a")
    assert len(found) == count
    torch.testing.assert_close(found.sh[:, 0] * C0 + 0.5, colors, atol=1e-5, rtol=0)
    exact = covars[:, [0, 3, 5]].sqrt().sort(dim=1).values
    torch.testing.assert_close(found.scales.sort(dim=1).values, exact, atol=0, rtol=1e-4)


def test_a_flat_gaussian_keeps_its_directions(tmp_path):
    """Oblique to all axes."""
    root = torch.tensor([[0.2, 0, 0], [0.1, 0.05, 0], [-0.06, 0.03, 0.01]])
    covars = (root @ root.T)[*torch.triu_indices(3, 3)][None]
    means = torch.tensor([[0.25, -0.5, 0.75]])
    given = Gaussians(means, None, None, torch.ones(1), torch.ones(1, 3), covars=covars)
    save_ply(tmp_path / "a", given)
    found = load_ply(tmp_path / "a")
    R = reference.rotation(found.quats[0])
    covariance = R @ torch.diag(found.scales[0].square()) @ R.T
    torch.testing.assert_close(covariance, matrices(covars)[0], atol=1e-5, rtol=0)


@pytest.mark.parametrize("save", [save_ply, save_splat, save_spz])
def test_numbers_that_are_not_finite_are_refused(tmp_path, save):
    """No writer makes a number of NaN; the file that was there stays."""
    good = some_gaussians(4)
    for field, value in (("means", torch.nan), ("quats", torch.inf), ("scales", -torch.inf),
                         ("opacities", torch.nan), ("sh", torch.nan), ("means", 1e39),
                         ("quats", torch.zeros(4))):  # fmt: skip
        array = getattr(good, field).double().clone()
        array[2].view(-1)[-1 if isinstance(value, float) else slice(4)] = value
        (tmp_path / "a").write_text("older")
        with pytest.raises(InputError, match="a: 1 of 20 Gaussians hold NaN .* number 2; expected"):
            save(tmp_path / "a", replace(good, **{field: array}))
        assert (tmp_path / "a").read_text() == "older"


def test_a_git_lfs_pointer_is_named(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    with pytest.raises(InputError, match="a Git LFS pointer instead of the file: git lfs pull"):
        load_ply(path)
