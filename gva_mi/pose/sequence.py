"""All frames refined together, the clothes explained by one displacement of the surface.

A step takes some frames ``k``, chosen at random (every frame once in a pass), and moves the
corrections of all frames, the displacement ``D`` and the shape ``β``, which all frames share,
downhill on

    L = mean_k( |N_k - N_k,pred| + λ1 |S_k - S_k,pred| )      the body β displaced by D, posed
        + E(δ, τ)                                             gva_mi.pose.corrections
        + E(D)                                                gva_mi.pose.displacement
        + λβ |β - β^stage1|²

One frame cannot tell cloth from limb; many frames in which the person turns can, for the cloth goes
along with the body and the error of the pose does not. Nor does one frame tell how far a limb leans
toward the camera; the frames before and after do, in which it is seen from another side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.corrections import Corrections
from gva_mi.pose.displacement import Displacement
from gva_mi.pose.evidence import Target
from gva_mi.pose.priors import FACE, held_levers, levers
from gva_mi.pose.vector_adam import VectorAdam

if TYPE_CHECKING:
    from gva_mi.pose.refine import RefineOptions

DECAY = 0.03  # what is left of the learning rates at the end
BETAS = (0.9, 0.99)  # Adam's
STEPS_A_PASS = 16  # at least, where there are so many frames


@dataclass(frozen=True)
class Solution:
    """What is looked for."""

    rotations: Tensor  # (T, 55, 3) axis-angle
    transl: Tensor  # (T, 3) metres
    offsets: Tensor  # (V, 3) metres
    betas: Tensor  # (B,) standard deviations


def refine_sequence(
    targets: dict[int, Target],
    scene: MeshScene,
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    options: RefineOptions,
    progress: Callable[..., None] | None = None,
    known: Solution | None = None,
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
        known: found on other frames of the video: what all frames share is taken from it, and
            rests.
    """
    generator = torch.Generator().manual_seed(options.seed)
    frames = sorted(targets)
    camera = targets[frames[0]].camera
    rest = body.rest(shape)
    far = levers(rest, body.weights, body.parents)
    corrections = Corrections(pose, frames, camera, held_levers(far), options)
    cloth = Displacement(rest.vertices, body.faces, body.weights)
    betas = shape.betas.clone()[:, None].requires_grad_()  # (B, 1): each for itself
    if known is not None:  # what needs no gradient is left alone by Adam
        cloth.raw, betas = known.offsets, known.betas[:, None]
    turn = (options.step / far).clamp_max(options.largest_turn)[:, None]
    turn[FACE] = 0
    # A turn's three axes have steps of their own, which together are as long as one.
    adam = VectorAdam(
        [corrections.turns, corrections.moves, cloth.raw, betas],
        [turn[..., None] / 3**0.5, options.translation_lr, options.cloth_lr, options.betas_lr],
        BETAS,
    )

    # A video of few frames takes them one by one, or its steps would be too few to arrive.
    batches = -(-len(frames) // max(1, min(options.batch, len(frames) // STEPS_A_PASS)))
    total = options.passes * batches
    for step in range(total):
        if step % batches == 0:
            order = torch.randperm(len(frames), generator=generator).tolist()
        some = order[step % batches :: batches]
        offsets = cloth.offsets
        posed = body(corrections.pose(some), Shape(betas[:, 0]), offsets).vertices
        seen = [
            _look(scene, targets[frames[k]], vertices, options.silhouette)
            for k, vertices in zip(some, posed.detach().unbind(), strict=True)
        ]
        losses, gradients = zip(*seen, strict=True)
        energy = corrections.energy()
        energy = energy + options.betas_prior * (betas[:, 0] - shape.betas).square().sum()
        energy = energy + cloth.energy(
            offsets, options.cloth_smooth, options.cloth_small, options.cloth_outward
        )
        torch.autograd.backward([posed, energy], [torch.stack(gradients) / len(some), None])
        adam.step(DECAY ** (step / total))
        if progress is not None:
            progress(step + 1, total, loss=sum(losses) / len(some) + float(energy.detach()))

    rotations, transl = pose.rotations.clone(), pose.transl.clone()
    with torch.no_grad():
        found = corrections.pose(range(len(frames)))
    rotations[frames], transl[frames] = found.rotations, found.transl
    return Solution(rotations, transl, cloth.offsets.detach(), betas.detach()[:, 0])


def _look(
    scene: MeshScene, target: Target, vertices: Tensor, silhouette: float
) -> tuple[float, Tensor]:
    """The loss of one picture and its gradient by the vertices (V, 3).

    Both at once, while the scene still shows them: to move the mesh again is what costs most.
    """
    vertices = vertices.contiguous().requires_grad_()
    image = scene.render(vertices, target.camera)
    loss = target.normal_loss(image) + silhouette * target.silhouette_loss(image)
    loss.backward()
    return float(loss.detach()), vertices.grad
