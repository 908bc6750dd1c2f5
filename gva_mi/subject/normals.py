"""Read normal maps as networks write them, in the frame's pixels and the camera's axes.

===============  ===================================================================
``perspective``  a perspective view by the video's camera; camera space, x right, y down, z forward;
                 ``n · d < 0`` along the pixel's ray ``d``
``opengl``       the same view; x right, y *up*, z toward the viewer, as most networks write
``icon``         an orthographic view of a square crop, as in ICON and PIFuHD, in ``opengl``'s axes
===============  ===================================================================

A perspective picture is orthographic along each ray, not along the axis of the lens. So the z of an
orthographic network is taken to be each pixel's own ray:

    n_camera = R(d) diag(1, -1, -1) n_icon,        R(d) the shortest rotation that takes z to d

Then on the outline, where ``n_icon`` lies in the picture's plane, ``n_camera`` is perpendicular to
the ray. Without this rotation, normals would be off by the angle between ray and axis: 17 degrees
at the feet of a person three metres away.

``normals.json`` beside ``normals/`` says how they were made, and the part of the frame, in pixels,
that each map shows: a box for each frame, or one for all, which may cross the picture's border::

    {"convention": "icon", "boxes": [[left, top, right, bottom], ...]}

Without it maps are ``perspective``; without ``boxes`` they show whole frames. Files are
``000000.npy`` (floating point, (h, w, 3)) or ``000000.png`` (``(n + 1) / 2``). A normal is unknown
where the stored vector is far from unit length, as on a black, white or grey background.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import read_array, read_json
from gva_mi.splat import Camera
from gva_mi.subject.folder import NORMALS, NORMALS_RECORD, array_or_picture
from gva_mi.subject.pictures import read_image

Convention = Literal["perspective", "opengl", "icon"]
Part = tuple[slice, slice]  # rows and columns of a picture, without steps

# Lengths of a stored vector that is taken for a normal; others mark unknown pixels. Chosen: the
# background's black and white are 1.73 long and grey is 0; a normal that was averaged is short.
SHORTEST_NORMAL, LONGEST_NORMAL = 0.2, 1.5


@dataclass(frozen=True)
class NormalMaps:
    """The normal maps of a video."""

    folder: Path
    convention: Convention
    boxes: np.ndarray | None  # (T, 4) left, top, right, bottom in pixels; None: the whole frame

    @staticmethod
    def open(folder: Path, frames: int, convention: Convention | None = None) -> NormalMaps | None:
        """Open the maps of a subject with ``frames`` frames; None without a folder ``normals/``.

        ``convention`` overrides ``normals.json``.
        """
        if not (folder / NORMALS).is_dir():
            return None
        record = folder / NORMALS_RECORD
        about = _read_about(record, frames) if record.exists() else {}
        convention = convention or about.get("convention", "perspective")
        return NormalMaps(folder / NORMALS, convention, about.get("boxes"))

    def read(
        self, index: int, camera: Camera, part: Part = (slice(None), slice(None))
    ) -> np.ndarray | None:
        """Read unit normals in camera space (h, w, 3) float32, zero where unknown; None: no file.

        ``camera`` is the frame's, for size and rays; ``part`` is of the frame.
        """
        path = array_or_picture(self.folder, index)
        if not path.exists():
            return None
        stored = read_map(path)
        rows, columns = (
            range(*wanted.indices(count))
            for wanted, count in zip(part, (camera.height, camera.width), strict=True)
        )
        if self.boxes is None:
            size = (camera.height, camera.width, 3)
            if stored.shape != size:
                raise InputError(
                    f"{path}: frame {index} is {stored.shape}, expected {size}; maps of a "
                    f"part of the frame need their 'boxes' in {NORMALS_RECORD}"
                )
            normals = _directions(stored[part])
        else:
            box = self.boxes[index] - (columns.start, rows.start) * 2
            normals = _pasted(_directions(stored), box, (len(rows), len(columns)))
        if self.convention != "perspective":
            normals = normals * (1, -1, -1)
        if self.convention == "icon":
            seen = camera.cropped(columns.start, rows.start, len(columns), len(rows))
            normals = _turned(normals, seen, 1)
        square = _square_lengths(normals)
        long = square > SHORTEST_NORMAL**2
        return (normals * (long / np.sqrt(np.maximum(square, 1e-12)))).astype(np.float32)

    def check(self, index: int, camera: Camera) -> None:
        """Raise the errors of :meth:`read` without decoding all of the file."""
        self.read(index, camera, (slice(0, 1), slice(0, 1)))


def read_map(path: Path) -> np.ndarray:
    """Read a map (h, w, 3) as it is stored, 8-bit or floating point."""
    if path.suffix.lower() != ".npy":
        return read_image(path, 3, are_colors=False)
    normals = read_array(path)
    if normals.ndim != 3 or normals.shape[2] != 3 or normals.dtype.kind != "f":
        raise InputError(
            f"{path}: normals must be floating point (H, W, 3), got {normals.dtype} {normals.shape}"
        )
    return normals


def normal_colors(normals: np.ndarray) -> np.ndarray:
    """Return the usual colours (..., 3) of camera-space normals: ``(n + 1) / 2`` in ``opengl``."""
    return (normals * np.float32((1, -1, -1)) + 1) / 2


def _directions(stored: np.ndarray) -> np.ndarray:
    """Convert stored vectors (h, w, 3) to float32, zero where their length marks no normal."""
    if stored.dtype == np.uint8:
        normals = stored.astype(np.float32)
        normals *= 1 / 127.5
        normals -= 1
    else:
        normals = np.nan_to_num(stored.astype(np.float32))
    square = _square_lengths(normals)
    return normals * ((square > SHORTEST_NORMAL**2) & (square < LONGEST_NORMAL**2))


def _square_lengths(normals: np.ndarray) -> np.ndarray:
    """Return the squared lengths (h, w, 1) of vectors (h, w, 3)."""
    return np.einsum("hwc,hwc->hw", normals, normals)[..., None]


def in_convention(normals: np.ndarray, camera: Camera, convention: Convention) -> np.ndarray:
    """Convert normals (H, W, 3) from camera space, zero where unknown."""
    if convention == "perspective":
        return normals
    turned = _turned(normals, camera, -1) if convention == "icon" else normals
    return turned * (1, -1, -1)


def _pasted(normals: np.ndarray, box: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Resample a map (h, w, 3) of a box to the frame's pixels (H, W, 3), zero outside."""
    from PIL import Image

    out = np.zeros((*size, 3), np.float32)
    low = np.maximum(np.ceil(box[:2]), 0).astype(int)  # the frame's pixels inside the box
    high = np.minimum(np.floor(box[2:]), size[::-1]).astype(int)
    if (high <= low).any():
        return out
    scale = np.array(normals.shape[1::-1]) / (box[2:] - box[:2])  # map pixels a frame pixel
    source = tuple(np.concatenate([(low - box[:2]) * scale, (high - box[:2]) * scale]).tolist())
    for k in range(3):  # the filter widens where the map is finer
        channel = Image.fromarray(np.ascontiguousarray(normals[..., k], np.float32))
        part = channel.resize(tuple((high - low).tolist()), Image.Resampling.BILINEAR, box=source)
        out[low[1] : high[1], low[0] : high[0], k] = np.asarray(part)
    return out


def _turned(normals: np.ndarray, camera: Camera, sign: int) -> np.ndarray:
    """Compute ``R(d) n`` for each pixel's ray ``d``, or ``R(d)ᵀ n`` for a sign of -1.

    It is Rodrigues' formula with ``v = z × d``.
    """
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    d = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    v = sign * np.stack([-d[..., 1], d[..., 0], np.zeros_like(d[..., 0])], axis=-1)
    once = np.cross(v, normals)
    return normals + once + np.cross(v, once) / (1 + d[..., 2:])


def _read_about(path: Path, frames: int) -> dict:
    """Read ``convention`` and ``boxes`` (T, 4) from a ``normals.json``."""
    expected = '{"convention": "icon", "boxes": [[left, top, right, bottom], ...]}'
    refuse = lambda why: InputError(f"{path}: {why}; expected such as {expected}")
    about = read_json(path, f"such as {expected}")
    if not isinstance(about, dict) or about.get("convention") not in get_args(Convention):
        raise refuse(f"'convention' must be one of {', '.join(get_args(Convention))}")
    if about.get("boxes") is None:
        return {"convention": about["convention"]}
    try:
        boxes = np.atleast_2d(np.asarray(about["boxes"], dtype=np.float64))
    except (TypeError, ValueError):
        boxes = np.zeros(0)
    if boxes.shape not in ((1, 4), (frames, 4)) or not np.isfinite(boxes).all():
        raise refuse(f"'boxes' must be four numbers, or four for each of the {frames} frames")
    if not (boxes[:, 2:] > boxes[:, :2]).all():
        raise refuse("each of 'boxes' must have right > left and bottom > top")
    return {"convention": about["convention"], "boxes": np.broadcast_to(boxes, (frames, 4))}
