"""A camera as a Mitsuba sensor.

1. Mitsuba's camera looks along +z with x to the left and y up:
   ``to_world = T_camera_world^{-1} · diag(-1, -1, 1, 1)``,
2. field of view in x: ``2 atan(W / (2 fx))``, in degrees,
3. principal point: offsets ``(W / 2 - cx) / W`` and ``(H / 2 - cy) / H``,
4. a crop of its picture on a grid with ``r`` times the focal length is a tile of the view: its
   corner lies at ``c - c_tile / r``,
5. ``fy / fx`` is left to the ``pixel_aspect`` of ``mesh_normals``: Mitsuba's pixels are square.

Mitsuba stores the angle as a float32 number of degrees and turns it back into a focal length, which
costs a rounding or two. Passing K instead would change pictures in their last bits.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from gva_mi.splat import Camera

if TYPE_CHECKING:
    from gva_mi_plugins.mesh_normals.pixel_filter import Tile

NEAR, FAR = 0.01, 1000.0  # metres


def sensor_of(camera: Camera) -> dict[str, Any]:
    """Return a pinhole camera as a dictionary for ``mi.load_dict`` (eq. 1-3).

    The sensor's pixels are square: pass :func:`pixel_aspect` to the integrator.

    Raises:
        ValueError: another model of camera.
    """
    import mitsuba as mi

    if camera.model != "pinhole":
        raise ValueError(f"sensor_of(): the camera must be a pinhole, got {camera.model}")

    width, height = camera.width, camera.height
    to_world = np.linalg.inv(camera.T_camera_world) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(width / (2 * camera.fx)))),
        "principal_point_offset_x": (width / 2 - camera.cx) / width,
        "principal_point_offset_y": (height / 2 - camera.cy) / height,
        "near_clip": NEAR,
        "far_clip": FAR,
        "to_world": mi.ScalarTransform4f(to_world),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
    }


def pixel_aspect(camera: Camera) -> float:
    """Return the width of a pixel over its height (eq. 5)."""
    return camera.fy / camera.fx


def tile_of(crop: Camera, whole: Camera) -> Tile:
    """Return the tile of a view that another camera sees (eq. 4).

    Raises:
        ValueError: that camera stands elsewhere, or its pixels have another aspect.
    """
    from gva_mi_plugins.mesh_normals.pixel_filter import Tile

    same = np.array_equal(crop.T_camera_world, whole.T_camera_world) and crop.model == whole.model
    if not same or not math.isclose(pixel_aspect(crop), pixel_aspect(whole), rel_tol=1e-9):
        raise ValueError("tile_of(): the cameras must see crops of one picture")
    scale = crop.fx / whole.fx
    left, top = whole.cx - crop.cx / scale, whole.cy - crop.cy / scale
    return Tile(float(left), float(top), float(scale), crop.width, crop.height)
