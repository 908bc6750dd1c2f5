"""Export of an avatar's surface to glTF 2.0, for programs that know meshes but no Gaussians.

The surface of the rest body hangs on 55 nodes, one per joint, with

    1. node j      at J_j - J_parent(j) of its parent, unrotated at rest     J: joints at rest
    2. inverse bind matrix of j = translation by -J_j
    3. x' = Σ_j w_j global_j inverse_bind_j x      so that global_j inverse_bind_j = T_world_rest[j]

of :mod:`gva_mi.body.kinematics`. A motion turns the nodes, and moves the first one too. glTF cannot
express the blend shapes of bent joints, so they are left out with those of the face, and so are all
but the four largest skinning weights of a vertex. Vertices take their colours from the Gaussians
around them, lit in the rest pose, and are shown unlit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.formats.glb import TRIANGLES, VERTICES, Glb
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import JOINTS, Pose
from gva_mi.body.skinning import strongest
from gva_mi.body.so3 import to_quaternion
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat.formats.splat import plain_colors

NEIGHBOURS = 8  # Gaussians that colour a vertex
_NEAR = 0.003  # metres: the smallest distance in the weights
_UNLIT = "KHR_materials_unlit"


@torch.no_grad()
def save_gltf(path: Path, avatar: Avatar, motion: Pose | None = None, fps: float = 30) -> None:
    """Write the surface with skeleton, skin and colours to a .glb, atomically.

    A ``motion`` of T frames, ``fps`` a second, is written as its animation.
    """
    file, rig = Glb(), avatar.rig
    joints = rig.joints.double().numpy()
    inverse_bind = np.broadcast_to(np.eye(4, dtype=np.float32), (len(joints), 4, 4)).copy()
    inverse_bind[:, :3, 3] = -joints
    surface = len(JOINTS)  # the node after those of the joints
    file.description |= {
        "extensionsUsed": [_UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0, surface]}],
        "nodes": [*_skeleton(rig), {"name": "surface", "mesh": 0, "skin": 0}],
        "skins": [
            {
                "joints": list(range(len(JOINTS))),
                "skeleton": 0,
                "inverseBindMatrices": file.add(inverse_bind),
            }
        ],
        "materials": [
            {
                "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1},
                "extensions": {_UNLIT: {}},
            }
        ],
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
    kept = strongest(rig.weights, 4)
    weights, joints = kept.topk(4, dim=1)
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
    """
    from scipy.spatial import cKDTree

    expressions = avatar.rig.expression_joints.shape[2]
    gaussians = avatar(Pose.rest(1, expressions, avatar.canonical.means.dtype))
    tree = cKDTree(gaussians.means.double().numpy())
    count = min(NEIGHBOURS, len(gaussians))
    distance, nearest = (
        x.reshape(len(points), count) for x in tree.query(points.double().numpy(), k=count)
    )
    opacities = gaussians.opacities.double().numpy()[nearest]
    share = (opacities + 1e-6) / np.maximum(distance, _NEAR) ** 2
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
