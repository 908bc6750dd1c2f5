"""A subject's video before it is rendered: poses, surfaces and cameras of every exposure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera
from gva_mi.synthetic.motion import motions
from gva_mi.synthetic.options import EXPOSURE_MOMENTS, SubjectStream, SynthOptions
from gva_mi.synthetic.person.surface import LAG_STEPS, PersonSurface
from gva_mi.synthetic.pictures.cameras import PhoneCamera, camera_around, held_by_hand
from gva_mi.synthetic.pictures.render import Moment
from gva_mi.synthetic.pictures.room import Room, draw_room

VERTEX_STRIDE = 11  # chosen: every 11th vertex finds the ground and places a camera


@dataclass(frozen=True)
class Staging:
    """A subject's video before it is rendered. Moments are in rounds of the motion."""

    options: SynthOptions
    body: BodyModel  # that the subject is drawn on
    subject: PersonSurface

    def points(self, pose: Pose) -> np.ndarray:
        """Return some points of the surface without folds, (T, n, 3), metres."""
        index = np.arange(0, len(self.subject.vertices), VERTEX_STRIDE)
        return self.subject.skinned(self.body, pose, index)

    @cached_property
    def poses(self) -> list[Pose]:
        """The video's poses, and those one step, two steps, ... before its frames."""
        return self.poses_at(motions.times(self.options.frames))

    @cached_property
    def _lowest(self) -> np.ndarray:
        """The height of the lowest point of each frame before it is put on the ground, (T,)."""
        lowest = self.points(self._performed(motions.times(self.options.frames)))[..., 1].min(1)
        if self.options.motion in motions.ON_TURNTABLE:
            lowest = np.full_like(lowest, lowest.min())
        return lowest

    def _performed(self, t: np.ndarray) -> Pose:
        joints = self.body.rest(self.subject.shape).joints.numpy()
        rng, expressions = self.options.random(SubjectStream.MOTION), self.body.num_expressions
        return motions.perform(self.options.motion, t, joints, expressions, rng)

    def poses_at(self, t: np.ndarray) -> list[Pose]:
        """Return the poses at moments (T,), and those one step, two steps, ... before."""
        frames, found = motions.times(self.options.frames), []
        for k in range(LAG_STEPS + 1):
            at = motions.before(t, k)
            drop = np.interp(at, frames, self._lowest, period=1)
            found.append(lowered(self._performed(at), drop.astype("f4")))
        return found

    @cached_property
    def phone(self) -> PhoneCamera:
        """The phone of a video in a room."""
        rng, points = self.options.random(SubjectStream.CAMERA), self.points(self.poses[0])
        return PhoneCamera.draw(rng, points, self.options.size)

    def cameras_at(self, t: np.ndarray) -> list[Camera]:
        """Return the cameras at moments (T,): all the same, held by hand, or on a circle."""
        options = self.options
        if options.camera == "held":
            hand = held_by_hand(np.random.default_rng([*options.entropy(SubjectStream.CAMERA), 1]))
            return [self.phone.camera(*hand(seconds)) for seconds in t * motions.ROUND_SECONDS]
        if options.scene == "room":
            return [self.phone.camera()] * len(t)
        points = self.points(self.poses[0])
        if options.camera == "circles":
            return [camera_around(points, options.size, 2 * np.pi * turn) for turn in t % 1.0]
        return [camera_around(points, options.size)] * len(t)

    @cached_property
    def cameras(self) -> list[Camera]:
        """The video's cameras, one a frame."""
        return self.cameras_at(motions.times(self.options.frames))

    def room(self) -> Room | None:
        """Draw the room around the subject; None for a video on white."""
        if self.options.scene == "white":
            return None
        points, rng = self.points(self.poses[0]), self.options.random(SubjectStream.ROOM)
        return draw_room(rng, self.subject.look.person, points, self.cameras)

    @property
    def height(self) -> float:
        """The person's height at rest, metres."""
        rest = self.body.rest(self.subject.shape).vertices[:, 1]
        return float(rest.max() - rest.min())

    def exposures(self) -> Iterator[tuple[Moment, ...]]:
        """Yield the moments of each frame of the video: several while the shutter is open."""
        share = self.options.shutter / self.options.frames
        if share == 0:
            yield from self.still(self.poses, self.cameras)
            return
        t = motions.times(self.options.frames)
        steps = (np.arange(EXPOSURE_MOMENTS) + 0.5) / EXPOSURE_MOMENTS
        opens, closes = (self.poses_at(t + 0.5 * side * share) for side in (-1, 1))
        cameras = [self.cameras_at(t + (step - 0.5) * share) for step in steps]
        for k in range(len(t)):
            first, last = (self._surface(poses, k) for poses in (opens, closes))
            between = [first + np.float32(step) * (last - first) for step in steps]
            seen = zip(between, cameras, strict=True)
            yield tuple(Moment(surface, of_step[k]) for surface, of_step in seen)

    def still(self, poses: Sequence[Pose], cameras: Sequence[Camera]) -> Iterator[tuple[Moment]]:
        """Yield the one moment of each frame of poses as :meth:`poses_at` returns them."""
        for k, camera in enumerate(cameras):
            yield (Moment(self._surface(poses, k), camera),)

    def _surface(self, poses: Sequence[Pose], k: int) -> np.ndarray:
        """Return the surface of frame k, (N, 3) float32, metres."""
        now, *past = (pose[k] for pose in poses)
        return self.subject.posed(self.body, now, past)[0]


def lowered(pose: Pose, drop: np.ndarray) -> Pose:
    """Move poses down by ``drop`` (T,), metres."""
    transl = pose.transl.clone()
    transl[:, 1] -= torch.from_numpy(drop)
    return replace(pose, transl=transl)
