"""The unknowns of refinement: a turn of every joint and a shift of the body, in every frame.

1. ``R_k,i = R_k,i^stage1 exp(δ_k,i)``,    ``t_k = t_k^stage1 + τ_k``
2. ``A_k,i δ_k,i = δ⁰_k,i + Σ_l M_i,kl u_l,i``,    ``τ`` in the same way

``A_k,i`` rotates a vector from a joint's axes to the camera's axes, by stage 1. In the camera's
axes each coordinate has its own step size. Images show rotations about the line of sight and
positions across it much better than tilts toward the camera and depth. With one step size for all,
coordinates that images show weakly would hardly move.

The preconditioner ``M`` and the energy of the corrections come from the prior of this video
(:mod:`gva_mi.prior.inference`, :mod:`gva_mi.prior.process`). The energy has further terms
of the corrected pose: anatomy, the ground and camera-locked tilt. ``δ⁰`` is where the optimisation
starts: first the MAP estimate without any image, later the corrections found before the prior was
updated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.body.so3 import compose, turns_between
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.error_model import Stage1ErrorModel
from gva_mi.prior.ground import Ground, Soles
from gva_mi.prior.inference import (
    CORRECTED_JOINTS,
    PELVIS,
    PosePrior,
    PriorTerm,
    prior_from_corrections,
    prior_from_stage1,
)
from gva_mi.prior.process import FrameMatrices
from gva_mi.prior.stage1_poses import Stage1Poses


class Corrections:
    """The corrections ``δ`` and ``τ`` of n frames, under a prior.

    ``turns`` (n, J, 3, 1) and ``moves`` (n, 3, 1) are leaves, ``u`` of eq. 2.
    :class:`gva_mi.refine.vector_adam.VectorAdam` takes the last axis for a vector, so each
    coordinate has its own step size. ``start`` is ``δ⁰`` (n, J, 3) and ``τ⁰`` (n, 3), in the
    camera's axes.
    """

    def __init__(
        self,
        stage1: Stage1Poses,
        anatomy: Anatomy,
        prior: PosePrior,
        turns0: Tensor,
        moves0: Tensor,
    ) -> None:
        """Start from corrections ``δ⁰`` (n, J, 3) and ``τ⁰`` (n, 3) in the camera's axes."""
        self._stage1, self._anatomy, self.prior = stage1, anatomy, prior
        self.start = turns0, moves0
        n, joints = turns0.shape[:2]
        joint_turns = stage1.to_joint_axes(turns0)
        M = torch.zeros(joints, n, n)  # the face stays
        M[PELVIS] = prior.pelvis.preconditioner(joint_turns[:, PELVIS]).M
        M[CORRECTED_JOINTS] = prior.joints.preconditioner(joint_turns[:, CORRECTED_JOINTS]).M
        self._preconditioner = FrameMatrices.of(M)
        self._preconditioner_of_moves = prior.place.preconditioner(moves0[..., None])
        self._precisions = [p.precision() for p in (prior.pelvis, prior.joints, prior.place)]
        self.turns = torch.zeros(n, joints, 3, 1).requires_grad_()
        self.moves = torch.zeros(n, 3, 1).requires_grad_()

    @staticmethod
    def map_estimate(
        stage1: Stage1Poses, anatomy: Anatomy, known: Mapping[str, Stage1ErrorModel] | None = None
    ) -> Corrections:
        """Start from the MAP estimate without any image; ``known`` errors are not inferred."""
        return Corrections._map_estimate(stage1, anatomy, prior_from_stage1(stage1, known))

    def with_less_lag(self, shares: Tensor) -> Corrections:
        """Return the MAP estimate under errors that grow less while a joint moves.

        ``shares`` (n,) in [0, 1] multiply the lag of the error model in each frame.
        """
        less = lambda process: process.with_less_lag(shares)
        prior = replace(self.prior, pelvis=less(self.prior.pelvis), joints=less(self.prior.joints))
        return Corrections._map_estimate(self._stage1, self._anatomy, prior)

    @staticmethod
    def _map_estimate(stage1: Stage1Poses, anatomy: Anatomy, prior: PosePrior) -> Corrections:
        given = stage1.pose.rotations
        joint_turns = torch.zeros(given.shape)
        joint_turns[:, PELVIS], pelvis = prior.pelvis.map_estimate()
        joint_turns[:, CORRECTED_JOINTS], joints = prior.joints.map_estimate()
        moves, place = prior.place.map_estimate()
        prior = replace(prior, pelvis=pelvis, joints=joints, place=place)
        covariance = torch.zeros(given.shape[1], *[len(given)] * 2, dtype=torch.float64)
        covariance[CORRECTED_JOINTS] = joints.covariance(joint_turns[:, CORRECTED_JOINTS])
        estimate = turns_between(-given, joint_turns)
        wanted = anatomy.conditioned(estimate, covariance, stage1.times)
        turns0 = stage1.to_camera_axes(turns_between(given, wanted))
        return Corrections(stage1, anatomy, prior, turns0, moves[..., 0])

    def zeroed(self) -> Corrections:
        """Return zero corrections under the same prior: the unchanged stage 1."""
        turns0, moves0 = (torch.zeros_like(x) for x in self.start)
        return Corrections(self._stage1, self._anatomy, self.prior, turns0, moves0)

    @torch.no_grad()
    def found(self) -> tuple[Tensor, Tensor]:
        """Return the current ``A δ`` (n, J, 3) and ``τ`` (n, 3), in the camera's axes."""
        return self._at(range(len(self.moves)))

    @torch.no_grad()
    def centre(self) -> None:
        """Remove corrections that another body shape would explain equally well.

        These are turns of a joint that are constant in its own axes, and shifts that are constant
        in the camera's axes or in the pelvis's: a body a centimetre behind its pelvis looks the
        same if all pelvises are a centimetre nearer.
        """
        turns, moves = self.found()
        mean = self._stage1.to_joint_axes(turns).mean(0).expand_as(turns)
        turns0, moves0 = self.start
        constant = constant_shifts(moves, self._stage1.R_joint_camera[:, 0])
        self.start = turns0 - self._stage1.to_camera_axes(mean), moves0 - constant

    @torch.no_grad()
    def keep_distance(self) -> None:
        """Remove the shift along the line of sight that all frames share.

        A larger person farther away looks the same in all of them.
        """
        turns0, moves0 = self.start
        away = self.found()[1].mean(0) * moves0.new_tensor([0, 0, 1])
        self.start = turns0, moves0 - away

    @torch.no_grad()
    def with_updated_prior(self, turns: Tensor, moves: Tensor) -> Corrections:
        """Return corrections that start where these are, with the prior inferred from them."""
        prior = prior_from_corrections(self.prior, self._stage1, turns, moves)
        return Corrections(self._stage1, self._anatomy, prior, turns, moves)

    @torch.no_grad()
    def variances(self) -> Tensor:
        """Return the prior's variances in each frame, (n, J + 3) float64.

        They are those of a coordinate of each turn, radians², zero for joints that are not
        corrected, and of the shift in the camera's axes, m².
        """
        turns, moves = self.found()
        joint_turns, prior = self._stage1.to_joint_axes(turns), self.prior
        of_turns = torch.zeros(turns.shape[:2], dtype=torch.float64)
        for joints, process in ((PELVIS, prior.pelvis), (CORRECTED_JOINTS, prior.joints)):
            covariance = process.covariance(joint_turns[:, joints])
            of_turns[:, joints] = covariance.diagonal(dim1=1, dim2=2).T
        of_shifts = prior.place.covariance(moves[..., None]).diagonal(dim1=1, dim2=2).T
        return torch.cat([of_turns, of_shifts], dim=1)

    @torch.no_grad()
    def fit_ground(self, soles: Soles) -> None:
        """Fit the ground to the current poses, and add its energy to the prior."""
        stage1, pose = self._stage1, self.pose(range(len(self.moves)))
        ground = Ground.under(soles, pose, stage1.times, stage1.R_camera_world)
        self.prior = replace(self.prior, ground=ground)

    def pose(self, which: Sequence[int]) -> Pose:
        """Return eq. 1 for some of the n frames by index, differentiable in the leaves."""
        return self._stage1.corrected(which, *self._at(which))

    def energy(self, distance_shown: bool = False) -> Tensor:
        """Return the prior energy of the corrections in nats, a mean over the frames.

        ``distance_shown``: whether the evidence shows how far away the person is.
        """
        return self.poses_with_energy(distance_shown)[1]

    def poses_with_energy(self, distance_shown: bool = False) -> tuple[Pose, Tensor]:
        """Return :meth:`pose` of all frames and :meth:`energy`, which share much of their work."""
        turns, moves = self._at(range(len(self.moves)))
        joint_turns, prior, stage1 = self._stage1.to_joint_axes(turns), self.prior, self._stage1
        of_pelvis, of_joints, of_place = self._precisions
        places = moves[..., None]
        nats = prior.pelvis.energy(of_pelvis, turns[:, PELVIS], joint_turns[:, PELVIS])
        joints = CORRECTED_JOINTS
        nats = nats + prior.joints.energy(of_joints, turns[:, joints], joint_turns[:, joints])
        nats = nats + prior.place.energy(of_place, places, places)
        rotations = compose(stage1.pose.rotations, joint_turns)
        motion = rotations, stage1.pose.transl + moves @ stage1.R_camera_world, stage1.times
        terms: list[PriorTerm] = [self._anatomy]
        for term in terms if prior.ground is None else [*terms, prior.ground]:
            nats = nats + term.energy(*motion)
        away = None if distance_shown else moves.mean(0)
        whole = self._whole_person_energy(turns[:, PELVIS].mean((0, 1)), away)
        tilt = prior.tilt.energy(*motion) if prior.tilt else self.constant_turn_energy()
        pose = Pose(*motion[:2], stage1.pose.expression)
        return pose, nats / len(moves) + whole + tilt

    def constant_turn_energy(self) -> Tensor:
        """Return the energy of turns that all frames share, in the camera's axes, nats.

        As :meth:`energy`, a mean over the frames: a skirt that widens toward its hem, or a sole,
        looks like legs that tilt toward the camera from every side of a person who turns. Many
        images determine such a tilt no better than one, so the errors' size is a prior in every
        frame. Its weight is how far the person turns: 1 for a full turn, 0 for none.
        """
        mean = self._at(range(len(self.moves)))[0][:, CORRECTED_JOINTS].mean(0)
        variance = self.prior.joints.variance_of_mean(bias=True)
        return self._stage1.turn_amount * (mean.square().sum(-1) / variance).sum() / 2

    def _whole_person_energy(self, turn: Tensor, shift: Tensor | None) -> Tensor:
        """Return the energy, in each frame, of a mean turn (3,) and shift (3,) of the whole person.

        Many images determine them no better than one: a larger person farther away looks the same
        in all of them, and trousers that widen toward their hems look like feet nearer than the
        head. So the mean over the frames of stage 1 is a prior in every frame. For other joints
        see :meth:`constant_turn_energy`, or the camera-locked tilt. The bias of the position counts
        only if it is known.
        """
        pelvis, place = self.prior.pelvis, self.prior.place
        nats = (turn.square() / pelvis.variance_of_mean(bias=True)).sum() / 2
        if shift is not None:
            variance = place.variance_of_mean(bias=self.prior.error_models["depth"].known)
            nats = nats + (shift.square() / variance).sum() / 2
        return nats

    def _at(self, which: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Return eq. 2 for r frames in the camera's axes: turns (r, J, 3), shifts (r, 3)."""
        which, u = list(which), self.turns[..., 0].transpose(0, 1)
        turns = self._preconditioner.product(u, which).transpose(0, 1)
        moves = self._preconditioner_of_moves.product(self.moves.transpose(0, 1), which)[..., 0].T
        turns0, moves0 = self.start
        return turns0[which] + turns, moves0[which] + moves


def constant_shifts(shifts: Tensor, R_body_camera: Tensor) -> Tensor:
    """Return the constant part (n, 3) of shifts: ``a + R_kᵀ b``, by least squares.

    The shifts (n, 3) are in the axes of the camera; ``R_k`` (n, 3, 3) rotates a vector from there
    to the axes of the body.
    """
    R = R_body_camera.double()
    basis = torch.cat([torch.eye(3, dtype=R.dtype).expand_as(R), R.mT], dim=2).reshape(-1, 6)
    # If the person does not turn, both halves are the same three columns.
    inverse = torch.linalg.pinv(basis.T @ basis, rtol=1e-6, hermitian=True)
    found = inverse @ (basis.T @ shifts.double().reshape(-1))
    return (basis @ found).reshape(shifts.shape).to(shifts)
