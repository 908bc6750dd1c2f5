"""The focal length that a recording was made with, as its file or its owner tells it.

Photographs say by EXIF, and films of some phones by a key of QuickTime's, which lens of 35 mm film
shows as much. Diagonals are compared, and that film's is 43.27 mm:

1. ``f = millimetres · diagonal / 43.27``,   ``diagonal = √(W² + H²)`` pixels

Sensors have 4:3 or 3:2. Pictures that are wider, such as 16:9, are cut from one of 4:3, whose
longer side they show whole: then its diagonal counts, 5/4 of it. What a film's stabilisation cuts
off is not told: a phone's film is of a focal length up to a fifth longer than eq. 1. Photographs
without that number may tell the lens's own focal length, and pixels a millimetre of the sensor.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gva_mi.data.importers.footage import files_of
from gva_mi.data.importers.quicktime import numbers
from gva_mi.data.importers.recordings import Pictures
from gva_mi.data.pictures import opened
from gva_mi.errors import MALFORMED, InputError
from gva_mi.ranges import Within

RECORDED = "recorded"  # in the place of a focal length: what the file says
PIXELS = Within(0, 1e6, "low", "pixels")
EXPECTED = f"a focal length in pixels, such as 1450, as of 35 mm film, such as 26mm, or {RECORDED}"
_DIAGONAL = 43.27  # mm of 36 x 24
_WIDEST = 1.6  # sides of a whole sensor's picture: longer over shorter
_QUICKTIME = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
_IN_35MM, _FOCAL, _WIDTH, _HEIGHT, _A_UNIT, _UNIT = 41989, 37386, 40962, 40963, 41486, 41488  # EXIF
_EXIF = 0x8769  # the tags of the photograph among those of the file
_MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0}  # of a unit: inch, centimetre, millimetre


def in_pixels(millimetres: float, size: tuple[int, int]) -> float:
    """Eq. 1, for pictures of ``size`` (W, H)."""
    longer, shorter = max(size), min(size)
    whole = longer <= _WIDEST * shorter
    diagonal = np.hypot(longer, shorter) if whole else 1.25 * longer
    return float(millimetres * diagonal / _DIAGONAL)


def recorded(source: Pictures, size: tuple[int, int]) -> float | None:
    """The focal length in pixels that a film's file says, or the first picture's; None: none.

    Args:
        source: a film, a folder of pictures, or files.
        size: (W, H) of its pictures.
    """
    files = files_of(source)
    if files is None:
        found = in_pixels(numbers(source).get(_QUICKTIME, 0), size)
    else:
        found = _of_photograph(files[0], size)
    return found if found in PIXELS else None


def asked_for(text: str, of_file: float | None, size: tuple[int, int]) -> float:
    """The focal length in pixels that a user gives.

    Args:
        text: pixels, millimetres of 35 mm film, or the word ``recorded``.
        of_file: what the file says, in pixels.
        size: (W, H) of the pictures.

    Raises:
        InputError: it is none of these, or the file says none.
    """
    if text == RECORDED and of_file is None:
        raise InputError(
            "prepare: --lens recorded, but no focal length is recorded: neither by EXIF nor by "
            "QuickTime's camera.focal_length.35mm_equivalent; give --lens 26mm, or pixels"
        )
    if text == RECORDED:
        return of_file
    millimetres = text.removesuffix("mm")
    try:
        number = float(millimetres)
    except ValueError:
        number = 0.0
    found = in_pixels(number, size) if text.endswith("mm") else number
    if found not in PIXELS:
        raise InputError(f"prepare: --lens must be {EXPECTED}; got {text}")
    return found


def _of_photograph(path: Path, size: tuple[int, int]) -> float:
    """What EXIF says, in pixels; 0: nothing."""
    with opened(path) as image:
        try:
            tags = image.getexif().get_ifd(_EXIF)
        except MALFORMED:  # what was made with it can be seen all the same
            return 0.0
    number = lambda tag: _number(tags.get(tag))
    if number(_IN_35MM) > 0:
        return in_pixels(number(_IN_35MM), size)
    pixels = max(number(_WIDTH), number(_HEIGHT))
    unit = _MILLIMETRES.get(tags.get(_UNIT, 2), 0.0)
    if not pixels > 0 or not unit:
        return 0.0
    # Its pictures may have been made smaller since.
    return number(_FOCAL) * number(_A_UNIT) / unit * max(size) / pixels


def _number(value: object) -> float:
    """A tag as a number; 0 where it is none."""
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
