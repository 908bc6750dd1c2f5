"""Binary glTF 2.0 (.glb): a writer, a reader, and Gaussians by KHR_gaussian_splatting.

The extension describes a primitive of points, one for each Gaussian, in y up and z toward the
viewer, as this program's world:

==============================================  =====================================
``POSITION``                                    means
``KHR_gaussian_splatting:ROTATION``             unit quaternions xyzw
``KHR_gaussian_splatting:SCALE``                standard deviations, not logarithms
``KHR_gaussian_splatting:OPACITY``              in [0, 1], no logits
``KHR_gaussian_splatting:SH_DEGREE_l_COEF_n``   harmonics of 3DGS, a vector for each
``COLOR_0``                                     a point's colour, in linear light, for
                                                programs without the extension
==============================================  =====================================

The reader takes all number types that the extension allows, several primitives, and nodes that
rotate, move and scale them. It refuses compressed Gaussians and those in linear light.

Source: KHR_gaussian_splatting of Khronos' glTF, ratified in 2026; the glTF 2.0 specification.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gva_mi.core.atomic import atomic_write
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import known_container, read_bytes
from gva_mi.core.srgb import decoded
from gva_mi.splat.axes import rotated, with_axes
from gva_mi.splat.formats.stored import Stored, gaussians_of
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.kernels.sh import C0

SPLATTING = "KHR_gaussian_splatting"
VERTICES, TRIANGLES = 34962, 34963  # uses of a buffer on a GPU
_EXPECTED = "a .glb with Gaussians by KHR_gaussian_splatting"
_COLORS = "srgb_rec709_display"  # the space of pictures, which Gaussians are fitted to
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_NUMBERS = {np.dtype(text).name: number for number, text in _TYPES.items()}
_KINDS = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_SHAPES = {kind: shape for shape, kind in _KINDS.items()}
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942


class Glb:
    """Builder of one .glb file.

    Attributes:
        description: the JSON; the caller adds scenes, nodes, meshes and so on.

    Example:
        >>> file = Glb()
        >>> file.add(np.zeros((100, 3), np.float32), VERTICES)
        0
        >>> file.description["accessors"][0]["type"], file.description["accessors"][0]["count"]
        ('VEC3', 100)
    """

    def __init__(self) -> None:
        self._binary = bytearray()
        self.description: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "gva_mi"},
            "bufferViews": [],
            "accessors": [],
        }

    def add(self, array: np.ndarray, use: int | None = None) -> int:
        """Store an array and return the number of its accessor.

        It is (n,), (n, 2), (n, 3), (n, 4) or (n, 4, 4), of float32 or unsigned integers, matrices
        row by row. ``use`` is :data:`VERTICES` or :data:`TRIANGLES`.
        """
        kind = _KINDS[array.shape[1:]]
        accessor = {
            "bufferView": len(self.description["bufferViews"]),
            "componentType": _NUMBERS[array.dtype.name],
            "count": len(array),
            "type": kind,
        }
        if array.dtype == np.float32 and kind != "MAT4":  # the format demands some of them
            low, high = array.min(0), array.max(0)
            accessor |= {"min": np.atleast_1d(low).tolist(), "max": np.atleast_1d(high).tolist()}
        if kind == "MAT4":
            array = array.swapaxes(1, 2)  # column by column
        content = np.ascontiguousarray(array).tobytes()
        view = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(content)}
        self.description["bufferViews"].append(view | ({"target": use} if use else {}))
        self.description["accessors"].append(accessor)
        self._binary += content + b"\0" * (-len(content) % 4)
        return len(self.description["accessors"]) - 1

    def gaussians(self, path: Path, gaussians: Gaussians, **more: np.ndarray) -> dict:
        """Store Gaussians of the world, and ``more`` attributes of them; describe the primitive."""
        stored = Stored.of(path, gaussians, "a .glb", most=3)
        plain = np.clip(C0 * stored.sh[:, 0] + 0.5, 0, 1)
        arrays = {
            "POSITION": stored.means,
            "COLOR_0": np.column_stack([decoded(plain), stored.opacities]),
            f"{SPLATTING}:ROTATION": stored.unit_quats[:, [1, 2, 3, 0]],
            f"{SPLATTING}:SCALE": stored.scales,
            f"{SPLATTING}:OPACITY": stored.opacities,
        }
        names = _harmonics(stored.degree)
        arrays |= {name: stored.sh[:, k] for k, name in enumerate(names)}
        rounded = {name: array.astype(np.float32) for name, array in arrays.items()} | more
        return {
            "mode": 0,
            "attributes": {name: self.add(array, VERTICES) for name, array in rounded.items()},
            "extensions": {SPLATTING: {"kernel": "ellipse", "colorSpace": _COLORS}},
        }

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


@dataclass(frozen=True)
class OpenedGlb:
    """A .glb that was read.

    Example:
        >>> import tempfile
        >>> path, file = Path(tempfile.mkdtemp()) / "a.glb", Glb()
        >>> number = file.add(np.eye(3, dtype=np.float32))
        >>> file.save(path)
        >>> OpenedGlb.read(path, "a scene").array(number)[1].tolist()
        [0.0, 1.0, 0.0]
    """

    description: dict[str, Any]  # the JSON
    binary: memoryview

    @staticmethod
    def read(path: Path, expected: str) -> OpenedGlb:
        """Read a file; ``expected`` says in the InputError what it should hold."""
        data = memoryview(read_bytes(path, expected))
        if len(data) < 20 or struct.unpack_from("<II", data) != (_MAGIC, 2):
            kind = known_container(path) or "not a .glb of glTF 2.0"
            raise InputError(f"{path}: {kind}; expected {expected}")
        with expecting(path, expected):
            length = struct.unpack_from("<I", data, 12)[0]
            described = json.loads(bytes(data[20 : 20 + length]))
            return OpenedGlb(dict(described), data[28 + length :])

    def array(self, number: int) -> np.ndarray:
        """Return the array of an accessor, (n, ...); normalised integers as float64.

        Raises:
            LookupError, TypeError, ValueError: the accessor is broken.
            InputError: it is sparse, or in another file.
        """
        accessor = self.description["accessors"][number]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise InputError(f"accessor {number} is sparse or compressed; expected plain numbers")
        view = self.description["bufferViews"][accessor["bufferView"]]
        if view["buffer"] or "uri" in self.description["buffers"][0]:
            raise InputError(f"accessor {number} is in another file; expected one .glb")
        dtype, shape = np.dtype(_TYPES[accessor["componentType"]]), _SHAPES[accessor["type"]]
        row = np.dtype((dtype, shape)).itemsize
        begin = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        strides = (view.get("byteStride", row), *np.empty(shape, dtype).strides)
        found = np.ndarray((accessor["count"], *shape), dtype, self.binary, begin, strides)
        if accessor.get("normalized"):
            found = np.maximum(found / np.iinfo(dtype).max, -1)
        return found

    def transforms(self) -> list[np.ndarray | None]:
        """Return each node's transform (4, 4) to the scene; None outside of the scene."""
        nodes = self.description["nodes"]
        found: list[np.ndarray | None] = [None] * len(nodes)
        waiting = [(root, np.eye(4)) for root in self.roots()]
        while waiting:
            k, above = waiting.pop()
            if found[k] is None:  # else the nodes form a loop
                found[k] = above @ _transform(nodes[k])
                waiting += [(child, found[k]) for child in nodes[k].get("children", ())]
        return found

    def roots(self) -> list[int]:
        """Return the nodes at the top of the scene."""
        scenes = self.description.get("scenes")
        if not scenes:
            return list(range(len(self.description["nodes"])))
        return scenes[self.description.get("scene", 0)].get("nodes", [])

    def splats(self) -> Iterator[tuple[dict, np.ndarray]]:
        """Yield the attributes of each primitive of Gaussians in the scene, and its transform."""
        for node, T in zip(self.description["nodes"], self.transforms(), strict=True):
            if T is None or "mesh" not in node:
                continue
            for primitive in self.description["meshes"][node["mesh"]]["primitives"]:
                about = primitive.get("extensions", {}).get(SPLATTING)
                if about is None:
                    continue
                if about.get("extensions") or about["kernel"] != "ellipse":
                    kind = [*about.get("extensions", ()), about["kernel"]][0]
                    raise InputError(f"its Gaussians are stored as '{kind}'; expected plain ones")
                if about["colorSpace"] != _COLORS:
                    found = f"its colours are in '{about['colorSpace']}'"
                    raise InputError(f"{found}; expected '{_COLORS}'")
                yield primitive["attributes"], np.eye(4) if "skin" in node else T


def load_gltf(path: Path) -> Gaussians:
    """Read the Gaussians of a .glb, in its scene: y up, z toward the viewer.

    Those of a skin are at rest.

    Raises:
        InputError: not a .glb, no Gaussians, or in a form that is not read.

    Example:
        >>> load_gltf(Path("missing.glb"))
        Traceback (most recent call last):
        ...
        gva_mi.core.errors.InputError: missing.glb: no such file; expected a .glb with Gaussians ...
    """
    file = OpenedGlb.read(path, _EXPECTED)
    with expecting(path, _EXPECTED):
        try:
            parts = [_placed(_gaussians(file, names), T) for names, T in file.splats()]
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if not parts:
        raise InputError(f"{path}: holds no Gaussians (KHR_gaussian_splatting)")
    if len({part.sh.shape[1] for part in parts}) > 1:
        raise InputError(f"{path}: its Gaussians have harmonics of different degrees")
    named = [part.arrays() for part in parts]
    return Gaussians(**{name: torch.cat([part[name] for part in named]) for name in named[0]})


def _gaussians(file: OpenedGlb, attributes: dict[str, int]) -> Gaussians:
    """Read one primitive."""
    of = lambda name: file.array(attributes[name])
    there = (l for l in range(4) if f"{SPLATTING}:SH_DEGREE_{l}_COEF_0" in attributes)
    degree = max(there, default=0)
    return gaussians_of(
        means=of("POSITION"),
        quats=of(f"{SPLATTING}:ROTATION")[:, [3, 0, 1, 2]],
        scales=of(f"{SPLATTING}:SCALE"),
        opacities=of(f"{SPLATTING}:OPACITY").reshape(-1),
        sh=np.stack([of(name) for name in _harmonics(degree)], axis=1),
    )


def _placed(gaussians: Gaussians, T: np.ndarray) -> Gaussians:
    """Apply the transform of a node, a rotation with one scale along each axis and a move."""
    lengths = np.linalg.norm(T[:3, :3], axis=0)
    if np.allclose(T, np.eye(4)):
        return gaussians
    if np.ptp(lengths) > 1e-4 * lengths.max():
        raise InputError("a node scales its Gaussians unevenly; expected one scale")
    turned = rotated(with_axes(gaussians), T[:3, :3] / lengths)
    size = float(lengths.mean())
    moved = size * turned.means + torch.tensor(T[:3, 3]).to(turned.means)
    return replace(turned, means=moved, scales=size * turned.scales)


def _transform(node: dict) -> np.ndarray:
    """Return the transform (4, 4) of a node to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, :3] *= node.get("scale", (1, 1, 1))
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T


def _harmonics(degree: int) -> list[str]:
    """Return the names of the attributes of all harmonics up to a degree, in 3DGS's order."""
    bands = range(degree + 1)
    return [f"{SPLATTING}:SH_DEGREE_{l}_COEF_{n}" for l in bands for n in range(2 * l + 1)]
