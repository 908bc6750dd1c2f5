"""gsplat's projection: the numbers of ``rasterization``'s meta, and of the twin, differentiable."""

import inspect

import numpy as np
import pytest
import torch

from gva_mi.splat import fully_fused_projection, quat_scale_to_covar_preci, rasterization, reference
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.scene import random_scene

W, H, N = 24, 17, 30
MODELS = pytest.mark.parametrize("camera_model", ["pinhole", "ortho", "fisheye"])


def arguments(count=N):
    """Gaussians, some of them beyond the border or behind, and two cameras."""
    g = random_scene(torch.Generator().manual_seed(3), count, W, H).gaussians
    means = g.means * 1.5
    means[0] = torch.tensor([0.6, 0.4, 4.0])  # behind both
    views = [look_at((0.6, 0.4, 2.9), (0.0, 0.0, 0.0)), look_at((-0.9, 0.2, 2.5), (0.0, 0.1, 0.0))]
    K = np.array([[40.0, 0, 12.3], [0, 42, 8.1], [0, 0, 1]])
    Ks = torch.tensor(np.stack([K, K + [[3, 0, 0], [0, 2, 0], [0, 0, 0]]]))
    return means, g.quats, g.scales, g.opacities, torch.tensor(np.stack(views)), Ks


def project(means, quats, scales, viewmats, Ks, **options):
    return fully_fused_projection(means, None, quats, scales, viewmats, Ks, W, H, **options)


def test_parameters_are_gsplats():
    expected = (
        "means covars quats scales viewmats Ks width height eps2d near_plane far_plane radius_clip "
        "packed sparse_grad calc_compensations camera_model opacities"
    )
    assert list(inspect.signature(fully_fused_projection).parameters) == expected.split()


@MODELS
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("packed", [False, True])
def test_numbers_are_those_of_rasterization(camera_model, mode, packed):
    means, quats, scales, opacities, viewmats, Ks = arguments()
    colors = torch.ones(N, 1).double()
    shared = {"camera_model": camera_model, "packed": packed}
    *_, meta = rasterization(
        means, quats, scales, opacities, colors, viewmats, Ks, W, H, rasterize_mode=mode, **shared
    )
    antialiased = mode == "antialiased"
    found = project(
        means, quats, scales, viewmats, Ks,
        calc_compensations=antialiased, opacities=opacities, **shared)  # fmt: skip
    *ids, radii, means2d, depths, conics, compensations = found
    seen = (meta["radii"] > 0).all(dim=-1)
    assert torch.equal(radii, meta["radii"]) and 0 < seen.sum() < 2 * N - 1 + packed
    for ours, name in ((means2d, "means2d"), (depths, "depths"), (conics, "conics")):
        torch.testing.assert_close(ours[seen], meta[name][seen], atol=1e-9, rtol=1e-9)
    if packed:
        for ours, name in zip(ids, ("batch_ids", "camera_ids", "gaussian_ids"), strict=True):
            assert torch.equal(ours, meta[name])
    assert (compensations is not None) == antialiased
    if antialiased:
        rows = opacities[ids[2]] if packed else opacities.expand(2, N)
        torch.testing.assert_close((rows * compensations)[seen], meta["opacities"][seen])


@MODELS
def test_the_inverse_of_a_conic_is_the_twins_covariance(camera_model):
    means, quats, scales, _, viewmats, Ks = arguments()
    found = project(means, quats, scales, viewmats, Ks, eps2d=0.2, camera_model=camera_model)
    radii, means2d, depths, conics, _ = found
    camera = Camera.from_matrices(Ks[0], viewmats[0], W, H, camera_model)
    R, t = viewmats[0, :3, :3], viewmats[0, :3, 3]
    for i in torch.nonzero(radii[0, :, 0])[:, 0].tolist():
        x = R @ means[i] + t
        A = reference.rotation(quats[i]) @ torch.diag(scales[i])
        u, sharp = reference._project(x, A @ A.T, R, camera, Ks[0])
        xx, xy, yy = conics[0, i]
        covariance = torch.linalg.inv(torch.stack([xx, xy, xy, yy]).view(2, 2))
        assert torch.allclose(covariance, sharp + 0.2 * torch.eye(2), rtol=1e-9)
        assert torch.allclose(means2d[0, i], u) and torch.allclose(depths[0, i], x[2])


@MODELS
@pytest.mark.parametrize("by_covars", [False, True])
def test_gradients_are_right_in_both_directions(camera_model, by_covars):
    means, quats, scales, _, viewmats, Ks = arguments(6)
    means[1] = torch.tensor([3.0, 0.2, -1.0])  # where a pinhole's J is held
    shape = (quats, scales)
    if by_covars:
        shape = (quat_scale_to_covar_preci(quats, scales, triu=True)[0],)

    def function(means, viewmats, Ks, *shape):
        given = (*shape, None, None) if by_covars else (None, *shape)
        found = fully_fused_projection(
            means, *given, viewmats, Ks, W, H, calc_compensations=True, camera_model=camera_model
        )
        return found[1:]

    inputs = [x.clone().requires_grad_() for x in (means, viewmats, Ks, *shape)]
    assert torch.autograd.gradcheck(function, inputs, check_forward_ad=True)


def test_covariances_take_the_place_of_quats_and_scales():
    means, quats, scales, opacities, viewmats, Ks = arguments()
    covars, _ = quat_scale_to_covar_preci(quats, scales, compute_preci=False, triu=True)
    one = project(means, quats, scales, viewmats, Ks, opacities=opacities)
    two = fully_fused_projection(
        means, covars, None, None, viewmats, Ks, W, H, opacities=opacities)  # fmt: skip
    assert all(torch.equal(a, b) for a, b in zip(one[:4], two[:4], strict=True))


def test_what_is_in_no_picture_is_zero_and_has_no_gradient():
    means, quats, scales, _, viewmats, Ks = arguments()
    leaf = means.float().requires_grad_()
    parts = [x.float() for x in (quats, scales, viewmats, Ks)]
    radii, *found = project(leaf, *parts, calc_compensations=True, radius_clip=3)
    unseen = (radii == 0).all(dim=-1)
    assert unseen[:, 0].all() and not unseen.all() and radii[~unseen].max() > 3
    assert all((x[unseen] == 0).all() and x.dtype == torch.float32 for x in found)
    (grad,) = torch.autograd.grad(sum(x.sum() for x in found), leaf)
    nowhere = unseen.all(dim=0)
    assert (grad[nowhere] == 0).all() and (grad[~nowhere] != 0).all() and grad.isfinite().all()


def test_leading_dimensions_are_a_batch():
    tensors = arguments()[:3] + arguments()[4:]
    twice = [torch.stack([x, x.roll(1, 0)]) for x in tensors]
    twice = [x[:, None].expand(2, 1, *x.shape[1:]) for x in twice]
    whole = project(*twice)
    for b in range(2):
        part = project(*(x[b, 0] for x in twice))
        assert all(torch.equal(x[b, 0], y) for x, y in zip(whole[:4], part[:4], strict=True))
    ids = project(*twice, packed=True)[:3]
    assert torch.equal(torch.stack(ids), torch.stack(torch.nonzero(
        (whole[0] > 0).all(-1).view(2, 2, N)).unbind(1)))  # fmt: skip


def test_what_does_not_fit_is_named():
    means, quats, scales, opacities, viewmats, Ks = arguments()
    with pytest.raises(ValueError, match="give either covars, or quats and scales"):
        project(means, quats, None, viewmats, Ks)
    with pytest.raises(ValueError, match="give either covars, or quats and scales"):
        fully_fused_projection(means, scales, quats, scales, viewmats, Ks, W, H)
    with pytest.raises(ValueError, match=r"covars must be \(30, 6\), got \(30, 3\)"):
        fully_fused_projection(means, scales, None, None, viewmats, Ks, W, H)
    with pytest.raises(ValueError, match="camera_model must be one of pinhole"):
        project(means, quats, scales, viewmats, Ks, camera_model="ftheta")
    with pytest.raises(ValueError, match="means must be float32 or float64"):
        project(means.int(), quats, scales, viewmats, Ks)
