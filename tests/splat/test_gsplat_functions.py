"""gsplat's small functions: their laws, and what they refuse."""

import math

import pytest
import torch

from gva_mi.splat import (
    compute_relocation,
    quat_scale_to_covar_preci,
    reference,
    render,
    spherical_harmonics,
)
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians


def normal(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("degree", range(5))
def test_harmonics_are_the_twins(degree):
    dirs, coeffs = normal(2, 5, 3), normal(2, 5, 25, 3, seed=1)
    unit = (dirs / dirs.norm(dim=-1, keepdim=True)).view(10, 3)
    count = (degree + 1) ** 2
    basis = reference.harmonics(unit, count).view(2, 5, count)
    expected = torch.einsum("...k,...kc->...c", basis, coeffs[..., :count, :])
    assert torch.allclose(spherical_harmonics(degree, dirs, coeffs), expected, atol=1e-13)
    assert torch.allclose(spherical_harmonics(degree, 3 * dirs, coeffs), expected, atol=1e-13)


def test_harmonics_are_differentiable_and_masked_ones_are_not():
    dirs, coeffs = normal(4, 3).requires_grad_(), normal(4, 16, 3, seed=1).requires_grad_()
    masks = torch.tensor([True, False, True, True])
    function = lambda d, h: spherical_harmonics(2, d, h, masks)
    assert torch.autograd.gradcheck(function, (dirs, coeffs))
    colors = function(dirs, coeffs)
    assert (colors[1] == 0).all() and (colors[0] != 0).any()
    by_dirs, by_coeffs = torch.autograd.grad(colors.sum(), (dirs, coeffs))
    assert (by_dirs[1] == 0).all() and (by_coeffs[1] == 0).all()
    assert (by_coeffs[:, 9:] == 0).all() and (by_coeffs[0, :9] != 0).any()
    nowhere = torch.zeros(1, 3, dtype=torch.float64)
    assert spherical_harmonics(3, nowhere, coeffs[:1]).isfinite().all()


def test_a_picture_in_harmonics_is_the_one_of_their_colours():
    coeffs, toward = normal(1, 9, 3) * 0.2, torch.tensor([[0.0, 0.0, -1.0]]).double()
    camera = Camera(30, 30, 8, 8, look_at((0, 0, 2), (0, 0, 0)), 16, 16)
    of = lambda **color: Gaussians(
        torch.zeros(1, 3).double(), normal(1, 4), torch.full((1, 3), 0.2).double(),
        torch.ones(1).double(), **color)  # fmt: skip
    colors = (spherical_harmonics(2, toward, coeffs) + 0.5).clamp(min=0)
    one, two = render(of(sh=coeffs), camera), render(of(colors=colors), camera)
    assert torch.allclose(one.color, two.color, atol=1e-12)


def test_covariances_have_their_axes_and_inverses():
    quats, scales = normal(2, 6, 4), normal(2, 6, 3, seed=1).exp()
    covars, precis = quat_scale_to_covar_preci(quats, scales)
    assert torch.allclose(covars @ precis, torch.eye(3).double().expand(2, 6, 3, 3), atol=1e-9)
    for i in range(6):
        axes = reference.rotation(quats[1, i])
        for k in range(3):
            along = covars[1, i] @ axes[:, k]
            assert torch.allclose(along, scales[1, i, k] ** 2 * axes[:, k], atol=1e-12)
    rows, columns = torch.triu_indices(3, 3)
    flat, none = quat_scale_to_covar_preci(quats, scales, compute_preci=False, triu=True)
    assert none is None and torch.equal(flat, covars[..., rows, columns])
    function = lambda q, s: quat_scale_to_covar_preci(q, s)
    inputs = (quats[0, :2].clone().requires_grad_(), scales[0, :2].clone().requires_grad_())
    assert torch.autograd.gradcheck(function, inputs)


def binomials(count=51):
    rows = [[math.comb(n, k) for k in range(count)] for n in range(count)]
    return torch.tensor(rows, dtype=torch.float32)


@pytest.mark.parametrize("count", [1, 2, 5, 20, 51])
@pytest.mark.parametrize("opacity", [0.005, 0.3, 0.9, 0.999])
def test_relocated_copies_hide_as_much_in_the_middle_and_along_a_line(opacity, count):
    """The law that Eq. 9 is made from, by numerical integration."""
    o, s = compute_relocation(
        torch.tensor([opacity], dtype=torch.float64), torch.ones(1, 3).double(),
        torch.tensor([count]), binomials())  # fmt: skip
    assert 1 - (1 - o.item()) ** count == pytest.approx(opacity, rel=1e-12)
    assert torch.equal(s[:, :1].expand(1, 3), s)
    x = torch.linspace(-9, 9, 20_001, dtype=torch.float64)
    before = opacity * torch.exp(-(x**2) / 2)
    after = 1 - (1 - o * torch.exp(-(x**2) / (2 * s[0, 0] ** 2))) ** count
    assert after.sum().item() == pytest.approx(before.sum().item(), rel=1e-6)


def test_relocated_copies_show_nearly_the_same_picture():
    """Three copies of one Gaussian, against three of the one as it was."""
    camera = Camera(40, 40, 16, 16, look_at((0, 0, 2), (0, 0, 0)), 32, 32)

    def picture(count, opacity, scales):
        of = lambda row: row.double().expand(count, *row.shape[1:]).contiguous()
        shape = of(torch.zeros(1, 3)), of(torch.ones(1, 4)), of(scales)
        return render(Gaussians(*shape, of(opacity), of(torch.ones(1, 3))), camera).alpha

    old = torch.tensor([0.8]).double(), torch.full((1, 3), 0.2).double()
    new = compute_relocation(*old, torch.tensor([3]), binomials())
    expected = picture(1, *old)
    moved = (picture(3, *new) - expected).abs().max()
    assert moved < 0.05 < 0.3 < (picture(3, *old) - expected).abs().max()


def test_relocation_holds_ratios_in_bounds_and_keeps_what_it_is_given():
    opacities, scales = torch.tensor([0.0, 0.5, 0.5]), torch.rand(3, 3)
    ratios = torch.tensor([4, 0, 99])
    new, sizes = compute_relocation(opacities, scales, ratios, binomials(8))
    assert ratios.tolist() == [4, 0, 99] and new.dtype == sizes.dtype == torch.float32
    assert new[0] == 0 and torch.equal(sizes[0], scales[0])
    assert new[1] == 0.5 and torch.equal(sizes[1], scales[1])
    assert new[2] == pytest.approx(1 - 0.5 ** (1 / 8), rel=1e-6)


def test_wrong_shapes_are_named():
    with pytest.raises(ValueError, match=r"needs 9 coefficients, got 4"):
        spherical_harmonics(2, torch.zeros(2, 3), torch.zeros(2, 4, 3))
    with pytest.raises(ValueError, match=r"coeffs must be \(2, K, 3\), got \(3, 4, 3\)"):
        spherical_harmonics(1, torch.zeros(2, 3), torch.zeros(3, 4, 3))
    with pytest.raises(ValueError, match=r"degrees_to_use must be 0 to 4, got 5"):
        spherical_harmonics(5, torch.zeros(2, 3), torch.zeros(2, 36, 3))
    with pytest.raises(ValueError, match=r"masks must be \(2,\), got \(3,\)"):
        spherical_harmonics(0, torch.zeros(2, 3), torch.zeros(2, 1, 3), torch.ones(3).bool())
    with pytest.raises(ValueError, match=r"quats and scales must be"):
        quat_scale_to_covar_preci(torch.zeros(2, 4), torch.zeros(3, 3))
    with pytest.raises(ValueError, match=r"binoms must be \(n_max, n_max\), got \(3, 4\)"):
        compute_relocation(torch.ones(2), torch.ones(2, 3), torch.ones(2), torch.ones(3, 4))
