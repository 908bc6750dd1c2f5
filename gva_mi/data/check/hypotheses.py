"""Hypotheses about the numbers of a folder: other axes or units, pictures turned or mirrored.

A hypothesis changes the comparison and nothing on disk. If it fits and the folder as it is does
not, it names the fault. With T for ``T_camera_world``, F = diag(1, -1, -1) and Q a quarter turn
about x:

=============================  ================================================================
T⁻¹                            the file holds T_world_camera
F T, F T⁻¹                     cameras in OpenGL's axes, y up and z backward
T F, T Q, T Qᵀ                 poses in a world with y down, or with z up or down
1                              poses in the camera's axes already
t / 1000, t / 100              translations in millimetres or centimetres, of camera or body
=============================  ================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.data.check.frames import CheckedFrames
from gva_mi.data.check.numbers import centred
from gva_mi.splat import Camera

_F = np.diag([1.0, -1.0, -1.0, 1.0])
_Q = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # z up becomes y up
Change = Callable[[CheckedFrames], CheckedFrames]


@dataclass(frozen=True)
class Hypothesis:
    """One alternative meaning of the folder's numbers."""

    what: str  # the fault, as a problem names it
    cause: str
    remedy: str
    apply: Change
    moves_pictures: bool = False  # masks are others, or elsewhere: normals do not follow


def _cameras(change: Callable[[Camera], Camera]) -> Change:
    return lambda frames: replace(frames, cameras=tuple(map(change, frames.cameras)))


def _extrinsics(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return _cameras(lambda c: replace(c, T_camera_world=change(c.T_camera_world)))


def _body(**factors: float) -> Change:
    def apply(frames: CheckedFrames) -> CheckedFrames:
        scaled = {name: getattr(frames.pose, name) * x for name, x in factors.items()}
        return replace(frames, pose=replace(frames.pose, **scaled))

    return apply


def _masks(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda frames: replace(frames, masks=np.ascontiguousarray(change(frames.masks)))


def _units(unit: str, factor: float) -> tuple[Hypothesis, ...]:
    metres = f"divide it by {factor:g}: metres"
    shorter = np.array([[1.0, 1.0, 1.0, 1 / factor]] * 3 + [[1.0] * 4])
    return (
        Hypothesis(f"poses in {unit}", f"transl is in {unit}", metres, _body(transl=1 / factor)),
        Hypothesis(f"cameras in {unit}", f"T_camera_world's translation is in {unit}", metres,
                   _extrinsics(lambda T: T * shorter)),
    )  # fmt: skip


# Tried if the body is not where the masks are; the first of equals wins.
COARSE: tuple[Hypothesis, ...] = (
    Hypothesis("T_camera_world is inverted", "the file holds T_world_camera, the camera's place",
               "write its inverse: x_camera = T_camera_world x_world", _extrinsics(np.linalg.inv)),
    Hypothesis("cameras in OpenGL's axes", "y is up and z backward in the camera",
               "flip the second and third row of T_camera_world", _extrinsics(lambda T: _F @ T)),
    Hypothesis("T_camera_world is inverted, in OpenGL's axes", "the file holds the camera's place, "
               "as NeRF's transforms do", "invert T, then flip its second and third row",
               _extrinsics(lambda T: _F @ np.linalg.inv(T))),
    Hypothesis("poses in a world with y down", "the poses' world has the camera's axes, y down",
               "turn the poses by half a turn about x, or T_camera_world with them",
               _extrinsics(lambda T: T @ _F)),
    Hypothesis("poses in the camera's axes", "T_camera_world is applied to them already",
               "write T_camera_world = 1, or take the poses to the world",
               _extrinsics(lambda T: np.eye(4))),
    Hypothesis("poses in a world with z up", "z is up in the poses",
               "turn the poses so that y is up", _extrinsics(lambda T: T @ _Q)),
    Hypothesis("poses in a world with z down", "z is down in the poses",
               "turn the poses so that y is up", _extrinsics(lambda T: T @ _Q.T)),
    *_units("millimetres", 1000),
    *_units("centimetres", 100),
    Hypothesis("K is of another picture size", "its principal point is not the pictures' middle",
               "scale K with the pictures", _cameras(centred)),
    Hypothesis("poses in degrees", "rotations are degrees", "axis-angle in radians",
               _body(rotations=np.pi / 180)),
    Hypothesis("pictures upside down", "masks are turned by half a turn against the cameras",
               "turn pictures, masks and normals, or K and T_camera_world",
               _masks(lambda m: m[:, ::-1, ::-1]), moves_pictures=True),
    Hypothesis("y up and down", "rows of the masks run from below",
               "flip masks, pictures and normals", _masks(lambda m: m[:, ::-1]),
               moves_pictures=True),
)  # fmt: skip

MIRRORED = Hypothesis(
    "mirrored video", "the pictures were mirrored, as a selfie camera does, and the poses not",
    "mirror pictures, masks and normals", _masks(lambda m: m[:, :, ::-1]), moves_pictures=True,
)  # fmt: skip
