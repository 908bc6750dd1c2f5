"""The lens of a phone video: assumed by an estimator, recorded in the file, or given by the user.

Photographs (EXIF) and videos of some phones (a QuickTime key) record the equivalent focal length on
35 mm film. It refers to equal diagonals; a picture on 35 mm film has 43.27 mm:

1. ``f = millimetres · diagonal / 43.27``,   ``diagonal = √(W² + H²)`` pixels

Sensors are 4:3 or 3:2. A wider picture, such as 16:9, is cut from a 4:3 picture with the same
longer side, so the diagonal is 5/4 of that side. Stabilisation cuts off more, which is not
recorded: a phone's video has a focal length up to a fifth longer than eq. 1.

A point x that a lens f, c sees at the pixel u is seen at the same pixel by another lens f', c' if
it moves to

2. ``z' = z f' / f``,   ``x' = (u − c') z' / f'``,   y alike

where it also has as many pixels a metre. f is the geometric mean of both focal lengths of a lens.

FFmpeg reads the keys of a QuickTime file, but not the keys of its tracks, where phones record the
lens. The file is a tree of boxes: size, four letters, content. ``moov``, and each ``trak`` in it,
may hold a ``meta`` with two lists: ``keys`` has names, and ``ilst`` has values, each under the
number of its name (Apple, *QuickTime File Format*, "Metadata").
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch

from gva_mi.core.errors import MALFORMED, InputError
from gva_mi.core.options import Within
from gva_mi.subject.footage import Pictures, files_of
from gva_mi.subject.pictures import opened

RECORDED = "recorded"  # given instead of a focal length: take the one in the file
# Chosen: lenses that show straight lines straight have 9 to 1200 mm.
FOCAL_IN_35MM = Within(7, 1200, unit="mm")  # equivalent on 35 mm film
EXPECTED_FOCAL = (
    f"a focal length in pixels, such as 1450, as of 35 mm film, such as 26mm, or {RECORDED}"
)
EXPECTED_CAMERA = 'a camera such as {"focal": [fx, fy], "princpt": [cx, cy]}'
# All chosen as relative differences, above rounding and below what another lens makes.
ONE_LENS_TOLERANCE = 1e-3  # of entries of K, relative to the focal length
_ASPECT_TOLERANCE = 0.01  # of two pictures' aspects
_DIAGONAL_35MM = 43.27  # mm, of 36 x 24
_SENSOR_ASPECT = 1.6  # longer over shorter side: a whole sensor's picture has less (3:2, 4:3)
_QUICKTIME_FOCAL = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
_EXIF_TAGS, _EXIF_FOCAL = 0x8769, 41989  # EXIF's tags of a photograph, FocalLengthIn35mmFilm
# Type numbers in QuickTime's metadata: whole numbers of 1 to 8 bytes, text, floating point.
_SIGNED_TYPES, _UNSIGNED_TYPES = (21, 65, 66, 67, 74), (22, 75, 76, 77, 78)
_TEXT_TYPE, _FLOAT_TYPES = 1, {23: ">f", 24: ">d"}


def pinhole_K(focal: object, centre: object) -> np.ndarray:
    """Return K (3, 3) of a focal length, or two (fx, fy), and a principal point, pixels."""
    (fx, fy), (cx, cy) = np.broadcast_to(np.ravel(focal), 2), np.ravel(centre)
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def centred(focal: float, size: tuple[int, int]) -> np.ndarray:
    """Return K (3, 3) of a lens whose axis meets the middle of a picture of ``size`` (W, H)."""
    return pinhole_K(focal, (size[0] / 2, size[1] / 2))


def rescaled(where: str, K: np.ndarray, of: Sequence[float], size: tuple[int, int]) -> np.ndarray:
    """Rescale K (..., 3, 3) from pictures of the size ``of`` (W, H) to pictures of ``size``."""
    factors = np.array(size, np.float64) / np.maximum(of, 1e-9)
    if not abs(factors[0] / factors[1] - 1) <= _ASPECT_TOLERANCE or min(of) < 1:
        raise InputError(
            f"{where}: its camera is of pictures of {of[0]:g}x{of[1]:g}, but the video has "
            f"{size[0]}x{size[1]}; expected the same shape"
        )
    return K * np.array([*factors, 1])[:, None]


def usual_lens(K: np.ndarray) -> np.ndarray:
    """Return K (3, 3) of a usual lens for pictures that lenses (n, 3, 3) belong to.

    Its axis is the median of theirs, taken as the picture's middle. The picture's diagonal is seen
    under 53 degrees, as by a 43 mm lens on 35 mm film.
    """
    cx, cy = np.median(K[:, :2, 2], axis=0)
    focal = 2 * max(np.hypot(cx, cy), 1.0)
    return np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])


def is_one_lens(K: np.ndarray) -> bool:
    """Whether lenses (n, 3, 3) are the same in all frames."""
    return bool(np.ptp(K, axis=0).max() <= ONE_LENS_TOLERANCE * K[0, 0, 0])


def seen_alike(places: np.ndarray, K: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Move places (n, 3), metres, so that the lens ``other`` sees them as ``K`` did (eq. 2).

    Both lenses are (3, 3) or (n, 3, 3).
    """
    K, other = (np.broadcast_to(x, (len(places), 3, 3)) for x in (K, other))
    f, axes, middle = _parts(K)
    f_other, axes_other, middle_other = _parts(other)
    z = places[:, 2:] * (f_other / f)
    with np.errstate(divide="ignore", invalid="ignore"):  # a place in the plane of the lens
        pixels = places[:, :2] * axes / places[:, 2:] + middle - middle_other
    return np.concatenate([pixels * z / axes_other, z], axis=1)


def _parts(K: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return f (n, 1), both focal lengths (n, 2) and the axis (n, 2) of lenses (n, 3, 3)."""
    axes = K[:, [0, 1], [0, 1]]
    return np.sqrt(axes.prod(1, keepdims=True)), axes, K[:, :2, 2]


def in_pixels(millimetres: float, size: tuple[int, int]) -> float:
    """Convert a 35 mm focal length to pixels (eq. 1), for pictures of ``size`` (W, H)."""
    longer, shorter = max(size), min(size)
    whole = longer <= _SENSOR_ASPECT * shorter
    diagonal = np.hypot(longer, shorter) if whole else 1.25 * longer
    return float(millimetres * diagonal / _DIAGONAL_35MM)


def recorded(source: Pictures, size: tuple[int, int]) -> float | None:
    """Return the focal length (pixels) recorded in the video file or first picture; or None."""
    found = recorded_35mm(source)
    return None if found is None else in_pixels(found, size)


def recorded_35mm(source: Pictures) -> float | None:
    """Return the 35 mm focal length (mm) recorded in the video file or first picture; or None."""
    files, focal = files_of(source), 0.0
    if files is None:
        focal = quicktime_numbers(source).get(_QUICKTIME_FOCAL, 0)
    else:
        with opened(files[0]) as image, suppress(*MALFORMED, ZeroDivisionError):  # of EXIF
            focal = float(image.getexif().get_ifd(_EXIF_TAGS).get(_EXIF_FOCAL, 0))
    return focal if focal in FOCAL_IN_35MM else None


def asked_for(text: str, of_file: float | None, size: tuple[int, int]) -> float:
    """Parse a user's focal length to pixels: pixels, "26mm" of 35 mm film, or "recorded".

    ``of_file`` is the recorded one, pixels, of a video of ``size`` (W, H).
    """
    if text == RECORDED and of_file is None:
        raise InputError(
            "prepare: --lens recorded, but no focal length is recorded: neither by EXIF nor by "
            "QuickTime's camera.focal_length.35mm_equivalent; give --lens 26mm, or pixels"
        )
    if text == RECORDED:
        return of_file
    try:
        number = float(text.removesuffix("mm"))
    except ValueError:
        number = 0.0
    found = number if not text.endswith("mm") else in_pixels(number, size)
    low, high = (in_pixels(end, size) for end in (FOCAL_IN_35MM.low, FOCAL_IN_35MM.high))
    if not low <= found <= high:
        raise InputError(
            f"prepare: --lens must be {EXPECTED_FOCAL}; {FOCAL_IN_35MM}, which are {low:.0f} to "
            f"{high:.0f} pixels here; got {text}"
        )
    return found


def undistort(
    where: object, K: np.ndarray, coefficients: np.ndarray | None, size: tuple[int, int]
) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return a function that undistorts an 8-bit picture (H, W[, C]); None for a pinhole.

    The result is a pinhole's picture with the same K. With x = (u − cx)/fx, y = (v − cy)/fy and
    r² = x² + y², the lens shows at (x', y') what a pinhole shows at (x, y), as OpenCV has it,

        x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²),    y' alike.

    ``coefficients`` are (k1, k2, p1, p2), or with k3; all zero, or None: a pinhole. ``size`` is
    (W, H).
    """
    c = np.ravel(np.asarray(np.zeros(5) if coefficients is None else coefficients, np.float64))
    if len(c) not in (4, 5) or not np.isfinite(c).all():
        raise InputError(f"{where}: distortion must be (k1, k2, p1, p2, k3), got {c}")
    if not c.any():
        return None
    k1, k2, p1, p2, k3 = (*c, 0.0)[:5]
    u, v = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = K[0, 0] * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + K[0, 2]
    v = K[1, 1] * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + K[1, 2]
    # grid_sample counts from −1 at one border of the picture to 1 at the other.
    place = np.stack([2 * u / size[0] - 1, 2 * v / size[1] - 1], axis=-1)
    grid = torch.from_numpy(place.astype(np.float32))[None]

    def undistorted(image: np.ndarray) -> np.ndarray:
        planes = torch.from_numpy(np.atleast_3d(image).astype(np.float32)).permute(2, 0, 1)[None]
        found = torch.nn.functional.grid_sample(planes, grid, align_corners=False)
        found = found[0].permute(1, 2, 0).round().clamp(0, 255).to(torch.uint8).numpy()
        return found.reshape(image.shape)

    return undistorted


def quicktime_numbers(path: Path) -> dict[str, float]:
    """Return the numbers in a QuickTime file's metadata by their keys; empty for another file.

    Keys of the file win over keys of its tracks, and the first track wins over later ones.
    """
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as held:
            with memoryview(held) as view:
                moov = next((bytes(box) for kind, box in _boxes(view) if kind == b"moov"), b"")
        tracks = [box for kind, box in _boxes(moov) if kind == b"trak"]
        metas = [dict(_boxes(holder)).get(b"meta", b"") for holder in (moov, *tracks)]
        found = [_numbers(bytes(meta)) for meta in metas]
    except (OSError, ValueError, struct.error):
        return {}
    return {key: value for one in reversed(found) for key, value in one.items()}


def _boxes(held: bytes | memoryview) -> Iterator[tuple[bytes, bytes | memoryview]]:
    """Yield letters and contents of the boxes in a box, up to the first damaged one."""
    at = 0
    while at + 8 <= len(held):
        size, kind = struct.unpack_from(">I4s", held, at)
        head = 8
        if size == 1 and at + 16 <= len(held):  # a long box: its size comes after the letters
            size, head = struct.unpack_from(">Q", held, at + 8)[0], 16
        if size < head or at + size > len(held):
            return
        yield kind, held[at + head : at + size]
        at += size


def _numbers(meta: bytes) -> dict[str, float]:
    """Return the numbers of one ``meta`` box by their keys."""
    if meta[4:8] != b"hdlr":  # as in MPEG-4, where four bytes come before
        meta = meta[4:]
    lists = dict(_boxes(meta))
    names = [name.decode("utf-8", "replace") for _, name in _boxes(lists.get(b"keys", b"")[8:])]
    found = {}
    for place, item in _boxes(lists.get(b"ilst", b"")):
        number = struct.unpack(">I", place)[0]
        value = _value(dict(_boxes(item)).get(b"data", b""))
        if value is not None and 1 <= number <= len(names):
            found[names[number - 1]] = value
    return found


def _value(data: bytes) -> float | None:
    """Return the number in a ``data`` box, after type and language; None without one."""
    kind, value = int.from_bytes(data[:4], "big"), data[8:]
    with suppress(ValueError, struct.error):
        if kind in _SIGNED_TYPES or kind in _UNSIGNED_TYPES:
            return float(int.from_bytes(value[:8], "big", signed=kind in _SIGNED_TYPES))
        if kind in _FLOAT_TYPES:
            return struct.unpack(_FLOAT_TYPES[kind], value)[0]
        return float(value) if kind == _TEXT_TYPE else None
    return None
