"""What stage 1 is corrected by: turns of all joints and a shift, in every frame.

1. ``R_k,i = R_k,i^stage1 exp(δ_k,i)``,    ``t_k = t_k^stage1 + τ_k``
2. ``A_k,i δ_k,i = δ⁰_k,i + Σ_l M_i,kl u_l,i``,    ``τ`` the same way

``A_k,i`` turns a vector to the camera's axes, by stage 1. There, each coordinate may have steps of
its own: pictures show how a limb swings across the line of sight, and how far aside a person
stands, much better than how it leans toward the camera, and how deep. Coordinates that pictures
show weakly would hardly move if they shared their steps with the others.

The coordinates ``u`` (by ``M``), and the energy that corrections cost, come from what is believed
of this video (:mod:`gva_mi.pose.inference`, :mod:`gva_mi.pose.belief`), and the energy from what
bodies can do, too (:mod:`gva_mi.pose.anatomy`), from the ground they stand on
(:mod:`gva_mi.pose.ground`), and from their not heeding the camera (:mod:`gva_mi.pose.camera_lean`).
``δ⁰`` are corrections that are known before: those of the greatest probability when no picture has
been looked at, and later those that were found before beliefs changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import roma
import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.body.so3 import compose
from gva_mi.pose.anatomy import Anatomy
from gva_mi.pose.ground import Ground, Soles
from gva_mi.pose.inference import JOINTS, PELVIS, Beliefs, from_pictures, from_stage1
from gva_mi.pose.stage1 import Stage1, turns_between


class Corrections:
    """``δ`` and ``τ`` of some frames.

    Attributes:
        turns: (n, J, 3, 1) ``u``, a leaf.
        moves: (n, 3, 1) ``u`` of the shifts, a leaf. The last axis is what
            :class:`gva_mi.pose.vector_adam.VectorAdam` takes for a vector: each coordinate has
            steps of its own.
        start: ``δ⁰`` (n, J, 3) and ``τ⁰`` (n, 3), in the camera's axes.
        beliefs: what their energy is made of.
    """

    def __init__(
        self, stage1: Stage1, anatomy: Anatomy, beliefs: Beliefs, turns0: Tensor, moves0: Tensor
    ) -> None:
        """Start from corrections ``δ⁰`` (n, J, 3) and ``τ⁰`` (n, 3) in the camera's axes."""
        self._stage1, self._anatomy, self.beliefs = stage1, anatomy, beliefs
        self.start = turns0, moves0
        n, joints = turns0.shape[:2]
        own = stage1.in_joints(turns0)
        spread = torch.zeros(joints, n, n)  # the face stays
        spread[list(PELVIS)] = beliefs.pelvis.spread(own[:, list(PELVIS)])
        spread[list(JOINTS)] = beliefs.joints.spread(own[:, list(JOINTS)])
        self._spread, self._spread_moves = spread, beliefs.place.spread(moves0[..., None])
        self._precisions = [b.precision() for b in (beliefs.pelvis, beliefs.joints, beliefs.place)]
        self.turns = torch.zeros(n, joints, 3, 1).requires_grad_()
        self.moves = torch.zeros(n, 3, 1).requires_grad_()

    @staticmethod
    def likeliest(stage1: Stage1, anatomy: Anatomy) -> Corrections:
        """Where to start: what is most probable before any picture is looked at."""
        beliefs = from_stage1(stage1)
        given = stage1.pose.rotations
        own = torch.zeros(given.shape)
        own[:, list(PELVIS)], pelvis = beliefs.pelvis.likeliest()
        own[:, list(JOINTS)], joints = beliefs.joints.likeliest()
        moves, place = beliefs.place.likeliest()
        beliefs = replace(beliefs, pelvis=pelvis, joints=joints, place=place)
        covariance = torch.zeros(given.shape[1], *[len(given)] * 2, dtype=torch.float64)
        covariance[list(JOINTS)] = joints.covariance(own[:, list(JOINTS)])
        likely = roma.rotvec_composition([given, own])
        wanted = anatomy.conditioned(likely, covariance, stage1.times)
        own = turns_between(given, wanted)
        return Corrections(stage1, anatomy, beliefs, stage1.in_camera(own), moves[..., 0])

    def none_yet(self) -> Corrections:
        """The same beliefs, with nothing corrected: stage 1 as it is."""
        turns0, moves0 = (torch.zeros_like(x) for x in self.start)
        return Corrections(self._stage1, self._anatomy, self.beliefs, turns0, moves0)

    @torch.no_grad()
    def found(self) -> tuple[Tensor, Tensor]:
        """``A δ`` (n, J, 3) and ``τ`` (n, 3) as they are by now, in the camera's axes."""
        return self._at(range(len(self.moves)))

    @torch.no_grad()
    def centre(self) -> None:
        """Take away what a person of another shape would show in the same pictures.

        That are turns of a joint that are the same in all frames, in its own axes, and shifts that
        are, in the camera's axes or in the pelvis's: a body a centimetre behind its pelvis, with
        all pelvises a centimetre farther to the front.
        """
        turns, moves = self.found()
        mean = self._stage1.in_joints(turns).mean(0).expand_as(turns)
        turns0, moves0 = self.start
        constant = constant_shifts(moves, self._stage1.R_joint_camera[:, 0])
        self.start = turns0 - self._stage1.in_camera(mean), moves0 - constant

    @torch.no_grad()
    def told_by(self, turns: Tensor, moves: Tensor) -> Corrections:
        """Corrections that pictures have :meth:`found`, under what they tell of the video."""
        beliefs = from_pictures(self.beliefs, self._stage1, turns, moves)
        return Corrections(self._stage1, self._anatomy, beliefs, turns, moves)

    @torch.no_grad()
    def stand_on(self, soles: Soles) -> None:
        """From now on, soles cost what they are off the ground that these corrections show."""
        stage1, pose = self._stage1, self.pose(range(len(self.moves)))
        ground = Ground.under(soles, pose, stage1.times, stage1.R_camera_world)
        self.beliefs = replace(self.beliefs, ground=ground)

    def pose(self, which: Sequence[int]) -> Pose:
        """Eq. 1 for some of the frames, differentiable in the leaves.

        Args:
            which: places of the frames among the n that are corrected.
        """
        return self._stage1.corrected(which, *self._at(which))

    def energy(self, distance_shown: bool = False) -> Tensor:
        """What the corrections cost in nats, a mean over the frames.

        Args:
            distance_shown: whether what they agree with tells how far away the person stands.
        """
        turns, moves = self._at(range(len(self.moves)))
        own, beliefs = self._stage1.in_joints(turns), self.beliefs
        of_pelvis, of_joints, of_place = self._precisions
        pelvis, joints, places = list(PELVIS), list(JOINTS), moves[..., None]
        nats = beliefs.pelvis.energy(of_pelvis, turns[:, pelvis], own[:, pelvis])
        nats = nats + beliefs.joints.energy(of_joints, turns[:, joints], own[:, joints])
        nats = nats + beliefs.place.energy(of_place, places, places)
        rotations = compose(self._stage1.pose.rotations, own)
        nats = nats + self._anatomy.energy(rotations, self._stage1.times)
        if beliefs.ground is not None:
            transl = self._stage1.pose.transl + moves @ self._stage1.R_camera_world
            nats = nats + beliefs.ground.energy(rotations, transl)
        held = self._held(turns[:, pelvis].mean((0, 1)), None if distance_shown else moves.mean(0))
        return nats / len(moves) + held + beliefs.lean.energy(rotations)

    def same_in_all(self) -> Tensor:
        """What turns that joints make in all frames would cost if each frame told them anew, nats.

        As :meth:`energy`, a mean over the frames. It is for a descent that does not know yet what
        the person wears: a skirt that widens toward its hem, or a sole, looks like legs that lean
        toward the camera, from every side of a person who turns. So it counts in the measure in
        which they do: 1 where they turn round once, 0 where they do not turn.
        """
        mean = self._at(range(len(self.moves)))[0][:, list(JOINTS)].mean(0)
        variance = self.beliefs.joints.variance_of_mean(bias=True)
        return self._stage1.turned * (mean.square().sum(-1) / variance).sum() / 2

    def _held(self, turn: Tensor, shift: Tensor | None) -> Tensor:
        """What a turn (3,) and a shift (3,) of the person in all frames cost, in each of them.

        Many pictures tell them no better than one. A person who is larger and farther away looks
        the same in all of them, and trousers that widen toward their hems look like feet that are
        nearer than the head. So the mean over stage 1's frames is believed in every one of them.
        No other joint's is: legs that lean toward the camera from every side of a person who turns
        are a motion, one that knows of the camera, which costs in every frame for the same reason.
        """
        pelvis, place = self.beliefs.pelvis, self.beliefs.place
        nats = (turn.square() / pelvis.variance_of_mean(bias=True)).sum() / 2
        if shift is not None:
            nats = nats + (shift.square() / place.variance_of_mean(bias=False)).sum() / 2
        return nats

    def _at(self, which: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Eq. 2 for r of the frames: turns (r, J, 3), shifts (r, 3), in the camera's axes."""
        which = list(which)
        turns = (self._spread[:, which] @ self.turns[..., 0].transpose(0, 1)).transpose(0, 1)
        moves = (self._spread_moves[:, which] @ self.moves.transpose(0, 1))[..., 0].T
        turns0, moves0 = self.start
        return turns0[which] + turns, moves0[which] + moves


def constant_shifts(shifts: Tensor, R_body_camera: Tensor) -> Tensor:
    """What of some shifts (n, 3) is constant: (n, 3) ``a + R_kᵀ b`` of the least squares.

    Args:
        shifts: of n frames, in the axes of the camera.
        R_body_camera: (n, 3, 3) ``R_k``, takes a vector in these axes to those of the body.
    """
    R = R_body_camera.double()
    basis = torch.cat([torch.eye(3, dtype=R.dtype).expand_as(R), R.mT], dim=2).reshape(-1, 6)
    # Of someone who does not turn, both are the same three columns.
    inverse = torch.linalg.pinv(basis.T @ basis, rtol=1e-6, hermitian=True)
    found = inverse @ (basis.T @ shifts.double().reshape(-1))
    return (basis @ found).reshape(shifts.shape).to(shifts)
