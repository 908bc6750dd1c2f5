"""The fused skinning kernel agrees with plain torch, and Gaussians stretch with the skin."""

import pytest
import roma
import torch

from gva_mi.avatar import lbs_reference
from gva_mi.avatar.lbs_transforms import GAUSSIANS_PER_PIECE, MAX_STRETCH, SparseWeights
from gva_mi.avatar.skin_gaussians import light_vector, skin_gaussians
from gva_mi.splat.axes import matrices
from gva_mi.splat.reference import rotation

JOINTS = 7
F64 = torch.float64


def scene(dtype=F64, n=3 * GAUSSIANS_PER_PIECE + 5, slopes=3):
    """Random Gaussians; some joints are followed by all of them, some by none."""
    g = torch.Generator().manual_seed(2)
    random = lambda *shape: torch.randn(*shape, generator=g, dtype=F64)
    follows = torch.rand(n, JOINTS, generator=g) < torch.tensor([1, 0, 0.5, 0.9, 0.02, 0, 1])
    weights, dW = random(n, JOINTS) * follows, random(n, 3, JOINTS) * follows[:, None]
    if n > 5:
        weights[3], dW[3], dW[4], weights[5] = 0, 0, 0, 0  # 3 follows no joint
    leaves = random(n, 3), random(n, 4), random(n, 3).exp() / 10, random(n, 1 + slopes, 3)
    inputs = [random(JOINTS, 4, 4), *(x.to(dtype) for x in (*leaves, random(3)))]
    return weights.to(dtype), dW.to(dtype), [x.requires_grad_() for x in inputs]


def dense(weights, dW, T, means, quats, scales, sh, light):
    """Eq. 5 as sums over all joints, with the reference of stretch and light."""
    one = torch.cat([means, torch.ones_like(means[:, :1])], dim=1).double()
    A = torch.einsum("nj,jab->nab", weights.double(), T[:, :3]).flatten(1).to(means)
    E = torch.einsum("ncj,jab,nb->nac", dW.double(), T[:, :3], one).flatten(1).to(means)
    colors = lbs_reference.lit(sh, A, light_vector(light))
    return *lbs_reference._stretched(A, E, means, quats, scales), colors


@pytest.mark.parametrize(("dtype", "slopes"), [(torch.float32, 3), (F64, 3), (F64, 0)])
def test_the_kernel_agrees_with_sums_over_all_joints(dtype, slopes):
    weights, dW, inputs = scene(dtype, slopes=slopes)
    outs = skin_gaussians(SparseWeights.of(weights, dW), *inputs), dense(weights, dW, *inputs)
    for one, other in zip(*outs, strict=True):
        assert one.shape == other.shape
        torch.testing.assert_close(one, other)
    g = torch.Generator().manual_seed(3)
    grads = [torch.randn(x.shape, generator=g, dtype=F64).to(x) for x in outs[0]]
    found = [torch.autograd.grad(out, inputs, grads, allow_unused=True) for out in outs]
    for one, other in zip(*found, strict=True):
        expected = torch.zeros_like(one) if other is None else other  # no slopes, no light
        scale = float(expected.abs().max())
        torch.testing.assert_close(one, expected, atol=2e-6 * scale, rtol=1e-4)


def test_gradients_and_tangents_agree_with_differences():
    weights, dW, inputs = scene(n=5)
    function = lambda *inputs: skin_gaussians(SparseWeights.of(weights, dW), *inputs)
    assert torch.autograd.gradcheck(
        function, inputs, atol=1e-7, check_forward_ad=True, fast_mode=True
    )


def rigid(turn, shift):
    T = torch.eye(4, dtype=F64)
    T[:3, :3] = roma.rotvec_to_rotmat(torch.tensor(turn, dtype=F64))
    T[:3, 3] = torch.tensor(shift, dtype=F64)
    return T


SLOPE = torch.tensor([3.0, -1.0, 0.0], dtype=F64)


def joint(n=40, turned=0.4):
    """Gaussians around a joint between two bones, whose weights are linear in x and y."""
    g = torch.Generator().manual_seed(0)
    normal = lambda *shape: torch.randn(*shape, generator=g, dtype=F64)
    means, quats, scales = 0.1 * normal(n, 3), normal(n, 4), (0.3 * normal(n, 3)).exp() / 50
    share = 0.5 + means @ SLOPE
    weights = torch.stack([share, 1 - share], dim=1)
    slopes = torch.stack([SLOPE, -SLOPE], dim=1).expand(n, 3, 2)
    T = torch.stack([rigid([0, 0, turned], [0, 0, 0]), rigid([turned, 0, -turned], [0, 0.02, 0])])
    return means, quats, scales, weights, slopes, T


def skinned(means, quats, scales, weights, slopes, T):
    sh = means.new_zeros(len(means), 1, 3)
    own = means, quats, scales, sh, means.new_ones(3)
    return skin_gaussians(SparseWeights.of(weights, slopes), T, *own)[:2]


def skinned_point(x, T):
    share = 0.5 + x @ SLOPE
    A = share * T[0] + (1 - share) * T[1]
    return A[:3, :3] @ x + A[:3, 3]


def test_covariances_follow_the_derivative_of_the_skinned_points():
    means, quats, scales, weights, slopes, T = joint(turned=0.05)  # β is nearly 1
    moved, covars = skinned(means, quats, scales, weights, slopes, T)
    for k, x in enumerate(means):
        torch.testing.assert_close(moved[k], skinned_point(x, T))
        J = torch.func.jacrev(lambda x: skinned_point(x, T))(x)
        F = J @ rotation(quats[k]) @ torch.diag(scales[k])
        assert (matrices(covars)[k] - F @ F.T).norm() < 2e-3 * (F @ F.T).norm()


def test_stretch_is_bounded():
    means, quats, scales, weights, slopes, T = joint(turned=1.2)
    _, covars = skinned(means, quats, scales, weights, 1e6 * slopes, T)
    longest = torch.linalg.eigvalsh(matrices(covars))[:, -1].sqrt()
    A = torch.einsum("nj,jab->nab", weights, T[:, :3, :3]).flatten(1).norm(dim=1)
    assert (longest <= (A + MAX_STRETCH) * scales.amax(1) * (1 + 1e-9)).all()
    assert (longest > 2 * scales.amin(1)).all()


def test_no_gaussians_give_empty_tensors_and_zero_gradients():
    weights, dW, inputs = scene(torch.float32, n=0)
    outs = skin_gaussians(SparseWeights.of(weights, dW), *inputs)
    assert [tuple(x.shape) for x in outs] == [(0, 3), (0, 6), (0, 1, 3)]
    sum(x.sum() for x in outs).backward()
    assert (inputs[0].grad == 0).all()
