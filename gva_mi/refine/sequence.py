"""Refine all frames together, with one displacement of the surface for the clothes.

The poses of all frames, and the displacement ``D`` and shape ``β`` that all frames share, are
optimised (:mod:`gva_mi.refine.optimize`) on

    L = mean_k( d_k + Σ_parts λc d_k,part )    d: data term of Eq. 8 of the posed body with shape β,
                                               displaced by D (gva_mi.refine.image_evidence); again
                                               for hands and feet (gva_mi.refine.close_ups)
        + ν E(δ, τ)                            prior: stage 1, motion, anatomy, ground
                                               (gva_mi.refine.corrections)
        + λl L_landmarks                       gva_mi.refine.landmark_evidence
        + E(D)                                 the clothes
        + λβ |β - β^stage1|²
        + λh (h(β) - H)²                       if the height H is known: gva_mi.prior.body_height

One frame cannot separate cloth from limb. Many frames in which the person turns can, because the
cloth moves with the body and the pose error does not. Likewise one frame does not show how far a
limb tilts toward the camera, but its neighbours see the limb from another side.

Clothes and hair stand off the body, and no pose of a bare body fills the mask of a clothed person:
limbs, size and depth would change to make up for the cloth. Their displacement ``D`` (V, 3) of the
rest surface is shared by all frames (SMPL-X + D), and costs

    E(D) = a mean |Δ D|² / h⁴ + b mean |D|² + c mean min(D · n, 0)²

with the rest surface's normals ``n``, ``Δ`` a vertex minus the mean of its neighbours, and ``h²``
the mean square of the edges. The energy keeps ``D`` smooth, small, and outward, because cloth lies
on the body. On the hands ``D`` is zero: they are bare, and their pose is found by their shape. On
the face it is zero if there are no normals: masks hardly show a face, and the hair around it would
pull it forward by centimetres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import torch
from torch import Tensor
from torch.nn.functional import pad

from gva_mi.body.face import face_shares
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.options import Metres, PythonOnly, Rate, Seed, Weight, Within, options_of
from gva_mi.core.tasks import Helpers
from gva_mi.mesh.surface import uniform_laplacian, vertex_normals
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.body_height import PERSON_HEIGHTS, Stature
from gva_mi.prior.error_model import GROUPS, Stage1ErrorModel
from gva_mi.prior.ground import ContactStats, Soles
from gva_mi.refine.close_ups import FinePicture, hand_vertices
from gva_mi.refine.frame_losses import FrameBody, FrameLosses, mean_of_losses
from gva_mi.refine.image_evidence import MaskAndNormals
from gva_mi.refine.landmark_evidence import SeenLandmarks
from gva_mi.refine.optimize import (
    DescentOptions,
    Faces,
    Learn,
    PartFrames,
    Passes,
    PersonSize,
    PriorWeight,
    descend,
)
from gva_mi.refine.vector_adam import lever_arms

# Least number of steps in a pass: a clip of few frames visits each of them several times. Chosen:
# with fewer steps poses do not converge.
STEPS_A_PASS = 16
FINGER_JOINTS = GROUPS["fingers"]
FOOT_WEIGHT = 0.1  # λc of each foot; chosen small: shoes differ from the body
LANDMARK_WEIGHT = 0.015  # λl, for one nat; chosen by eye
HEIGHT_WEIGHT = 1e3  # λh, for one square metre; chosen: 1 mm costs 0.001
BETAS_WEIGHT = 0.01  # λβ, for one squared standard deviation; chosen by eye
# First steps of the unknowns that all frames share; chosen by eye.
CLOTH_STEP = 0.003  # metres
BETAS_STEP = 0.05  # standard deviations
LANDMARK_STEP = 0.001  # metres, of the landmarks' offsets


@options_of("refine")
class SequenceOptions(DescentOptions):
    """Options of the refinement of all frames together.

    The losses that the weights multiply are divided by the person's area in pixels
    (:mod:`gva_mi.refine.image_evidence`).
    """

    passes: Passes = 24  # how often every frame is visited, more often if there are very few
    # Pixels of the person's longer side in the images that are compared.
    size: PersonSize = 208
    # Measured height of the person: sets body size and depth, which are then not fitted.
    height: Annotated[float, PERSON_HEIGHTS] | None = None
    hold_out_test: bool = False  # test frames are not used; the motion prior fills them in

    seed: PythonOnly[Seed] = 0  # seed of the order of frames
    # Triangles of the body that is compared.
    faces: PythonOnly[Faces] = 3500
    silhouette: PythonOnly[Weight] = 1.0  # λ1
    learn: PythonOnly[Learn] = 8  # passes after which stage 1's error model is inferred
    prior_weight: PythonOnly[PriorWeight] = 0.015  # ν: weight of the prior beside the data term
    close_hands: PythonOnly[Weight] = 0.5  # λc of each hand; 0: no close-ups of hands
    # Metres that a joint moves the skin beyond it, in a first step.
    step: PythonOnly[Metres] = 0.012
    translation_lr: PythonOnly[Rate] = 0.006  # metres in a first step; images show depth weakly
    part: PythonOnly[PartFrames] = 120  # frames refined together; a longer video is cut into clips
    # Frames of a longer video from which the unknowns that its clips share are found.
    skim: PythonOnly[Annotated[int, Within(1, 10_000)]] = 96

    name: ClassVar[str] = "sequence"
    command: ClassVar[str] = "refine"
    decay: ClassVar[float] = 0.03


@dataclass(frozen=True)
class Solution:
    """Poses after stage 2, and the unknowns that all frames share."""

    pose: Pose  # T frames
    shape: Shape
    offsets: Tensor  # (V, 3) displacement of the rest surface, metres
    # Of stage 1, known or inferred; empty without a prior.
    error_models: Mapping[str, Stage1ErrorModel] = field(default_factory=dict)
    contact: ContactStats | None = None  # how the feet touch the ground, if inferred
    landmark_offsets: Tensor | None = None  # (P, 3) ``o`` of gva_mi.observe.rig, metres
    # (T, 58) of the prior: a turn of each joint, radians², and the shift, m²; NaN where unused.
    variances: Tensor | None = None


@dataclass(frozen=True)
class ObservedClip:
    """Frames that are refined together, with all that was observed of them.

    Attributes:
        evidence: masks and normals, by index into ``pose``; perhaps still on disk.
        body: that is compared.
        pose: T frames of stage 1; frames without evidence keep it.
        shape: of the person, by stage 1.
        first_round: solution whose shared unknowns are kept; None: they are found here.
        fine: pictures for close-ups, by index.
        filled_in: frames without evidence whose poses follow from the prior.
        landmarks: of all T frames.
        known_errors: of the estimator, by group of joints; None: inferred.
    """

    evidence: Mapping[int, MaskAndNormals]
    body: BodyModel
    pose: Pose
    shape: Shape
    first_round: Solution | None = None
    fine: Mapping[int, FinePicture] = field(default_factory=dict)
    filled_in: Sequence[int] = ()
    landmarks: SeenLandmarks | None = None
    known_errors: Mapping[str, Stage1ErrorModel] | None = None


def refine_sequence(
    clip: ObservedClip,
    options: SequenceOptions,
    progress: Progress | None = None,
    helpers: Helpers | None = None,
) -> Solution:
    """Refine the frames of a clip that have evidence; others keep their pose, and affect no frame.

    Args:
        clip: the frames and what was observed of them.
        options: weights, passes, learning rates and the seed.
        progress: called after every step.
        helpers: processes that share the frames of a step; the bits do not depend on them.
    """
    person = ClothedPerson(clip, options, helpers)
    # With few frames a step takes fewer of them, and with very few they are visited more often:
    # otherwise there would be too few steps to converge.
    frames = len(clip.evidence)
    options = replace(
        options,
        batch=frames_a_step(frames, options),
        passes=repeats(frames) * options.passes,
        learn=repeats(frames) * options.learn,
    )
    descent = descend(
        person,
        clip.pose,
        person.arms,
        options,
        progress,
        filled_in=clip.filled_in,
        known_errors=clip.known_errors,
    )
    shape, offsets = Shape(person.shape.betas.detach()), person.offsets.detach()
    ground = descent.prior.ground
    return Solution(
        pose=descent.pose,
        shape=shape,
        offsets=offsets,
        error_models=descent.prior.error_models,
        contact=None if ground is None else ground.contact,
        landmark_offsets=None if clip.landmarks is None else person.landmark_offsets.detach(),
        variances=descent.variances,
    )


def shape_precision(body: BodyModel, betas: int, options: SequenceOptions) -> Tensor:
    """Return the precision (B, B) of the first ``betas`` that the penalties of ``β`` are."""
    slope = Stature.of(body).slope.double()[:betas]
    slope = pad(slope, (0, betas - len(slope))) * (options.height is not None)
    penalty = BETAS_WEIGHT * torch.eye(betas).double() + HEIGHT_WEIGHT * slope[:, None] * slope
    return 2 * penalty / options.prior_weight


def frames_a_step(frames: int, options: SequenceOptions) -> int:
    """Return how many frames a step takes of a clip of so many frames."""
    return max(1, min(options.batch, frames // STEPS_A_PASS))


def repeats(frames: int) -> int:
    """Return how many times a pass visits each frame of a clip."""
    return max(1, -(-STEPS_A_PASS // max(1, frames)))


class ClothedPerson:
    """The :class:`gva_mi.refine.optimize.Evidence` of a clip: a clothed person in all frames.

    The body with shape ``β``, displaced by ``D``, is compared with masks, normals and landmarks.
    ``D`` and ``β`` are the shared leaves, unless the clip has them from a first round.
    """

    # With a known height, depth is scaled with body size and not fitted, because hair and shoes
    # bias the silhouette; without one, depth and size are ambiguous.
    distance_shown = False

    def __init__(
        self, clip: ObservedClip, options: SequenceOptions, helpers: Helpers | None = None
    ) -> None:
        rest = clip.body.rest(clip.shape)
        self._clip, self._options = clip, options
        weights = {"hand": options.close_hands, "foot": FOOT_WEIGHT}
        given = clip.body, clip.evidence, clip.fine, options.silhouette, weights
        self._losses = (helpers or Helpers()).share(FrameLosses, *given)
        self._close = False
        self._stature = Stature.of(clip.body)
        bare = hand_vertices(clip.body.weights).to(rest.vertices)
        if all(seen.normals is None for seen in clip.evidence.values()):
            bare = bare.maximum(face_shares(rest, clip.body.weights))
        self._cloth = Displacement(rest.vertices, clip.body.faces, bare)
        self._betas = clip.shape.betas.clone()[:, None].requires_grad_()  # (B, 1): B vectors of one
        if clip.first_round is None:
            self.shared = [(self._cloth.raw, CLOTH_STEP), (self._betas, BETAS_STEP)]
            if clip.landmarks is not None:
                self.landmark_offsets = torch.zeros_like(clip.landmarks.rig.rest).requires_grad_()
                self.shared.append((self.landmark_offsets, LANDMARK_STEP))
        else:
            known = clip.first_round
            self.landmark_offsets = known.landmark_offsets
            self._betas, self.shared = known.shape.betas[:, None], []
        self.anatomy = Anatomy.of(rest.joints)
        self.arms = lever_arms(rest, clip.body.weights, clip.body.parents)
        self.frames = sorted(clip.evidence)
        self.camera = clip.evidence[self.frames[0]].camera

    @property
    def offsets(self) -> Tensor:
        """``D`` (V, 3), metres."""
        known = self._clip.first_round
        return self._cloth.offsets if known is None else known.offsets

    @property
    def shape(self) -> Shape:
        """``β``."""
        return Shape(self._betas[:, 0])

    @property
    def soles(self) -> Soles:
        """The soles of the current shape."""
        return Soles.of(self._clip.body.rest(self.shape), self._clip.body.weights)

    @property
    def surface_known(self) -> bool:
        """Whether the clothes are known from a first round."""
        return self._clip.first_round is not None

    @property
    def unseen(self) -> Sequence[int]:
        """The fingers until close-ups are used: errors of masks would bend them before."""
        close = self._close and self._clip.fine and self._options.close_hands > 0
        return () if close else FINGER_JOINTS

    def loss(self, frames: Sequence[int], pose: Pose) -> Tensor:
        """Return the data term and the landmarks' loss, a mean over the frames."""
        posed = self._clip.body(pose, self.shape, self.offsets)
        losses = lambda bodies: self._losses(
            [FrameBody(k, body, self._close) for k, body in zip(frames, bodies, strict=True)]
        )
        loss = mean_of_losses(posed.vertices, losses)
        if (landmarks := self._clip.landmarks) is None:
            return loss
        person = posed.T_world_rest, self.shape, self.landmark_offsets
        return loss + LANDMARK_WEIGHT * landmarks.losses(frames, *person).mean()

    def enable_details(self) -> None:
        """Start to use close-ups, which need nearly correct poses."""
        self._close = True

    def energy(self) -> Tensor:
        """Return the terms of clothes, shape and height."""
        moved = (self.shape.betas - self._clip.shape.betas).square().sum()
        energy = BETAS_WEIGHT * moved + self._cloth.energy(self.offsets)
        if self._options.height is not None:
            off = self._stature.energy(self.shape, self._options.height)
            energy = energy + HEIGHT_WEIGHT * off
        if self._clip.landmarks is not None:
            off = self._clip.landmarks.energy(self.landmark_offsets) / len(self.frames)
            energy = energy + LANDMARK_WEIGHT * off
        return energy


SMOOTHNESS = 1.6e-4  # a, for one (1/m)²; chosen by eye
# b and c, for one square metre. Chosen: cloth may stand off by decimetres, and hardly enters.
SMALLNESS, OUTWARDNESS = 10.0, 400.0


class Displacement:
    """The displacement ``D`` and its energy.

    ``raw`` (V, 3) is the leaf that an optimiser may move; ``D`` equals it, but is zero where the
    body is bare.
    """

    def __init__(self, vertices: Tensor, faces: Tensor, bare: Tensor) -> None:
        """Start at zero on a rest surface (V, 3), metres; ``bare`` (V,) in [0, 1]."""
        exact = vertex_normals(vertices.detach().double(), faces)
        self._normals = exact.to(vertices.dtype)
        ends = vertices[faces], vertices[faces.roll(1, dims=1)]
        self._square_edge = float((ends[0] - ends[1]).square().sum(-1).mean())
        self._laplacian = uniform_laplacian(faces.numpy(), len(vertices))
        self._free = (1 - bare)[:, None]
        self.raw = torch.zeros_like(vertices).requires_grad_()

    @property
    def offsets(self) -> Tensor:
        """``D`` (V, 3), metres."""
        return self.raw * self._free

    def energy(self, offsets: Tensor) -> Tensor:
        """Return ``E(D)``."""
        bent = torch.sparse.mm(self._laplacian, offsets).square().sum() / self._square_edge**2
        inward = (offsets * self._normals).sum(1).clamp_max(0).square().sum()
        total = SMOOTHNESS * bent + SMALLNESS * offsets.square().sum() + OUTWARDNESS * inward
        return total / len(offsets)
