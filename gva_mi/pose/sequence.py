"""All frames refined together, the clothes explained by one displacement of the surface.

A step takes one frame ``k``, chosen at random (every frame once in a pass), and moves its rotations
``θ_k``, its translation ``t_k`` and the displacement ``D``, which all frames share, downhill on

    L = |N - N_pred| + λ1 |S - S_pred|               the body displaced by D, posed by θ_k, t_k
        + λ2 Σ_i ω_i d(θ_k,i, θ_k,i^stage1)²          Eq. 9's regulariser
        + smooth Σ_l Σ_i d(θ_k,i, θ_l,i)²             l = k ± 1: neighbours, where they are now
        + smooth_move Σ_l |t_k - t_l|²
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
from gva_mi.pose.priors import joint_weights, levers, squared_angles
from gva_mi.pose.scene import BodyScene
from gva_mi.pose.target import Target
from gva_mi.pose.vector_adam import VectorAdam

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
    # (3, 1) each: depth would hardly move if it shared its step with the other axes.
    moves = [t.clone()[:, None].requires_grad_() for t in pose.transl]
    reach = (options.step / levers(body, shape)).clamp_max(options.largest_turn)[:, None]
    rates = [reach] * len(turns) + [options.translation_lr] * len(moves)
    adam = VectorAdam([*turns, *moves, cloth.raw], [*rates, options.cloth_lr], BETAS)

    frames = sorted(targets)
    total = options.passes * len(frames)
    for step in range(total):
        if step % len(frames) == 0:
            order = torch.randperm(len(frames), generator=generator).tolist()
        k = frames[order[step % len(frames)]]
        offsets = cloth.offsets
        one = Pose.from_rotations(turns[k][None], moves[k].T, pose.expression[k : k + 1])
        vertices = body(one, shape, offsets).vertices[0]
        image = scene.render(vertices, targets[k].camera)
        loss = targets[k].normal_loss(image)
        loss = loss + options.silhouette * targets[k].silhouette_loss(image)
        R = roma.rotvec_to_rotmat(turns[k])
        loss = loss + options.prior * (weights * squared_angles(R, stage1[k])).sum()
        loss = loss + options.hold * (moves[k][:, 0] - pose.transl[k]).square().sum()
        for near in (k - 1, k + 1):
            if near in targets:
                loss = loss + options.smooth * squared_angles(R, now[near]).sum()
                apart = moves[k] - moves[near].detach()
                loss = loss + options.smooth_move * apart.square().sum()
        loss = loss + cloth.energy(
            offsets, options.cloth_smooth, options.cloth_small, options.cloth_outward
        )

        loss.backward()
        turns[k].grad[FACE] = 0
        adam.step(DECAY ** (step / total))
        with torch.no_grad():
            now[k] = roma.rotvec_to_rotmat(turns[k])
        if progress is not None:
            progress(step + 1, total, loss=float(loss.detach()))
    rotations, transl = torch.stack(turns).detach(), torch.stack(moves)[..., 0].detach()
    return Solution(rotations, transl, cloth.offsets.detach())
