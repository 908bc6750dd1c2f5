"""Reader of any binary .ply: a header that names tables, and the tables.

    ply · format binary_little_endian 1.0 · element NAME COUNT · property TYPE NAME · … · end_header

Tables ("elements") follow the header one after the other, row by row, without any padding.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError

TYPES = {  # each has two names
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}


def read_elements(path: Path) -> dict[str, np.ndarray]:
    """Read the tables of a .ply by name: structured arrays with a field per property.

    Raises:
        InputError: no such file, not a binary little-endian .ply of plain numbers, or truncated.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected a .ply of Gaussians") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a .ply") from None
    head, end, body = data.partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii", errors="replace").split("\n")]
    if lines[0] != ["ply"] or not end:
        raise InputError(f"{path}: not a .ply file")
    if ["format", "binary_little_endian", "1.0"] not in lines:
        raise InputError(f"{path}: expected the format binary_little_endian 1.0")
    tables, start = {}, 0
    for name, (count, properties) in _announced(path, lines).items():
        try:
            row = np.dtype(properties)
        except ValueError:
            raise InputError(f"{path}: a property of '{name}' is named twice") from None
        size = count * row.itemsize
        if len(body) < start + size:
            raise InputError(f"{path}: cut short, {count} rows of '{name}' were announced")
        tables[name] = np.frombuffer(body[start : start + size], row) if size else np.empty(0, row)
        start += size
    return tables


def _announced(path: Path, lines: list[list[str]]) -> dict[str, tuple[int, list[tuple[str, str]]]]:
    """Parse a header: rows of each element, and names and types of its properties."""
    found: dict[str, tuple[int, list[tuple[str, str]]]] = {}
    for line in lines:
        if line[:1] == ["element"]:
            if len(line) != 3 or not line[2].isdecimal() or line[1] in found:
                wrong = f"'{' '.join(line)}'; expected each element once, with its number of rows"
                raise InputError(f"{path}: the header says {wrong}")
            properties: list[tuple[str, str]] = []
            found[line[1]] = (int(line[2]), properties)
        elif line[:1] == ["property"]:
            if len(line) != 3 or line[1] not in TYPES or not found:
                wrong = f"'{' '.join(line)}'; expected an element's property, of plain numbers"
                raise InputError(f"{path}: the header says {wrong}")
            properties.append((line[2], TYPES[line[1]]))
    return found
