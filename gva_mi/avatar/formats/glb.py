"""The .glb container of glTF 2.0: a JSON description, and the numbers it points to.

Arrays lie one after the other in one buffer. An *accessor* of the description says where an array
lies and what its elements are. https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.atomic import atomic_write

_COMPONENTS = {"uint8": 5121, "uint16": 5123, "uint32": 5125, "float32": 5126}
_KINDS = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTICES, TRIANGLES = 34962, 34963  # uses of a buffer on a GPU
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942


class Glb:
    """Builder of one .glb file.

    Attributes:
        description: the JSON; the caller adds scenes, nodes, meshes and so on.
    """

    def __init__(self) -> None:
        self._binary = bytearray()
        self.description: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "gva_mi"},
            "bufferViews": [],
            "accessors": [],
        }

    def add(self, array: np.ndarray, use: int | None = None, normalized: bool = False) -> int:
        """Store an array and return the number of its accessor.

        It is (n,), (n, 2), (n, 3), (n, 4) or (n, 4, 4), of float32 or unsigned integers, matrices
        row by row. ``use`` is :data:`VERTICES` or :data:`TRIANGLES`; ``normalized`` integers
        represent [0, 1].
        """
        kind = _KINDS[array.shape[1:]]
        accessor = {
            "bufferView": len(self.description["bufferViews"]),
            "componentType": _COMPONENTS[array.dtype.name],
            "count": len(array),
            "type": kind,
        }
        if array.dtype == np.float32 and kind != "MAT4":  # the format demands some of them
            low, high = array.min(0), array.max(0)
            accessor |= {"min": np.atleast_1d(low).tolist(), "max": np.atleast_1d(high).tolist()}
        if normalized:
            accessor["normalized"] = True
        if kind == "MAT4":
            array = array.swapaxes(1, 2)  # column by column
        content = np.ascontiguousarray(array).tobytes()
        view = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(content)}
        self.description["bufferViews"].append(view | ({"target": use} if use else {}))
        self.description["accessors"].append(accessor)
        self._binary += content + b"\0" * (-len(content) % 4)
        return len(self.description["accessors"]) - 1

    def save(self, path: Path) -> None:
        """Write the file, atomically."""
        described = self.description | {"buffers": [{"byteLength": len(self._binary)}]}
        text = json.dumps(described, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + len(self._binary)
        with atomic_write(path) as unfinished, unfinished.open("wb") as file:
            file.write(struct.pack("<III", _MAGIC, 2, length))
            for kind, chunk in ((_JSON, text), (_BINARY, self._binary)):
                file.write(struct.pack("<II", len(chunk), kind))
                file.write(chunk)
