"""Poses and faces of a fit: given, or trained along with the avatar.

Masks and normals leave errors in poses, and errors blur the avatar, which becomes the mean of
frames that do not quite agree. So the gradient of each step (Eq. 9) also updates the corrections of
its frame's pose, as in the refinement (:mod:`gva_mi.refine.corrections`). After every ``every``
steps of the fit, poses take a step of their own on

    1. L = Σ_k [L_k(pose_k(δ, τ)) + ν E(δ, τ)]       k: the frames of these steps

where ``E`` is the energy of the corrections δ, τ under the prior of the motion, of joint limits and
of errors. The landmarks of the frames k are added with a weight of their own
(:mod:`gva_mi.fit.training_landmarks`). After some shares of the fit the prior is fitted again to
the corrections. Between two such steps poses do not change. So the skeletons of these frames are
posed together, and their gradients go back to the corrections together, in a quarter of the time.

* Stage-1 poses start at their MAP estimate, which is smoothed. Refined poses start as they are,
  because masks and normals of their frames have been used already.
* Frames outside the training split are not used. Their corrections follow from neighbouring
  frames: slow errors are corrected there too, errors that are new in every frame are not.
* Avatar and poses could drift together, such as all knees and the canonical legs, without changing
  a picture. So constant corrections are removed: turns in the axes of a joint, and shifts in the
  axes of the camera, or of the body while it turns. With ``constant`` they are kept, but for the
  person's distance. Poses of a phone video have large constant errors, and pictures show them,
  because its Gaussians are held near the body (:mod:`gva_mi.avatar.held`).

Jaw and expression are corrected too: :mod:`gva_mi.fit.faces`.

Cubic splines in time instead of the process prior fit the pictures as well, but leave larger pose
errors. Foot contacts, which the refinement has used, no longer change the result here.

Related work that alternates between poses and an avatar: GART (Lei et al. 2023), ExAvatar (Moon et
al. 2024), *Better Together* (2503.09293), HumanSplatHMR (2605.02784). Here the prior is the
refinement's: a Gaussian process in time whose smoothness is estimated from the video.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import islice
from typing import Annotated, Any

import torch
from torch import Tensor

from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import WRISTS, Pose
from gva_mi.body.smplx import Rest
from gva_mi.core.options import Metres, PythonOnly, Turn, Within, options_of
from gva_mi.fit.faces import Face
from gva_mi.fit.training_landmarks import TrainingLandmarks
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.clips import cut
from gva_mi.refine.corrections import Corrections
from gva_mi.refine.optimize import PriorWeight, optimiser
from gva_mi.refine.vector_adam import VectorAdam, lever_arms
from gva_mi.splat import Camera

# Chosen: corrections are sizeable by then, and half of the steps follow.
PRIOR_UPDATES = (0.3, 0.5)  # shares of all steps after which the prior is fitted again
STEP_DECAY = 0.1  # what is left of the step sizes at the end; chosen: poses settle
LANDMARK_WEIGHT = 40.0  # of landmarks beside E; chosen: pictures pull so much harder than E


@options_of("fit")
class PoseOptions:
    """Options of poses trained along with an avatar."""

    trained: bool = True  # False: poses stay as they were given
    # False: hands do not turn at the wrist; few pixels show where a hand is, but not its turn.
    wrists: PythonOnly[bool] = True
    # Steps of the fit per step of the poses.
    every: PythonOnly[Annotated[int, Within(1, 1_000_000)]] = 8
    prior_weight: PythonOnly[PriorWeight] = 1e-5  # ν: weight of the prior beside Eq. 9
    # Metres that a joint moves the skin beyond it, in a first step.
    step: PythonOnly[Metres] = 0.003
    # True: corrections that are the same in all frames are kept, but for the distance.
    constant: PythonOnly[bool] = False
    # Radians in such a step; limits joints with short lever arms.
    largest_turn: PythonOnly[Turn] = 0.03
    translation_lr: PythonOnly[Metres] = 0.002  # metres in a first step
    # Standard deviations of an expression in a first step; 0: jaw and expression stay as given.
    expression_lr: PythonOnly[Annotated[float, Within(0, 1)]] = 0.03
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
        seen: TrainingLandmarks | None = None,
        derived: Callable[[Pose], Any] = lambda pose: pose,
    ) -> None:
        """Start from the MAP estimate of the given poses, T frames, before any picture.

        ``steps`` is the number of steps of the fit. ``as_given``: start with refined bodies
        unchanged. (Faces, which a refinement leaves alone, start from the MAP estimate.) ``seen``:
        landmarks, if there are any. ``derived``: what a step of the fit uses of its pose, a
        dataclass of tensors (frames, ...), such as a skeleton.
        """
        self.given, self._options, self._steps = given, options, steps
        self._seen, self._derived = seen, derived
        self._clips: list[_Clip] = []
        if not options.trained:
            return
        anatomy = Anatomy.of(rig.joints)
        arms = lever_arms(Rest(rig.vertices, rig.joints), rig.weights, rig.parents)
        for frames in cut(len(given), options.part, overlap=0):
            stage1 = Stage1Poses.of(given, frames, cameras[frames.start])
            map_estimate = Corrections.map_estimate(stage1, anatomy)
            corrections = map_estimate.zeroed() if as_given else map_estimate
            face = Face.map_estimate(stage1) if options.expression_lr > 0 else Face(stage1, [])
            self._clips.append(_Clip(frames, corrections, face, seen, arms, options, derived))

    @property
    def trained(self) -> bool:
        """Whether poses are trained."""
        return bool(self._clips)

    def expect(self, frames: Iterable[int]) -> None:
        """Note the frames of the coming steps of the fit, which are then posed together."""
        if not any(clip.posed for clip in self._clips):
            expected = sorted(set(islice(frames, self._options.every)))
            for clip in self._clips:
                clip.derive([k - clip.frames.start for k in expected if k in clip.frames])

    def __call__(self, frame: int) -> Any:  # noqa: ANN401
        """Return what a step of the fit uses of one frame's pose: ``derived`` of it.

        Its tensors are leaves; the next step of the poses follows their gradients.
        """
        for clip in self._clips:
            if frame in clip.frames:
                return clip.drawn(frame - clip.frames.start)
        return self._derived(self.given[frame])

    def step(self, done: int) -> None:
        """Count a step of the fit, the ``done``-th, and step the poses when they are due."""
        options = self._options
        if done % options.every:
            return
        rounds = {round(at * self._steps / options.every) for at in PRIOR_UPDATES}
        for clip in self._clips:
            clip.step(options.prior_weight, STEP_DECAY ** (done / self._steps))
            if done // options.every in rounds:
                clip.learn(options)
        if self._seen is not None and done // options.every in rounds:
            self._seen.fit_offsets(self.all())

    @torch.no_grad()
    def all(self) -> Pose:
        """Return the current poses of all frames."""
        if not self._clips:
            return self.given
        return Pose.cat([clip.pose(range(len(clip.frames))) for clip in self._clips])

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        clips = [clip.state() for clip in self._clips]
        return {"clips": clips, "offsets": None if self._seen is None else self._seen.offsets}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore a :meth:`state`, to the bit."""
        for clip, saved in zip(self._clips, state["clips"], strict=True):
            clip.load_state(saved, self._options)
        if self._seen is not None:
            self._seen.offsets = state["offsets"]


class _Clip:
    """Frames that share a prior, and the corrections of their poses and faces.

    Frames are numbered within the clip. ``posed`` is what ``derived`` returns of those that were
    posed since the last step of the poses.
    """

    def __init__(
        self,
        frames: range,
        corrections: Corrections,
        face: Face,
        seen: TrainingLandmarks | None,
        arms: Tensor,
        options: PoseOptions,
        derived: Callable[[Pose], Any],
    ) -> None:
        self.frames, self.corrections, self.face = frames, corrections, face
        self._seen, self._arms, self._derived = seen, arms, derived
        self._constant = options.constant
        self._shown = set() if seen is None else set(seen.frames_among(frames))
        self._learned: list[tuple[Tensor, Tensor, list[Tensor]]] = []  # corrections of each update
        self._adam = self._optimiser(options)
        self.posed: dict[int, Any] = {}
        # A frame and its leaves for each step of the fit since then.
        self._drawn: list[tuple[int, Any]] = []

    def pose(self, which: Sequence[int]) -> Pose:
        """Return poses of frames of the clip, differentiable in the corrections."""
        return self.face.corrected(self.corrections.pose(which), which)

    @torch.no_grad()
    def derive(self, which: Sequence[int]) -> None:
        """Pose frames of the clip together."""
        if which:
            derived = self._derived(self.pose(which))
            for row, k in enumerate(which):
                self.posed[k] = _each(lambda x, row=row: x[row : row + 1], derived)

    def drawn(self, k: int) -> Any:  # noqa: ANN401
        """Return what ``derived`` returns of frame k, as leaves."""
        if k not in self.posed:
            self.derive([k])
        leaves = _each(lambda x: x.clone().requires_grad_(), self.posed[k])
        self._drawn.append((k, leaves))
        return leaves

    def step(self, prior_weight: float, factor: float) -> None:
        """Take a step on eq. 1, with the gradients that the leaves received."""
        found = [(k, _gradients(leaves)) for k, leaves in self._drawn]
        found = [(k, gradients) for k, gradients in found if gradients]
        self._drawn, self.posed = [], {}
        if not found:
            return
        which = [k for k, _ in found]
        bodies, energy = self.corrections.poses_with_energy()
        energy = energy + self.face.energy()
        loss = prior_weight * len(found) * energy
        if shown := [k for k in which if k + self.frames.start in self._shown]:
            seen = self._seen.losses(bodies[shown], [k + self.frames.start for k in shown])
            loss = loss + prior_weight * LANDMARK_WEIGHT * seen.sum()
        derived = self._derived(self.face.corrected(bodies[which], which))
        for row, (_, gradients) in enumerate(found):
            for name, gradient in gradients.items():
                loss = loss + (gradient[0] * getattr(derived, name)[row]).sum()
        loss.backward()
        self._adam.step(factor)
        if self._constant:
            self.corrections.keep_distance()
        else:
            self.corrections.centre()
        self.face.centre()

    def learn(self, options: PoseOptions) -> None:
        self._update_prior(*self.corrections.found(), self.face.found(), options)

    def state(self) -> dict[str, Any]:
        leaves = self._leaves()
        return {
            "learned": self._learned,
            "start": self.corrections.start,
            "face": [part.start for part in self.face.parts],
            "leaves": [leaf.detach() for leaf in leaves],
            "posed": list(self.posed),
            "drawn": [(k, _gradients(leaves)) for k, leaves in self._drawn],
            "adam": self._adam.state(),
        }

    def load_state(self, state: dict[str, Any], options: PoseOptions) -> None:
        for turns, moves, face in state["learned"]:
            self._update_prior(turns, moves, face, options)
        self.corrections.start = state["start"]
        for part, start in zip(self.face.parts, state["face"], strict=True):
            part.start = start
        with torch.no_grad():
            for leaf, value in zip(self._leaves(), state["leaves"], strict=True):
                leaf.copy_(value)
        self.derive(state["posed"])  # together again: the same bits
        for k, gradients in state["drawn"]:
            leaves = self.drawn(k)
            for name, gradient in gradients.items():
                getattr(leaves, name).grad = gradient
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


def _each(function: Callable[[Tensor], Tensor], record: Any) -> Any:  # noqa: ANN401
    """Apply a function to all tensors of a dataclass."""
    return replace(record, **{name: function(x) for name, x in vars(record).items()})


def _gradients(leaves: Any) -> dict[str, Tensor]:  # noqa: ANN401
    """Return the gradients of a dataclass of leaves, of those that have one."""
    return {name: x.grad for name, x in vars(leaves).items() if x.grad is not None}
