"""All frames refined together, the clothes explained by one displacement of the surface.

A step takes one frame ``k``, chosen at random (every frame once in a pass), and moves its rotations
``θ_k``, its translation ``t_k`` and the displacement ``D``, which all frames share, downhill on

    L = |N - N_pred| + λ1 |S - S_pred|               the body displaced by D, posed by θ_k, t_k
        + λ2 Σ_i ω_i d(θ_k,i, θ_k,i^stage1)²          Eq. 9's regulariser
        + smooth Σ_i Σ_l d(θ_k,i, θ_l,i)²             l = k ± 1: neighbours, where they are now
        + hold |t_k - t_k^stage1|²
        + E(D)                                        gva_mi.pose.displacement

One frame cannot tell cloth from limb; many frames in which the person turns can, for the cloth goes
along with the body and the error of the pose does not. Without ``hold`` the body walks toward the
camera to fill the clothes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import roma
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.pose.displacement import Displacement
from gva_mi.pose.priors import joint_weights, squared_angles
from gva_mi.pose.scene import BodyScene
from gva_mi.pose.target import Target

if TYPE_CHECKING:
    from gva_mi.pose.refine import RefineOptions

FACE = slice(JOINTS.index("jaw"), JOINTS.index("right_eye_smplhf") + 1)  # neither seen nor moved
DECAY = 0.1  # what is left of the learning rates at the end
BETAS = (
    0.8,
    0.99,
)  # Adam's: a frame is visited a few dozen times only, so that it must forget fast


@dataclass(frozen=True)
class Solution:
    """What is looked for."""

    rotations: Tensor  # (T, 55, 3) axis-angle
    transl: Tensor  # (T, 3) metres
    offsets: Tensor  # (V, 3) metres


def refine_sequence(
    targets: dict[int, Target],
    scene: BodyScene,
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    options: RefineOptions,
    progress: Callable[..., None] | None = None,
) -> Solution:
    """Refine the frames that have a target; the others stay, and pull at nobody.

    Args:
        targets: what the frames say, by number.
        scene: where the body is rendered.
        body: the body.
        pose: stage 1, T frames.
        shape: the person's.
        options: weights, passes, learning rates and the seed.
        progress: called as ``progress(done, total, loss=...)`` after every step.
    """
    generator = torch.Generator().manual_seed(options.seed)
    weights = joint_weights(body.parents)
    cloth = Displacement(body.rest(shape).vertices, body.faces, body.weights)
    stage1 = roma.rotvec_to_rotmat(pose.rotations)
    now = stage1.clone()  # (T, 55, 3, 3) where all frames stand
    turns = [theta.clone().requires_grad_() for theta in pose.rotations]
    moves = [t.clone().requires_grad_() for t in pose.transl]
    betas = shape.betas.clone().requires_grad_()
    rates = (options.rotation_lr, options.translation_lr, options.cloth_lr, options.shape_lr)
    groups = [
        {"params": p, "lr": lr}
        for p, lr in zip((turns, moves, [cloth.raw], [betas]), rates, strict=True)
    ]
    adam = torch.optim.Adam(groups, betas=BETAS)

    frames = sorted(targets)
    total = options.passes * len(frames)
    for step in range(total):
        if step % len(frames) == 0:
            order = torch.randperm(len(frames), generator=generator).tolist()
        k = frames[order[step % len(frames)]]
        for group, rate in zip(adam.param_groups, rates, strict=True):
            group["lr"] = rate * DECAY ** (step / total)

        offsets = cloth.offsets
        one = Pose.from_rotations(turns[k][None], moves[k][None], pose.expression[k : k + 1])
        image = scene.render(body(one, Shape(betas), offsets).vertices[0], targets[k].camera)
        loss = targets[k].normal_loss(image)
        loss = loss + options.silhouette * targets[k].silhouette_loss(image)
        R = roma.rotvec_to_rotmat(turns[k])
        loss = loss + options.prior * (weights * squared_angles(R, stage1[k])).sum()
        change = stage1[k].mT @ R
        for near in (k - 1, k + 1):
            if near in targets:
                loss = loss + options.smooth * squared_angles(R, now[near]).sum()
                there = stage1[near].mT @ now[near]
                loss = loss + options.smooth_change * squared_angles(change, there).sum()
                loss = (
                    loss
                    + options.smooth_move
                    * ((moves[k] - pose.transl[k]) - (moves[near] - pose.transl[near]).detach())
                    .square()
                    .sum()
                )
        loss = loss + options.hold * (moves[k] - pose.transl[k]).square().sum()
        loss = loss + cloth.energy(
            offsets, options.cloth_smooth, options.cloth_small, options.cloth_outward
        )

        adam.zero_grad(set_to_none=True)
        loss.backward()
        turns[k].grad[FACE] = 0
        adam.step()
        with torch.no_grad():
            now[k] = roma.rotvec_to_rotmat(turns[k])
        if progress is not None:
            progress(step + 1, total, loss=float(loss.detach()))
    return Solution(
        torch.stack(turns).detach(), torch.stack(moves).detach(), cloth.offsets.detach()
    )
