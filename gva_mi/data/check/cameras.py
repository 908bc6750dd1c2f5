"""Intrinsics that can be read, but are hardly those of these pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gva_mi.data.check.problems import Problem, doubt
from gva_mi.splat import Camera

# A lens's axis meets the middle of a picture to a few percent. K of a picture 1.25 times as large
# has it an eighth of the width away.
OFF_CENTRE = 0.12  # of width or height
ANAMORPHIC = 1.5  # fx over fy: the widest pixels of any video standard, 16:9 in PAL, are 1.46
EVENLY = 0.1  # by which the scales of width and height may differ: lenses are not quite centred


def check_intrinsics(cameras: Sequence[Camera]) -> Iterator[Problem]:
    """Yield problems of focal lengths and principal points."""
    uneven = [c.fx / c.fy for c in cameras if max(c.fx / c.fy, c.fy / c.fx) > ANAMORPHIC]
    if uneven:
        yield doubt("focal length", f"fx / fy is {uneven[0]:.3g}", "normalised by width and "
                    "height, or scaled in one direction", "fx, fy in pixels")  # fmt: skip
    at = np.array([(c.cx / c.width, c.cy / c.height) for c in cameras])
    off = (np.abs(at - 0.5) > OFF_CENTRE).any(1)
    if off.any():
        first = int(off.argmax())
        scaled = centred(cameras[first]) is not cameras[first]
        yield doubt(
            "principal point", "at {:.2f} of the width, {:.2f} of the height".format(*at[first]),
            f"K is of pictures {2 * at[first][0]:.3g} times as large" if scaled
            else "the pictures are crops, or K is of others",
            "scale K with the pictures, or subtract a crop's corner from cx, cy",
            np.flatnonzero(off) if not off.all() else (),
        )  # fmt: skip


def centred(camera: Camera) -> Camera:
    """Return the camera scaled so that its axis meets the picture's middle, if one scale does."""
    if not (camera.cx > 0 and camera.cy > 0):
        return camera
    half = camera.width / 2, camera.height / 2
    x, y = half[0] / camera.cx, half[1] / camera.cy
    if abs(x / y - 1) > EVENLY or abs(1 / x - 1) <= 2 * OFF_CENTRE:
        return camera
    return replace(camera, fx=camera.fx * x, fy=camera.fy * y, cx=half[0], cy=half[1])
