"""The slow twins of an avatar's links: plain float64 torch, gradients by autograd alone.

They share no formula with what they check: joints are walked from the root outward and turned by
matrix exponentials, covariances are products of whole matrices, the network's waves are sines of
multiples, and slopes of the colour are turned to the light, not the light to them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from gva_mi.avatar.light import SHARE
from gva_mi.avatar.residual import OUTPUT_UNIT, PoseResidual
from gva_mi.avatar.stretch import LARGEST
from gva_mi.body.pose import PARENTS
from gva_mi.body.smplx import BodyModel
from gva_mi.splat.reference import rotation


def joints(body: BodyModel, betas: Tensor) -> Tensor:
    """Where the joints of a shape are at rest, (55, 3): regressed from its vertices."""
    vertices = body.v_template
    for beta, direction in zip(betas, body.shape_directions, strict=True):
        x, y, z = direction[: 3 * len(vertices)].chunk(3)
        vertices = vertices + beta * torch.stack([x, y, z], dim=1)
    return body.regressor @ vertices


def shaped(means: Tensor, coefficients: Tensor, directions: Tensor) -> Tensor:
    """Means or joints (N, 3) with their blend shapes, one coefficient after the other."""
    for coefficient, direction in zip(coefficients, directions.unbind(2), strict=True):
        means = means + coefficient * direction
    return means


def coefficients(R: Tensor, expression: Tensor, features: Tensor) -> Tensor:
    """Of the blend shapes: some of the pose's features, told by their numbers, then the face's."""
    identity = torch.eye(3).double()
    bent = [(R[1 + k // 9] - identity)[k % 9 // 3, k % 3] for k in features.tolist()]
    return torch.stack([*bent, *expression])


def transforms(
    rotations: Tensor, joints: Tensor, parents: Sequence[int], transl: Tensor
) -> tuple[Tensor, Tensor]:
    """R (55, 3, 3) and T_world_rest (55, 4, 4), one joint after the other from the root."""
    found: list[Tensor] = []
    turned = [_rotation(r) for r in rotations]
    for joint, (parent, R) in enumerate(zip(parents, turned, strict=True)):
        local = _rigid(R, joints[joint] - R @ joints[joint])
        found.append(found[parent] @ local if joint else local)
    placed = [_rigid(torch.eye(3).double(), transl) @ T for T in found]
    return torch.stack(turned), torch.stack(placed)


def before_relu(
    network: PoseResidual,
    weights: dict[str, Tensor],
    means: Tensor,
    skinning: Tensor,
    rotations: Tensor,
) -> Tensor:
    """What enters the network's relus, (N, 4 width): layer after layer, bent and then at rest."""
    codes = [
        torch.tanh(A @ (_rotation(r) - torch.eye(3).double()).reshape(-1))
        for A, r in zip(weights["codes"], rotations, strict=True)
    ]
    layer = lambda name, x: x @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]
    x = (means - network.center) / network.extent
    waves = [2**k * math.pi * x for k in range(network.options.frequencies)]
    at_rest = layer("place", torch.cat([x, *map(torch.sin, waves), *map(torch.cos, waves)], dim=1))
    bent = at_rest
    for joint, code in list(enumerate(codes))[1:]:  # what bends with it: it, and what it hangs on
        share = skinning[:, joint] + skinning[:, PARENTS[joint]]
        bent = bent + torch.outer(share, weights["condition.weight"] @ code)
    first = torch.cat([bent, at_rest], dim=1)
    both = (layer("hidden", x.clamp(min=0)) for x in (bent, at_rest))
    return torch.cat([first, *both], dim=1)


def residual(
    network: PoseResidual,
    weights: dict[str, Tensor],
    means: Tensor,
    skinning: Tensor,
    rotations: Tensor,
) -> Tensor:
    """MLP(theta) (N, 3) metres."""
    *_, bent, at_rest = before_relu(network, weights, means, skinning, rotations).chunk(4, dim=1)
    outputs = [x.clamp(min=0) @ weights["offset.weight"].T for x in (bent, at_rest)]
    return OUTPUT_UNIT * (outputs[0] - outputs[1])


def blend(
    weights: Tensor, slopes: Tensor, T_world_rest: Tensor, means: Tensor
) -> tuple[Tensor, Tensor]:
    """Each Gaussian's affine map, row by row, (N, 12), and how it changes around it (N, 9)."""
    maps = lambda w: torch.einsum("...j,jab->...ab", w, T_world_rest)[..., :3, :]
    ones = torch.cat([means, torch.ones_like(means[:, :1])], dim=1)
    E = torch.einsum("ncab,nb->nac", maps(slopes), ones)
    return maps(weights).flatten(1), E.flatten(1)


def stretch(
    A: Tensor, E: Tensor, means: Tensor, quats: Tensor, scales: Tensor
) -> tuple[Tensor, Tensor]:
    """Means and covariances (N, 6) in the world; one Gaussian after the other."""
    moved, covars = [], []
    for a, e, mean, quat, scale in zip(A, E, means, quats, scales, strict=True):
        a, e = a.view(3, 4), e.view(3, 3)
        moved.append(a[:, :3] @ mean + a[:, 3])
        J = a[:, :3] + e / (1 + (e / LARGEST).square().sum()).sqrt()
        F = J @ rotation(quat) @ torch.diag(scale)
        covars.append((F @ F.T)[torch.triu_indices(3, 3).unbind()])
    return torch.stack(moved), torch.stack(covars)


def lit(sh: Tensor, A: Tensor, light: Tensor) -> Tensor:
    """Colours (N, 1, 3): slopes are turned into the world, by the blended maps, to the light."""
    R = A.view(-1, 3, 4)[:, :, :3]
    turned = R @ sh[:, 1:]  # (N, xyz, colour)
    return sh[:, :1] + SHARE / light.norm() * torch.einsum("nac,a->nc", turned, light)[:, None]


def _rotation(r: Tensor) -> Tensor:
    """exp of the cross product with r (3,), (3, 3)."""
    zero = torch.zeros_like(r[0])
    return torch.linalg.matrix_exp(
        torch.stack([zero, -r[2], r[1], r[2], zero, -r[0], -r[1], r[0], zero]).view(3, 3)
    )


def _rigid(R: Tensor, t: Tensor) -> Tensor:
    last = torch.tensor([[0, 0, 0, 1.0]], dtype=torch.float64)
    return torch.cat([torch.cat([R, t[:, None]], dim=1), last])
