"""The poses of a fit: as they were given, or trained along with the avatar.

Masks and normals leave errors in poses, and errors blur the avatar, which becomes the mean of
frames that do not quite agree. So the gradient of each step (Eq. 9) also updates the corrections of
its frame's pose, as in the refinement (:mod:`gva_mi.pose.corrections`). After every ``every`` steps
of the fit, poses take a step of their own on

    L = Σ_k [L_k(pose_k(δ, τ)) + ν E(δ, τ)]       k: the frames of these steps

where ``E`` is the energy of the corrections δ, τ under the prior of the motion, of joint limits and
of errors. After some shares of the fit the prior is fitted again to the corrections.

* Stage-1 poses start at their MAP estimate, which is smoothed. Refined poses start as they are,
  because masks and normals of their frames have been used already.
* Frames outside the training split are not used. Their corrections follow from neighbouring
  frames: slow errors are corrected there too, errors that are new in every frame are not.
* Avatar and poses could drift together, such as all knees and the canonical legs, without changing
  a picture. So constant corrections are removed: turns in the axes of a joint, and shifts in the
  axes of the camera, or of the body while it turns.
* Jaw and expression are corrected likewise (:mod:`gva_mi.fit.faces`); eyes stay.

Cubic splines in time instead of the process prior fit the pictures as well, but leave larger pose
errors. Foot contacts, which the refinement has used, no longer change the result here.

Related work that alternates between poses and an avatar: GART (Lei et al. 2023), ExAvatar (Moon et
al. 2024), *Better Together* (2503.09293), HumanSplatHMR (2605.02784). Here the prior is that of the
refinement, a Gaussian process in time whose smoothness is estimated from the video.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import torch
from torch import Tensor

from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import WRISTS, Pose
from gva_mi.body.smplx import Rest
from gva_mi.core.options import Metres, PythonOnly, Turn, Within, options_of
from gva_mi.fit.faces import Face
from gva_mi.pose.clips import cut
from gva_mi.pose.corrections import Corrections
from gva_mi.pose.optimize import PriorWeight, optimiser
from gva_mi.pose.optimizer import VectorAdam, lever_arms
from gva_mi.pose.prior.anatomy import Anatomy
from gva_mi.pose.stage1 import Stage1
from gva_mi.splat import Camera

LEARN_AT = (0.3, 0.5)  # shares of all steps after which the prior is fitted again
DECAY = 0.1  # what is left of the step sizes at the end


@options_of("fit")
class PoseOptions:
    """Options of poses trained along with an avatar."""

    trained: bool = True  # False: poses stay as they were given
    # False: hands do not turn at the wrist; few pixels show where a hand is, but not its turn.
    wrists: bool = True
    # Steps of the fit per step of the poses.
    every: Annotated[int, Within(1, 1_000_000)] = 8
    prior_weight: PriorWeight = 1e-5  # ν: weight of the prior beside Eq. 9
    # Metres that a joint moves the skin beyond it, in a first step.
    step: PythonOnly[Metres] = 0.003
    # Radians in such a step; limits joints with short lever arms.
    largest_turn: PythonOnly[Turn] = 0.03
    translation_lr: PythonOnly[Metres] = 0.002  # metres in a first step
    # Standard deviations of an expression in a first step; 0: jaw and expression stay as given.
    expression_lr: Annotated[float, Within(0, 1)] = 0.03
    part: PythonOnly[Annotated[int, Within(2, 10_000)]] = 240  # frames that share a prior


class TrainedPoses:
    """The poses of all frames of a fit.

    Attributes:
        given: as they were given.
    """

    def __init__(
        self,
        given: Pose,
        cameras: Sequence[Camera],
        rig: Rig,
        options: PoseOptions,
        steps: int,
        *,
        as_given: bool = False,
    ) -> None:
        """Start from the MAP estimate of the given poses, T frames, before any picture.

        ``steps`` counts those of the whole fit. ``as_given``: start with refined bodies as they
        are. (Faces, which a refinement leaves alone, start from the MAP estimate.)
        """
        self.given, self._options, self._steps = given, options, steps
        self._clips: list[_Clip] = []
        if not options.trained:
            return
        anatomy = Anatomy.of(rig.joints)
        arms = lever_arms(Rest(rig.vertices, rig.joints), rig.weights, rig.parents)
        for frames in cut(len(given), options.part, overlap=0):
            stage1 = Stage1.of(given, frames, cameras[frames.start])
            map_estimate = Corrections.map_estimate(stage1, anatomy)
            corrections = map_estimate.zeroed() if as_given else map_estimate
            face = Face.map_estimate(stage1) if options.expression_lr > 0 else Face(stage1, [])
            self._clips.append(_Clip(frames, corrections, face, arms, options))

    @property
    def trained(self) -> bool:
        """Whether poses are trained."""
        return bool(self._clips)

    def __call__(self, frame: int) -> Pose:
        """Return the pose of one frame, differentiable in its corrections."""
        for clip in self._clips:
            if frame in clip.frames:
                return clip.pose([frame - clip.frames.start])
        return self.given[frame]

    def step(self, done: int, frame: int) -> None:
        """Count a step of the fit, the ``done``-th, on one frame, and step the poses when they are
        due.
        """
        options = self._options
        for clip in self._clips:
            clip.waiting += frame in clip.frames
        if done % options.every:
            return
        rounds = {round(at * self._steps / options.every) for at in LEARN_AT}
        for clip in self._clips:
            clip.step(options.prior_weight, DECAY ** (done / self._steps))
            if done // options.every in rounds:
                clip.learn(options)

    @torch.no_grad()
    def all(self) -> Pose:
        """Return the current poses of all frames."""
        if not self._clips:
            return self.given
        found = [clip.pose(range(len(clip.frames))) for clip in self._clips]
        return Pose.cat(found)

    def state(self) -> list[dict[str, Any]]:
        """Return the state for a checkpoint."""
        return [clip.state() for clip in self._clips]

    def load_state(self, state: list[dict[str, Any]]) -> None:
        """Restore a :meth:`state`, to the bit."""
        for clip, saved in zip(self._clips, state, strict=True):
            clip.load_state(saved, self._options)


class _Clip:
    """Frames that share a prior, and the corrections of their poses and faces.

    ``waiting`` counts steps of the fit on these frames since the last step of the poses.
    """

    def __init__(
        self,
        frames: range,
        corrections: Corrections,
        face: Face,
        arms: Tensor,
        options: PoseOptions,
    ) -> None:
        self.frames, self.corrections, self.face, self.waiting = frames, corrections, face, 0
        self._arms = arms
        self._learned: list[tuple[Tensor, Tensor, list[Tensor]]] = []  # corrections of each update
        self._adam = self._optimiser(options)

    def pose(self, which: Sequence[int]) -> Pose:
        """Return poses of some frames by their places, differentiable in the corrections."""
        return self.face.corrected(self.corrections.pose(which), which)

    def step(self, prior_weight: float, factor: float) -> None:
        if self.waiting:
            energy = self.corrections.energy() + self.face.energy()
            (prior_weight * self.waiting * energy).backward()
            self._adam.step(factor)
            self.corrections.centre()
            self.face.centre()
            self.waiting = 0

    def learn(self, options: PoseOptions) -> None:
        self._update_prior(*self.corrections.found(), self.face.found(), options)

    def state(self) -> dict[str, Any]:
        leaves = self._leaves()
        return {
            "learned": self._learned,
            "start": self.corrections.start,
            "face": [part.start for part in self.face.parts],
            "leaves": [leaf.detach() for leaf in leaves],
            "gradients": [leaf.grad for leaf in leaves],
            "waiting": self.waiting,
            "adam": self._adam.state(),
        }

    def load_state(self, state: dict[str, Any], options: PoseOptions) -> None:
        for turns, moves, face in state["learned"]:
            self._update_prior(turns, moves, face, options)
        self.corrections.start = state["start"]
        for part, start in zip(self.face.parts, state["face"], strict=True):
            part.start = start
        held = zip(self._leaves(), state["leaves"], state["gradients"], strict=True)
        for leaf, value, gradient in held:
            with torch.no_grad():
                leaf.copy_(value)
            leaf.grad = gradient
        self.waiting = state["waiting"]
        self._adam.load_state(state["adam"])

    def _update_prior(
        self, turns: Tensor, moves: Tensor, face: list[Tensor], options: PoseOptions
    ) -> None:
        self._learned.append((turns, moves, face))
        self.corrections = self.corrections.with_updated_prior(turns, moves)
        self.face = self.face.with_updated_prior(face)
        self._adam = self._optimiser(options)

    def _leaves(self) -> list[Tensor]:
        return [self.corrections.turns, self.corrections.moves, *(p.u for p in self.face.parts)]

    def _optimiser(self, options: PoseOptions) -> VectorAdam:
        shared, still = self.face.leaves(self._arms, options), [] if options.wrists else WRISTS
        return optimiser(self.corrections, self._arms, options, unseen=still, shared=shared)
