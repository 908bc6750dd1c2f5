"""Export an avatar's surface and poses to other programs, which know meshes but no Gaussians.

:mod:`gva_mi.splat.formats` writes the Gaussians of one pose.

``save_gltf`` writes a .glb of glTF 2.0: the surface with skeleton, skin, colours, and a motion. The
surface of the rest body hangs on 55 nodes, one per joint, with

    1. node j      at J_j - J_parent(j) of its parent, unrotated at rest     J: joints at rest
    2. inverse bind matrix of j = translation by -J_j
    3. x' = Σ_j w_j global_j inverse_bind_j x      so that global_j inverse_bind_j = T_world_rest[j]

of :mod:`gva_mi.body.kinematics`. A motion turns the nodes, and moves the first one too. glTF cannot
express the blend shapes of bent joints. So they are left out, as well as the blend shapes of the
face and all but the four largest skinning weights of a vertex. Vertices take their colours from the
Gaussians around them, lit in the rest pose, and are shown unlit.

``save_amass`` writes poses in AMASS's format, which most programs that know a body can read:

========================  ===========  =====================================================
``poses``                 (T, 165)     axis-angle: root, body 21, jaw, eyes, left, right hand
``trans``                 (T, 3)       metres
``betas``                 (B,)         shape
``gender``                ``str``      of the body model
``mocap_frame_rate``      number       frames a second
``surface_model_type``    ``"smplx"``
``expression``            (T, E)       in addition to AMASS's own keys, which have no face
========================  ===========  =====================================================

Hands are relative to the flat hand. The world stays the poses' own; AMASS's has z upward.

Sources: the glTF 2.0 specification (Khronos, 2021) with KHR_materials_unlit; AMASS (Mahmood et al.,
"AMASS: Archive of Motion Capture as Surface Shapes", 2019).
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.skinning import strongest
from gva_mi.body.so3 import to_quaternion
from gva_mi.core.atomic import atomic_write
from gva_mi.core.files import write_arrays
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat.formats.spz import plain_colors

COLORING_GAUSSIANS = 8  # nearest Gaussians that colour a vertex; chosen: all around it
# Metres: the smallest distance in the weights. Chosen: less than the Gaussians' spacing.
SMALLEST_DISTANCE = 0.003
_UNLIT = "KHR_materials_unlit"


@torch.no_grad()
def save_gltf(path: Path, avatar: Avatar, motion: Pose | None = None, fps: float = 30) -> None:
    """Write the surface with skeleton, skin and colours to a .glb, atomically.

    A ``motion`` of T frames, ``fps`` a second, is written as its animation.

    Example:
        >>> import tempfile
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_gltf(Path(folder) / "avatar.glb", avatar, Pose.rest(frames=30))
        ...     (Path(folder) / "avatar.glb").read_bytes()[:4]
        b'glTF'
    """
    file, rig = Glb(), avatar.rig
    joints = rig.joints.double().numpy()
    inverse_bind = np.broadcast_to(np.eye(4, dtype=np.float32), (len(joints), 4, 4)).copy()
    inverse_bind[:, :3, 3] = -joints
    surface = len(JOINTS)  # its node comes after the nodes of the joints
    skin = {"joints": list(range(surface)), "skeleton": 0}
    skin["inverseBindMatrices"] = file.add(inverse_bind)
    rough = {"metallicFactor": 0, "roughnessFactor": 1}
    file.description |= {
        "extensionsUsed": [_UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0, surface]}],
        "nodes": [*_skeleton(rig), {"name": "surface", "mesh": 0, "skin": 0}],
        "skins": [skin],
        "materials": [{"pbrMetallicRoughness": rough, "extensions": {_UNLIT: {}}}],
        "meshes": [{"name": "surface", "primitives": [_surface(file, avatar)]}],
    }
    if motion is not None:
        file.description["animations"] = [_animation(file, avatar, motion, fps)]
    file.save(path)


def _skeleton(rig: Rig) -> list[dict]:
    """Describe the nodes of the joints (eq. 1)."""
    joints, nodes = rig.joints.double().numpy(), []
    for j, (name, parent) in enumerate(zip(JOINTS, rig.parents, strict=True)):
        away = joints[j] if parent < 0 else joints[j] - joints[parent]
        nodes.append({"name": name, "translation": away.tolist()})
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(j)
    return nodes


def _surface(file: Glb, avatar: Avatar) -> dict:
    """Describe the primitive of the rest surface."""
    rig = avatar.rig
    weights, joints = strongest(rig.weights, 4).topk(4, dim=1)
    joints = joints.masked_fill(weights == 0, 0)  # required by the format
    vertices = rig.vertices.float()
    colors = _as_light(surface_colors(avatar, rig.vertices))
    opaque = np.column_stack([colors, np.ones(len(colors))])
    attributes = {
        "POSITION": vertices.numpy(),
        "NORMAL": vertex_normals(vertices, rig.faces).numpy(),
        "COLOR_0": opaque.astype(np.float32),
        "JOINTS_0": joints.numpy().astype(np.uint8),
        "WEIGHTS_0": weights.float().numpy(),
    }
    return {
        "attributes": {name: file.add(array, VERTICES) for name, array in attributes.items()},
        "indices": file.add(rig.faces.numpy().astype(np.uint32).ravel(), TRIANGLES),
        "material": 0,
    }


@torch.no_grad()
def surface_colors(avatar: Avatar, points: Tensor) -> np.ndarray:
    """Return colours (V, 3) in [0, 1] of points (V, 3) at rest, from the Gaussians around them.

    The nearest ones are weighted by opacity / distance².

    Example:
        A new avatar is grey.

        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> surface_colors(avatar, avatar.rig.vertices[:1]).round(3)
        array([[0.5, 0.5, 0.5]])
    """
    from scipy.spatial import cKDTree

    expressions = avatar.rig.expression_joints.shape[2]
    gaussians = avatar(Pose.rest(1, expressions, avatar.canonical.means.dtype))
    tree = cKDTree(gaussians.means.double().numpy())
    count = min(COLORING_GAUSSIANS, len(gaussians))
    found = tree.query(points.double().numpy(), k=count)
    distance, nearest = (x.reshape(len(points), count) for x in found)
    opacities = gaussians.opacities.double().numpy()[nearest]
    share = (opacities + 1e-6) / np.maximum(distance, SMALLEST_DISTANCE) ** 2
    share /= share.sum(1, keepdims=True)
    return np.einsum("vk,vkc->vc", share, plain_colors(gaussians)[nearest])


def _animation(file: Glb, avatar: Avatar, motion: Pose, fps: float) -> dict:
    """Describe a motion: all joints turn, and the first one moves."""
    times = file.add((np.arange(len(motion)) / fps).astype(np.float32))
    real, imaginary = to_quaternion(avatar.applied_rotations(motion).double())
    quats = torch.cat([imaginary, real], -1).numpy()  # xyzw, as in glTF
    for k in range(1, len(quats)):  # of q and -q, take the one nearer to the last
        quats[k][(quats[k] * quats[k - 1]).sum(-1) < 0] *= -1
    places = (motion.transl.double() + avatar.rig.joints[0].double()).numpy()
    moved = [(0, "translation", places)]
    moved += [(j, "rotation", quats[:, j]) for j in range(len(JOINTS))]
    samplers, channels = [], []
    for node, path, values in moved:
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        samplers.append({"input": times, "output": file.add(values.astype(np.float32))})
    return {"name": "motion", "samplers": samplers, "channels": channels}


def _as_light(colors: np.ndarray) -> np.ndarray:
    """Convert colours from sRGB to linear light, which glTF expects at vertices."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


_COMPONENTS = {"uint8": 5121, "uint16": 5123, "uint32": 5125, "float32": 5126}
_KINDS = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTICES, TRIANGLES = 34962, 34963  # uses of a buffer on a GPU
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
            "componentType": _COMPONENTS[array.dtype.name],
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


def save_amass(path: Path, pose: Pose, shape: Shape, fps: float) -> None:
    """Write T poses in AMASS's format, atomically.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_amass(Path(folder) / "poses.npz", Pose.rest(8), Shape(torch.zeros(10)), fps=30)
        ...     np.load(Path(folder) / "poses.npz")["poses"].shape
        (8, 165)
    """
    array = lambda tensor: tensor.detach().numpy()
    write_arrays(
        path,
        poses=array(pose.rotations.flatten(1)),
        trans=array(pose.transl),
        betas=array(shape.betas),
        expression=array(pose.expression),
        gender=np.array("neutral"),
        mocap_frame_rate=np.array(float(fps)),
        surface_model_type=np.array("smplx"),
    )
