"""Other things that the numbers of a folder may mean: axes, units, pictures turned or mirrored.

Each reading changes what is compared and nothing on disk. One that fits while the plain one does
not says what is wrong, and how to write it. With T for ``T_camera_world``, F = diag(1, -1, -1) and
Q a quarter turn about x:

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

from gva_mi.data.check.seen import Seen
from gva_mi.splat import Camera

EVENLY = 0.1  # by which the scales of width and height may differ: lenses are not quite centred
_F = np.diag([1.0, -1.0, -1.0, 1.0])
_Q = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # z up becomes y up


@dataclass(frozen=True)
class Reading:
    """One other meaning."""

    what: str  # the fault, as a finding names it
    cause: str
    remedy: str
    apply: Callable[[Seen], Seen]
    moves_pictures: bool = False  # masks are other ones, or elsewhere: normals do not follow


def _transformed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Seen], Seen]:
    def apply(seen: Seen) -> Seen:
        moved = [replace(c, T_camera_world=change(c.T_camera_world)) for c in seen.cameras]
        return replace(seen, cameras=tuple(moved))

    return apply


def _shorter(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda T: T * np.array([[1.0, 1.0, 1.0, 1 / factor]] * 3 + [[1.0] * 4])


def _body_shorter(factor: float) -> Callable[[Seen], Seen]:
    return lambda s: replace(s, pose=replace(s.pose, transl=s.pose.transl / factor))


def _masks(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Seen], Seen]:
    return lambda seen: replace(seen, masks=np.ascontiguousarray(change(seen.masks)))


def _in_degrees(seen: Seen) -> Seen:
    return replace(seen, pose=replace(seen.pose, rotations=seen.pose.rotations * (np.pi / 180)))


def _centred(seen: Seen) -> Seen:
    """Cameras whose K is of pictures so much larger that its axis meets their middle."""

    def times(c: Camera) -> tuple[float, float]:
        return c.width / (2 * c.cx), c.height / (2 * c.cy)

    def scaled(c: Camera) -> Camera:
        x, y = times(c)
        return replace(c, fx=c.fx * x, fy=c.fy * y, cx=c.width / 2, cy=c.height / 2)

    if not all(c.cx > 0 and c.cy > 0 for c in seen.cameras):
        return seen
    if any(abs(x / y - 1) > EVENLY for x, y in map(times, seen.cameras)):
        return seen  # a crop, or another picture: no scale explains it
    return replace(seen, cameras=tuple(map(scaled, seen.cameras)))


def _units(unit: str, factor: float) -> tuple[Reading, ...]:
    return (
        Reading(
            f"poses in {unit}", f"transl is in {unit}", f"divide transl by {factor:g}: metres",
            _body_shorter(factor),
        ),
        Reading(
            f"cameras in {unit}", f"T_camera_world's translation is in {unit}",
            f"divide it by {factor:g}: metres", _transformed(_shorter(factor)),
        ),
    )  # fmt: skip


# Tried where the plain reading does not fit; the first of equals wins.
COARSE: tuple[Reading, ...] = (
    Reading(
        "T_camera_world is inverted", "the file holds T_world_camera, the camera's place",
        "write its inverse: x_camera = T_camera_world x_world", _transformed(np.linalg.inv),
    ),
    Reading(
        "cameras in OpenGL's axes", "y is up and z backward in the camera",
        "flip the second and third row of T_camera_world", _transformed(lambda T: _F @ T),
    ),
    Reading(
        "T_camera_world is inverted, in OpenGL's axes", "the file holds the camera's place, as "
        "NeRF's transforms do", "invert T, then flip its second and third row",
        _transformed(lambda T: _F @ np.linalg.inv(T)),
    ),
    Reading(
        "poses in a world with y down", "the poses' world has the camera's axes, y down",
        "turn the poses by half a turn about x, or T_camera_world with them",
        _transformed(lambda T: T @ _F),
    ),
    Reading(
        "poses in the camera's axes", "T_camera_world is applied to them already",
        "write T_camera_world = 1, or take the poses to the world",
        _transformed(lambda T: np.eye(4)),
    ),
    Reading(
        "poses in a world with z up", "z is up in the poses", "turn the poses so that y is up",
        _transformed(lambda T: T @ _Q),
    ),
    Reading(
        "poses in a world with z down", "z is down in the poses", "turn the poses so that y is up",
        _transformed(lambda T: T @ _Q.T),
    ),
    *_units("millimetres", 1000),
    *_units("centimetres", 100),
    Reading(
        "K is of another picture size", "its principal point is not the pictures' middle",
        "scale K with the pictures", _centred,
    ),
    Reading(
        "poses in degrees", "rotations are degrees", "axis-angle in radians", _in_degrees,
    ),
    Reading(
        "pictures upside down", "masks are turned by half a turn against the cameras",
        "turn pictures, masks and normals, or K and T_camera_world",
        _masks(lambda m: m[:, ::-1, ::-1]), moves_pictures=True,
    ),
    Reading(
        "y up and down", "rows of the masks run from below", "flip masks, pictures and normals",
        _masks(lambda m: m[:, ::-1]), moves_pictures=True,
    ),
    Reading(
        "inverted masks", "255 is the background", "write 255 where the person is",
        _masks(np.logical_not),
    ),
)  # fmt: skip

MIRRORED = Reading(
    "mirrored video", "the pictures were mirrored, as a selfie camera does, and the poses not",
    "mirror pictures, masks and normals", _masks(lambda m: m[:, :, ::-1]), moves_pictures=True,
)  # fmt: skip


def shifted(offset: int) -> Reading:
    """The pose of frame k belongs to the masks of frame ``k + offset``."""

    def apply(seen: Seen) -> Seen:
        places = {frame: i for i, frame in enumerate(seen.frames)}
        both = [(i, places.get(f + offset)) for i, f in enumerate(seen.frames)]
        kept = [(i, j) for i, j in both if j is not None]
        found = seen.of([i for i, _ in kept])
        return replace(found, masks=seen.masks[[j for _, j in kept]])

    return Reading(
        "frame offset", f"pose k belongs to frame k {offset:+d}",
        "cut the poses or the video so that both begin with the same frame", apply,
        moves_pictures=True,
    )  # fmt: skip
