"""Read the numbers in a QuickTime film's metadata, of the film and of its tracks.

FFmpeg reads the keys of the film, but not those of its tracks, where phones record the lens. A film
is boxes in boxes, each its size, four letters, and contents. ``moov``, and each ``trak`` in it, may
hold a ``meta`` with two lists: ``keys`` has names, ``ilst`` values, each under the number of its
name (Apple, *QuickTime File Format*, "Metadata").
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

# Types of whole numbers, of any number of bytes: signed, unsigned.
_SIGNED, _UNSIGNED = (21, 65, 66, 67, 74), (22, 75, 76, 77, 78)
_TEXT, _FLOATS = 1, {23: ">f", 24: ">d"}


def numbers(path: Path) -> dict[str, float]:
    """Return the keys whose values are numbers; none for a file that is no QuickTime film.

    The film's own keys win over those of its tracks, and the first track's over the others'.
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
    if kind in _SIGNED or kind in _UNSIGNED:
        return float(int.from_bytes(value[:8], "big", signed=kind in _SIGNED))
    try:
        if kind in _FLOATS:
            return struct.unpack(_FLOATS[kind], value)[0]
        return float(value) if kind == _TEXT else None
    except (ValueError, struct.error):
        return None
