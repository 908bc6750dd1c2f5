"""Gaussians stretch with the skin that carries them."""

import pytest
import roma
import torch

import gva_mi  # noqa: F401  (chooses libLLVM before Dr.Jit is imported)
from gva_mi.avatar.maps import PIECE, FollowedJoints
from gva_mi.avatar.stretch import LARGEST, carry_stretched
from gva_mi.splat.geometry import matrices
from gva_mi.splat.reference import rotation

F64 = torch.float64


def rigid(turn, shift):
    T = torch.eye(4, dtype=F64)
    T[:3, :3] = roma.rotvec_to_rotmat(torch.tensor(turn, dtype=F64))
    T[:3, 3] = torch.tensor(shift, dtype=F64)
    return T


def scene(n=40, turned=0.4, seed=0):
    """Gaussians around a joint, whose weights are linear in x and y."""
    g = torch.Generator().manual_seed(seed)
    normal = lambda *shape: torch.randn(*shape, generator=g, dtype=F64)
    means, quats, scales = 0.1 * normal(n, 3), normal(n, 4), (0.3 * normal(n, 3)).exp() / 50
    slope = torch.tensor([3.0, -1.0, 0.0], dtype=F64)
    share = 0.5 + means @ slope
    weights = torch.stack([share, 1 - share], dim=1)
    slopes = torch.stack([slope, -slope], dim=1).expand(n, 3, 2)
    T = torch.stack([rigid([0, 0, turned], [0, 0, 0]), rigid([turned, 0, -turned], [0, 0.02, 0])])
    return means, quats, scales, weights, slopes, T


def carried(means, quats, scales, weights, slopes, T):
    A, E = FollowedJoints.of(weights, slopes)(T, means)
    return carry_stretched(A, E, means, quats, scales)


def field(x, T):
    """Where a point (3,) is carried, with its weights."""
    share = 0.5 + x @ torch.tensor([3.0, -1.0, 0.0], dtype=F64)
    A = share * T[0] + (1 - share) * T[1]
    return A[:3, :3] @ x + A[:3, 3]


def test_covariances_are_those_of_the_field_s_own_derivative():
    means, quats, scales, weights, slopes, T = scene(turned=0.05)  # so little that β is nearly 1
    moved, covars = carried(means, quats, scales, weights, slopes, T)
    for k, x in enumerate(means):
        torch.testing.assert_close(moved[k], field(x, T))
        J = torch.func.jacrev(lambda x: field(x, T))(x)
        F = J @ rotation(quats[k]) @ torch.diag(scales[k])
        assert (matrices(covars)[k] - F @ F.T).norm() < 2e-3 * (F @ F.T).norm()


def test_a_rigid_motion_is_carried_exactly():
    means, quats, scales, weights, slopes, _ = scene()
    T = rigid([0.3, -1.2, 0.5], [0.1, 2.0, -0.7])
    moved, covars = carried(means, quats, scales, weights, slopes, T.expand(2, 4, 4))
    torch.testing.assert_close(moved, means @ T[:3, :3].T + T[:3, 3])
    for k in range(len(means)):
        F = T[:3, :3] @ rotation(quats[k]) @ torch.diag(scales[k])
        torch.testing.assert_close(matrices(covars)[k], F @ F.T)


def test_nothing_is_pulled_apart_without_end():
    means, quats, scales, weights, slopes, T = scene(turned=1.2)
    A, E = FollowedJoints.of(weights, slopes)(T, means)
    _, covars = carry_stretched(A, 1e6 * E, means, quats, scales)
    longest = torch.linalg.eigvalsh(matrices(covars))[:, -1].sqrt()
    blended = A.view(-1, 3, 4)[:, :, :3].flatten(1).norm(dim=1)
    assert (longest <= (blended + LARGEST) * scales.amax(1) * (1 + 1e-9)).all()
    assert (longest > 2 * scales.amin(1)).all()


def test_gradients_and_tangents_by_differences():
    means, quats, scales, weights, slopes, T = scene(n=5)
    leaves = [x.clone().requires_grad_() for x in (means, quats, scales, T)]

    def function(means, quats, scales, T):
        return carried(means, quats, scales, weights, slopes, T)

    assert torch.autograd.gradcheck(function, leaves, atol=1e-9, check_forward_ad=True)


def test_blends_are_sums_over_the_joints_that_are_followed():
    """Of joints that some, all or none of the Gaussians follow, in more pieces than one."""
    n, joints, g = 3 * PIECE + 5, 7, torch.Generator().manual_seed(1)
    random = lambda *shape: torch.randn(*shape, generator=g, dtype=F64)
    follows = torch.rand(n, joints, generator=g) < torch.tensor([1, 0, 0.5, 0.9, 0.02, 0, 1])
    weights, slopes = random(n, joints) * follows, random(n, 3, joints) * follows[:, None]
    weights[3], slopes[3] = 0, 0  # who follows nothing
    slopes[4], weights[5] = 0, 0
    T, means = random(joints, 4, 4).requires_grad_(), random(n, 3).requires_grad_()
    found = FollowedJoints.of(weights, slopes)(T, means)
    one = torch.cat([means, torch.ones(n, 1, dtype=F64)], dim=1)
    A = torch.einsum("nj,jab->nab", weights, T[:, :3]).flatten(1)
    E = torch.einsum("ncj,jab,nb->nac", slopes, T[:, :3], one).flatten(1)
    grads = [random(n, 12), random(n, 9)]
    for a, b in zip(found, (A, E), strict=True):
        torch.testing.assert_close(a, b)
    both = [torch.autograd.grad(x, (T, means), grads, retain_graph=True) for x in (found, (A, E))]
    for a, b in zip(*both, strict=True):
        torch.testing.assert_close(a, b)


def test_float32_agrees_with_float64_far_from_the_origin():
    means, quats, scales, weights, slopes, T = scene(n=300)
    T = T.clone()
    T[:, :3, 3] += torch.tensor([1.0, -2.0, 5.0], dtype=F64)
    single = [x.float() for x in (means, quats, scales, weights, 30 * slopes)]  # as on fingers
    exact = carried(*(x.double() for x in single), T)[1]
    found = carried(*single, T)[1].double()
    assert (found - exact).norm() / exact.norm() < 1e-6


@pytest.mark.parametrize("n", [0, 2000])
def test_same_bits_twice(n):
    def run():
        means, quats, scales, weights, slopes, T = scene(n=n)
        leaves = [x.clone().requires_grad_() for x in (means, quats, scales, T)]
        outputs = carried(*leaves[:3], weights, slopes, leaves[3])
        sum(x.sin().sum() for x in outputs).backward()
        return [*outputs, *(x.grad for x in leaves)]

    assert all(torch.equal(a, b) for a, b in zip(run(), run(), strict=True))
