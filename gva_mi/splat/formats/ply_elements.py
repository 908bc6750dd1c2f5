"""Reader and writer of any .ply: a header that names tables, and the tables.

    ply · format FORMAT 1.0 · element NAME COUNT · property TYPE NAME · … · end_header

Tables ("elements") follow the header one after the other, row by row: as bytes without any padding,
or as text. Lines end as the first one does. A property may be a list, ``property list TYPE TYPE
NAME``: its length, then its numbers. Elements that have one, such as faces, are left out.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import known_container, read_bytes

TYPES = {  # each has two names
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ASCII = "ascii"
ORDERS = {ASCII: "<", "binary_little_endian": "<", "binary_big_endian": ">"}  # of bytes


class _Property(NamedTuple):
    """A column of an element."""

    name: str
    dtype: np.dtype
    count: np.dtype | None  # of the length of a list; None: a plain number


class _Element(NamedTuple):
    """A table that the header announces."""

    name: str
    rows: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        return any(column.count is not None for column in self.properties)

    @property
    def row(self) -> np.dtype:
        return np.dtype([(column.name, column.dtype) for column in self.properties])


def read_elements(path: Path) -> dict[str, np.ndarray]:
    """Read the tables of a .ply by name: little-endian structured arrays, a field per property.

    Raises:
        InputError: no such file, not a .ply, or truncated.
    """
    data = read_bytes(path, "a .ply of Gaussians")
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    newline = rb"\r" if first and first[1] == b"\r" else rb"\r?\n"
    end = re.search(newline + rb"end_header[ \t]*" + newline, data)
    if first is None or end is None:
        raise InputError(f"{path}: {known_container(path) or 'not a .ply file'}")
    head = data[: end.start()].decode("ascii", errors="replace")
    lines = [line.split() for line in head.splitlines()]
    kinds = [line[1] for line in lines if line[0:1] == ["format"] and line[2:] == ["1.0"]]
    if len(kinds) != 1 or kinds[0] not in ORDERS:
        raise InputError(f"{path}: expected one format, {', '.join(ORDERS)} 1.0")
    elements = _announced(path, lines, ORDERS[kinds[0]])
    body = data[end.end() :]
    values = body.split() if kinds[0] == ASCII else body
    tables, start = {}, 0
    plain = [k for k, element in enumerate(elements) if not element.has_lists]
    for element in elements[: max(plain, default=-1) + 1]:
        try:
            if element.has_lists:
                start = _past_lists(element, values, start)
            else:
                read = _table if values is body else _text_table
                tables[element.name], start = read(element, values, start)
        except (IndexError, OverflowError):
            found = f"{element.rows} rows of '{element.name}' were announced"
            raise InputError(f"{path}: cut short, {found}") from None
        except ValueError as error:
            raise InputError(f"{path}: '{element.name}' cannot be read ({error})") from None
    return tables


def ply_parts(tables: Sequence[tuple[str, str, Sequence[str], np.ndarray]]) -> list[bytes]:
    """Return the bytes of a little-endian .ply, its header and its tables.

    A table is its name, the type of all its properties, their names, and its numbers.
    """
    header = ["ply", "format binary_little_endian 1.0"]
    for element, kind, names, table in tables:
        header.append(f"element {element} {len(table)}")
        header += [f"property {kind} {name}" for name in names]
    body = [table.astype(f"<{TYPES[kind]}").tobytes() for _, kind, _, table in tables]
    return ["\n".join([*header, "end_header\n"]).encode("ascii"), *body]


def _table(element: _Element, body: bytes, start: int) -> tuple[np.ndarray, int]:
    """Read plain numbers from a place on; also return where they end."""
    row = element.row
    end = start + element.rows * row.itemsize
    if end > len(body):
        raise IndexError
    found = np.frombuffer(body[start:end], row) if end > start else np.empty(0, row)
    return found.astype(row.newbyteorder("<"), copy=False), end


def _text_table(element: _Element, words: list[bytes], start: int) -> tuple[np.ndarray, int]:
    """Read plain numbers from a word on; also return where they end."""
    row, width = element.row, len(element.properties)
    end = start + element.rows * width
    if end > len(words):
        raise IndexError
    found = np.empty(element.rows if width else 0, row)
    numbers = np.array(words[start:end], dtype=bytes).astype(np.float64).reshape(-1, max(width, 1))
    for name, column in zip(row.names, numbers.T, strict=False):
        with np.errstate(over="ignore", invalid="ignore"):
            found[name] = column
        if row[name].kind != "f" and not np.array_equal(found[name], column):
            raise ValueError(f"property '{name}' holds numbers that are no {row[name]}")
    return found, end


def _past_lists(element: _Element, values: bytes | list[bytes], start: int) -> int:
    """Return where an element with lists ends."""
    text = isinstance(values, list)
    for _ in range(element.rows):
        for _, dtype, count in element.properties:
            length = 1
            if count is not None:
                end = start + (1 if text else count.itemsize)
                if end > len(values):
                    raise IndexError
                found = values[start] if text else np.frombuffer(values[start:end], count)[0]
                length, start = max(int(found), 0), end
            start += length * (1 if text else dtype.itemsize)
    return start


def _announced(path: Path, lines: Sequence[list[str]], order: str) -> list[_Element]:
    """Parse a header: elements, their rows and properties."""
    found: list[_Element] = []
    for line in lines:
        if line[:1] == ["element"]:
            known = {element.name for element in found}
            if len(line) != 3 or not line[2].isdecimal() or line[1] in known:
                wrong = f"'{' '.join(line)}'; expected each element once, with its number of rows"
                raise InputError(f"{path}: the header says {wrong}")
            found.append(_Element(line[1], int(line[2]), []))
        elif line[:1] == ["property"]:
            is_list = line[1:2] == ["list"]
            types = line[1 + is_list : -1]
            if len(types) != 1 + is_list or not found or any(x not in TYPES for x in types):
                wrong = f"'{' '.join(line)}'; expected an element's property, with its type"
                raise InputError(f"{path}: the header says {wrong}")
            if line[-1] in {column.name for column in found[-1].properties}:
                name = found[-1].name
                raise InputError(f"{path}: the property '{line[-1]}' of '{name}' is named twice")
            dtypes = [np.dtype(order + TYPES[x]) for x in types]
            count = dtypes[0] if is_list else None
            found[-1].properties.append(_Property(line[-1], dtypes[-1], count))
    return found
