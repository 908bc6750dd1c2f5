"""How uncertain refined poses are: what one camera can see of a person.

The unknowns ``x`` of a frame are turns of the 22 joints of the body about the camera's axes, a
shift, and the shape ``β``. Near the refined pose the rendered mask and normals change by ``J x``,
and the pose is a Gaussian (Laplace's approximation):

1. ``Λ = Σ_e I_e / s_e + P``,    ``C = Λ⁻¹``,    ``I_e = Σ_b J_b J_bᵀ / n_b``
2. ``s_e = Σ_kb r_b² / n_b / (N_e - γ_e)``,    ``γ_e = Σ_k tr(C_k I_ke) / s_e``
3. ``cov(y) = M C Mᵀ + s_o 1`` of joints ``y`` that move by ``M x``
4. ``s_o = mean |o_j|² / 3``,    ``o_j = Σ_v w_vj a_v D_v / Σ_v w_vj a_v``

==========  ============================================================================
Λ, C        precision and covariance of the unknowns of a frame, (U, U)
e           kind of evidence: the mask, or the normals where they are known
b           square block of pixels, BLOCK wide at the person's distance
J_b, r_b    sums over a block, of the derivatives (U,) and of ``N - N_pred``, ``S - S_pred``
n_b         pixels of the rendered outline in the block, or pixels with known normals
s_e         variance that a pixel adds to ``r_b``, if blocks err independently
N_e, γ_e    number of residuals ``r_b`` of all frames; unknowns that the evidence determined
P           precision of the prior: the diagonal of 1 / variance
o_j, s_o    mean displacement of the surface around joint j, area ``a``; its variance
==========  ============================================================================

**J** is a derivative in forward mode: of the body (float64), then of its picture (the tangent of
the plugin ``mesh_normals``, float32).

**Noise.** Neighbouring pixels err together, because a wrong outline is wrong along a limb. So
residuals are summed over blocks. On the tuning set neighbouring blocks still correlate by 0.2
(masks) and 0.4 (normals); larger ones would no longer tell the two sides of a limb apart. The scale
``s_e`` is no constant: it is the estimate of variance components (Förstner 1979), from what the
evidence leaves unexplained. It includes clothes, blurred normals, and all else that the body model
cannot show.

**Clothes.** Images show a surface, and joints lie inside it. The displacement ``D`` that the
refinement found moves the surface of a part by ``o_j`` against its joint. It may be cloth, or a
constant error of the pose: from all sides of a person who turns both look the same (eq. 4).

**Prior.** The variance of each turn and shift is that of the Gaussian process under which the poses
were refined (:meth:`gva_mi.refine.corrections.Corrections.variances`). Its inertia is included. A
joint that no frame shows keeps it. ``β`` has the refinement's own penalty.

**Frames are taken alone.** Errors of the evidence and of stage 1 last some frames. If both have the
same correlation in time, neighbours add nothing. ``β`` is no better known from many frames than
from one, as in the refinement itself (:mod:`gva_mi.refine.corrections`).

Left out: fingers (rigid here), anatomy, ground contact, landmarks (stage 1's errors, which the
prior holds, are theirs already), and a wrong focal length.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import NamedTuple

import numpy as np
import torch
import torch.autograd.forward_ad as forward
from torch import Tensor

from gva_mi.body.pose import ROOT_AND_BODY, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import compose
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.image_evidence import MaskAndNormals
from gva_mi.splat import Camera

BLOCK = 0.14  # metres at the person, side of a block; chosen on the tuning set
STRIDE = 6  # every so many frames; covariances between them are interpolated
SCALE_ROUNDS = 6  # of eq. 2, chosen: the scales no longer change
LEAST_FREE = 0.1  # share of the residuals that counts as free at least; chosen: few frames
SMALLEST_SCALE = 1e-5  # s_e; chosen: the square of a grey level
JOINTS = len(range(ROOT_AND_BODY.start, ROOT_AND_BODY.stop))
TURNS = 3 * JOINTS  # unknowns of a frame before the shift


class Motions(NamedTuple):
    """How the body moves with the U unknowns, (U, V, 3) and (U, 55, 3), metres, world."""

    vertices: Tensor
    joints: Tensor


class Blocks(NamedTuple):
    """Evidence of one kind in one frame, in B blocks."""

    J: Tensor  # (U, B) sums of derivatives
    residual: Tensor  # (B,)
    pixels: Tensor  # (B,) n_b, at least 1

    @property
    def information(self) -> Tensor:
        """``I`` (U, U) of eq. 1."""
        return (self.J / self.pixels) @ self.J.T

    @property
    def square(self) -> float:
        """``Σ_b r_b² / n_b`` of eq. 2."""
        return float((self.residual.square() / self.pixels).sum())


def motions(body: BodyModel, stage1: Stage1Poses, pose: Pose, shape: Shape, D: Tensor) -> Motions:
    """Differentiate a body by the unknowns, in forward mode.

    Args:
        body: float64.
        stage1: of one frame; gives the camera's axes.
        pose: of the frame, float64.
        shape: float64.
        D: (V, 3) offsets, metres, float64.
    """
    frames, moved = TURNS + 3, torch.eye(TURNS + 3, dtype=torch.float64)
    turns = torch.zeros(frames, *pose.rotations.shape[1:]).double()
    turns[:, ROOT_AND_BODY] = moved[:, :TURNS].view(frames, JOINTS, 3)
    turns = (stage1.R_joint_camera.double() @ turns[..., None])[..., 0]
    shifts = moved[:, TURNS:] @ stage1.R_camera_world.double()
    many = pose[[0] * frames]
    with forward.dual_level():
        turned = compose(many.rotations, forward.make_dual(torch.zeros_like(turns), turns))
        place = forward.make_dual(many.transl, shifts)
        found = [body(Pose(turned, place, many.expression), shape, D)]
        for beta in torch.eye(len(shape.betas), dtype=torch.float64):
            found.append(body(pose, Shape(forward.make_dual(shape.betas, beta)), D))
        change = lambda xs: torch.cat([forward.unpack_dual(x).tangent for x in xs])
        return Motions(change([x.vertices for x in found]), change([x.joints for x in found]))


def blocks(
    scene: MeshScene, vertices: Tensor, moving: Tensor, seen: MaskAndNormals
) -> dict[str, Blocks]:
    """Return mask and normals of a frame in blocks.

    Args:
        scene: of the body.
        vertices: (V, 3) float32, world, metres.
        moving: (U, V, 3) of :class:`Motions`.
        seen: the evidence.
    """
    image, target = scene.render(vertices, seen.camera), seen.mask[..., None]
    size = block_size(seen.camera, vertices)
    mask = image[..., 3:]
    outline = torch.zeros_like(mask)
    outline[1:] += mask.diff(dim=0).abs()
    outline[:, 1:] += mask.diff(dim=1).abs()
    pixels, known = outline * torch.pi / 4, torch.zeros_like(mask)  # the mean over all directions
    if seen.normals is not None:
        target = torch.cat([seen.normals, target], dim=-1)
        known = seen.normals.any(-1, keepdim=True).to(mask)
    weight = torch.cat([known.expand(-1, -1, 3), torch.ones_like(mask)], dim=-1)
    off = weight * (image - target)
    J = torch.stack(
        [totals(weight * x, size) for x in scene.tangents(vertices, seen.camera, moving)]
    )
    sums, counts = totals(off, size), totals(torch.cat([known, pixels], dim=-1), size)
    found = {}
    for name, part, n in (
        ("mask", slice(3, 4), counts[..., 1]),
        ("normals", slice(3), counts[..., 0]),
    ):
        used = n >= 1
        if bool(used.any()):
            each = n[used].repeat_interleave(len(range(4)[part]))
            found[name] = Blocks(J[:, used, part].flatten(1), sums[used, part].flatten(), each)
    return found


def block_size(camera: Camera, vertices: Tensor) -> int:
    """Return the side of a block, pixels, before a body (V, 3), world, metres."""
    depth = (vertices.mean(0).double().numpy() - camera.position) @ camera.T_camera_world[2, :3]
    return max(1, round(BLOCK * camera.fx / float(depth)))


def totals(image: Tensor, size: int) -> Tensor:
    """Sum an image (H, W, C) over blocks of ``size`` pixels, (h, w, C) float64."""
    x = image.numpy().astype(np.float64)
    for axis in range(2):
        x = np.add.reduceat(x, list(range(0, image.shape[axis], size)), axis)
    return torch.from_numpy(x)


Information = Mapping[str, Tensor]  # I_e (U, U) of a frame, by kind of evidence


def covariance_of(information: Information, scale: Mapping[str, float], P: Tensor) -> Tensor:
    """Return ``C`` (U, U) of eq. 1, under a prior of precision (U, U)."""
    precision = P + sum(x / scale[name] for name, x in information.items())
    return torch.cholesky_inverse(torch.linalg.cholesky(precision))


def noise_scales(
    frames: Sequence[Mapping[str, Blocks]], information: Sequence[Information], P: Sequence[Tensor]
) -> dict[str, float]:
    """Return ``s_e`` of eq. 2 from all frames, by kind of evidence."""
    scale: dict[str, float] = {}
    for _ in range(SCALE_ROUNDS):
        C = [covariance_of(I, scale, p) for I, p in zip(information, P, strict=True) if scale]
        updated = {}
        for name in sorted({name for frame in frames for name in frame}):
            seen = [frame[name] for frame in frames if name in frame]
            count = sum(len(x.residual) for x in seen)
            used = sum(
                float((c * I[name]).sum()) / scale[name]
                for c, I in zip(C, information, strict=False)
                if name in I
            )
            free = max(count - used, LEAST_FREE * count)
            updated[name] = max(sum(x.square for x in seen) / free, SMALLEST_SCALE)
        scale = updated
    return scale


@dataclass(frozen=True)
class Uncertainty:
    """Covariances of the joints of T poses, world axes, m²."""

    joints: Tensor  # (T, 55, 3, 3) of their places
    aligned: Tensor  # (T, 55, 3, 3) of their places relative to the pelvis
    scale: Mapping[str, float]  # s_e, by kind of evidence


@dataclass(frozen=True)
class Posterior:
    """The unknowns of K frames: eq. 1 at the refined poses."""

    frames: Sequence[int]
    C: Tensor  # (K, U, U)
    motions: Tensor  # (K, U, 55, 3) of the joints
    seen: Sequence[Mapping[str, Blocks]]
    precision: Tensor  # (K, U, U) P
    scale: Mapping[str, float]
    offset: float  # s_o, m²

    @staticmethod
    @torch.no_grad()
    def of(
        evidence: Mapping[int, MaskAndNormals],
        body: BodyModel,
        person: tuple[Pose, Shape, Tensor],
        stage1: Stage1Poses,
        variances: Tensor,
        shape_precision: Tensor,
    ) -> Posterior:
        """Differentiate evidence and body at refined poses.

        Args:
            evidence: of K frames, by number.
            body: that is compared.
            person: refined poses of all frames, shape, and offsets (V, 3).
            stage1: of the K frames.
            variances: (K, 58) of the prior: of a turn of each joint, and of the shift.
            shape_precision: (B, B) of the prior of ``β``.
        """
        exact, scene = copy.deepcopy(body).double(), MeshScene(body.faces, body.v_template)
        pose, shape, D = person
        seen, moved, precision = [], [], []
        for i, (k, view) in enumerate(evidence.items()):
            axes = replace(stage1, R_joint_camera=stage1.R_joint_camera[[i]])
            x = pose[k].to(torch.float64), Shape(shape.betas.double()), D.double()
            moving = motions(exact, axes, *x)
            vertices = body(pose[k], shape, D).vertices[0]
            seen.append(blocks(scene, vertices, moving.vertices, view))
            moved.append(moving.joints)
            turns, shift = variances[i, ROOT_AND_BODY], variances[i, -3:]
            of_pose = torch.cat([turns.repeat_interleave(3), shift])
            precision.append(torch.block_diag(torch.diag(1 / of_pose), shape_precision))
        information = [{name: x.information for name, x in one.items()} for one in seen]
        scale = noise_scales(seen, information, precision)
        C = [covariance_of(*one) for one in zip(information, repeat(scale), precision)]
        offset = float(offsets_of_parts(exact, x[1], x[2]).square().mean())
        found = torch.stack(moved), seen, torch.stack(precision), scale, offset
        return Posterior(list(evidence), torch.stack(C), *found)

    def covariance(self, M: Tensor) -> Tensor:
        """Return ``M C Mᵀ`` (K, N, 3, 3) of points that move by ``M`` (K, U, N, 3)."""
        return torch.einsum("kunc,kunv->kncv", M, torch.einsum("kuw,kwnv->kunv", self.C, M))

    def uncertainty(self, frames: int) -> Uncertainty:
        """Return the covariances of all T frames, interpolated between the K frames."""
        M, offset = self.motions, self.offset * torch.eye(3).double()

        def of_all(covariance: Tensor) -> Tensor:
            known = covariance.flatten(1).numpy().T
            all_frames = [np.interp(range(frames), self.frames, column) for column in known]
            return torch.from_numpy(np.stack(all_frames, 1)).view(frames, -1, 3, 3)

        aligned = self.covariance(M - M[:, :, :1])
        aligned[:, 1:] += 2 * offset  # the joint's, and the pelvis's
        return Uncertainty(of_all(self.covariance(M) + offset), of_all(aligned), self.scale)


def offsets_of_parts(body: BodyModel, shape: Shape, D: Tensor) -> Tensor:
    """Return ``o_j`` (22, 3) of eq. 4 of offsets (V, 3), metres."""
    corners = body.rest(shape).vertices[body.faces]
    a, b, c = corners.unbind(1)
    each = torch.linalg.cross(b - a, c - a).norm(dim=1) / 6  # a third of a face
    area = torch.bincount(body.faces.flatten(), each.repeat_interleave(3), len(D))
    weight = body.weights[:, ROOT_AND_BODY] * area[:, None]
    return weight.T @ D / weight.sum(0)[:, None]
