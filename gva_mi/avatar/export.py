"""Export an avatar with skeleton and motions to other programs, and its poses.

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

With ``splats`` the file also holds the Gaussians at rest (:mod:`gva_mi.splat.formats.gltf`), in a
node of the same skin: their four largest skinning weights are ``JOINTS_0`` and ``WEIGHTS_0``. No
standard says yet how a skin moves Gaussians; programs that know none show the surface, and the
Gaussians as points. The second scene is without the surface, which hides some of the Gaussians.
:func:`load_gltf_avatar` reads such a file again. It has neither blend shapes nor light, and takes
the derivatives of weights from the surface.

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

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar, AvatarOptions
from gva_mi.avatar.canonical import CanonicalGaussians, SeedOptions
from gva_mi.avatar.residual import PoseResidual
from gva_mi.avatar.rig import Rig, SkinningOptions
from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.skinning import strongest
from gva_mi.body.so3 import to_quaternion, to_rotvec
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import write_arrays
from gva_mi.core.srgb import decoded
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat.formats.gltf import (
    SPLATTING,
    TRIANGLES,
    VERTICES,
    Glb,
    OpenedGlb,
    load_gltf,
)
from gva_mi.splat.formats.spz import plain_colors
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.reference import rotation

COLORING_GAUSSIANS = 8  # nearest Gaussians that colour a vertex; chosen: all around it
# Metres: the smallest distance in the weights. Chosen: less than the Gaussians' spacing.
SMALLEST_DISTANCE = 0.003
_UNLIT = "KHR_materials_unlit"
_OURS = "a .glb of an avatar, as `gva-mi export --splats` writes it"


@dataclass(frozen=True)
class NamedMotion:
    """A motion of a file that holds several.

    Example:
        >>> NamedMotion("bow", Pose.rest(frames=50), fps=25).name
        'bow'
    """

    name: str
    pose: Pose  # T frames
    fps: float  # frames a second


@torch.no_grad()
def save_gltf(
    path: Path, avatar: Avatar, motions: Sequence[NamedMotion] = (), splats: bool = False
) -> None:
    """Write the surface with skeleton, skin and colours to a .glb, atomically.

    ``motions`` are written as animations; with ``splats``, the Gaussians are written, too.

    Example:
        >>> import tempfile
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_gltf(Path(folder) / "avatar.glb", avatar, splats=True)
        ...     (Path(folder) / "avatar.glb").read_bytes()[:4]
        b'glTF'
    """
    file, rig = Glb(), avatar.rig
    joints = rig.joints.double().numpy()
    inverse_bind = np.broadcast_to(np.eye(4, dtype=np.float32), (len(joints), 4, 4)).copy()
    inverse_bind[:, :3, 3] = -joints
    surface = len(JOINTS)  # its node comes after the nodes of the joints
    skin = {"joints": list(range(surface)), "skeleton": 0}
    skin["extras"] = {"body": rig.body, "betas": rig.betas.tolist()}
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
    if splats:
        file.description["extensionsUsed"] += [SPLATTING]
        file.description["scenes"][0]["nodes"] += [surface + 1]
        file.description["scenes"] += [{"name": "gaussians", "nodes": [0, surface + 1]}]
        file.description["nodes"] += [{"name": "gaussians", "mesh": 1, "skin": 0}]
        primitive = _splats(file, path, avatar)
        file.description["meshes"] += [{"name": "gaussians", "primitives": [primitive]}]
    if motions:
        file.description["animations"] = [_animation(file, avatar, motion) for motion in motions]
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
    vertices = rig.vertices.float()
    colors = decoded(surface_colors(avatar, rig.vertices))
    opaque = np.column_stack([colors, np.ones(len(colors))])
    attributes = {
        "POSITION": vertices.numpy(),
        "NORMAL": vertex_normals(vertices, rig.faces).numpy(),
        "COLOR_0": opaque.astype(np.float32),
    } | _skinning(rig.weights)
    return {
        "attributes": {name: file.add(array, VERTICES) for name, array in attributes.items()},
        "indices": file.add(rig.faces.numpy().astype(np.uint32).ravel(), TRIANGLES),
        "material": 0,
    }


def _splats(file: Glb, path: Path, avatar: Avatar) -> dict:
    """Describe the primitive of the Gaussians, at rest and lit there."""
    G = avatar.canonical
    lit = avatar(Pose.rest(1, avatar.rig.expression_joints.shape[2], G.means.dtype)).sh
    at_rest = Gaussians(G.means, G.quats, G.scales, G.opacities, sh=lit)
    return file.gaussians(path, at_rest, **_skinning(G.weights))


def _skinning(weights: Tensor) -> dict[str, np.ndarray]:
    """Return the attributes of the four largest of skinning weights (N, 55)."""
    largest, joints = strongest(weights, 4).topk(4, dim=1)
    joints = joints.masked_fill(largest == 0, 0)  # required by the format
    of_joints = joints.numpy().astype(np.uint8)
    return {"JOINTS_0": of_joints, "WEIGHTS_0": largest.float().numpy()}


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


def _animation(file: Glb, avatar: Avatar, named: NamedMotion) -> dict:
    """Describe a motion: all joints turn, and the first one moves."""
    motion = named.pose
    times = file.add((np.arange(len(motion)) / named.fps).astype(np.float32))
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
    return {"name": named.name, "samplers": samplers, "channels": channels}


@torch.no_grad()
def load_gltf_avatar(path: Path) -> Avatar:
    """Read an avatar again that :func:`save_gltf` wrote with its Gaussians.

    Raises:
        InputError: not such a file.

    Example:
        >>> import tempfile
        >>> from gva_mi.avatar.avatar import seed_avatar
        >>> from gva_mi.body.smplx import load_body
        >>> seeds = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=seeds)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_gltf(Path(folder) / "avatar.glb", avatar, splats=True)
        ...     len(load_gltf_avatar(Path(folder) / "avatar.glb").canonical)
        500
    """
    file = OpenedGlb.read(path, _OURS)
    with expecting(path, _OURS):
        rig, gaussians = _rig(path, file), load_gltf(path)
        attributes, _ = next(file.splats())
        skin = rig.skin(SkinningOptions())
        binding = skin.bind(gaussians.means)
        binding["weights"] = _weights(file, attributes)
        canonical = CanonicalGaussians(
            means=gaussians.means,
            quats=gaussians.quats,
            log_scales=gaussians.scales.log(),
            logit_opacities=torch.logit(gaussians.opacities, eps=1e-6),
            sh=gaussians.sh[:, :1],
            **binding,
        )
        options = AvatarOptions(SeedOptions(sh_degree=0))
        residual = PoseResidual(options.residual, torch.zeros(3), 1.0)
        return Avatar(canonical, residual, rig, skin, options)


def load_gltf_motion(path: Path) -> tuple[Pose, Shape]:
    """Return the first animation of such a file, without one the rest pose, and the shape.

    Raises:
        InputError: not such a file.

    Example:
        >>> import tempfile
        >>> from gva_mi.avatar.avatar import seed_avatar
        >>> from gva_mi.body.smplx import load_body
        >>> seeds = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=seeds)
        >>> still = NamedMotion("still", Pose.rest(frames=3), fps=30)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_gltf(Path(folder) / "avatar.glb", avatar, [still])
        ...     len(load_gltf_motion(Path(folder) / "avatar.glb")[0])
        3
    """
    file = OpenedGlb.read(path, _OURS)
    with expecting(path, _OURS):
        rig, animations = _rig(path, file), file.description.get("animations")
        shape = Shape(rig.betas)
        if not animations:
            return Pose.rest(), shape
        samplers, found = animations[0]["samplers"], {}
        for channel in animations[0]["channels"]:
            target = channel["target"]["node"], channel["target"]["path"]
            found[target] = file.array(samplers[channel["sampler"]]["output"])
        quats = np.stack([found[j, "rotation"] for j in range(len(JOINTS))], axis=1)
        R = rotation(torch.tensor(quats[..., [3, 0, 1, 2]]).flatten(0, 1).double())
        turns = to_rotvec(R).unflatten(0, (-1, len(JOINTS))).float()
        transl = torch.tensor(found[0, "translation"]) - rig.joints[0]
        return Pose(turns, transl, torch.zeros(len(turns), 0)), shape


def _rig(path: Path, file: OpenedGlb) -> Rig:
    """Return skeleton and surface of such a file, without blend shapes."""
    nodes, count = file.description["nodes"], len(JOINTS)
    if [node.get("name") for node in nodes[:count]] != list(JOINTS):
        raise InputError(f"{path}: has another skeleton, or none; expected {_OURS}")
    parents = [-1] * count
    for parent, node in enumerate(nodes[:count]):
        for child in node.get("children", ()):
            parents[child] = parent
    surface = file.description["meshes"][nodes[count]["mesh"]]["primitives"][0]
    vertices = torch.tensor(file.array(surface["attributes"]["POSITION"]))
    extras = file.description["skins"][0]["extras"]
    return Rig(
        joints=torch.tensor(np.stack(file.transforms()[:count])[:, :3, 3]).float(),
        parents=tuple(parents),
        vertices=vertices,
        faces=torch.tensor(file.array(surface["indices"]).astype(np.int64)).view(-1, 3),
        weights=_weights(file, surface["attributes"]),
        looseness=torch.zeros(len(vertices)),
        directions=torch.zeros(len(vertices), 3, 0),
        pose_features=torch.zeros(0, dtype=torch.int64),
        expression_joints=torch.zeros(count, 3, 0),
        betas=torch.tensor(extras["betas"]),
        body=str(extras["body"]),
    )


def _weights(file: OpenedGlb, attributes: dict[str, int]) -> Tensor:
    """Return skinning weights (N, 55) from the attributes of a primitive."""
    joints = torch.tensor(file.array(attributes["JOINTS_0"]).astype(np.int64))
    largest = torch.tensor(file.array(attributes["WEIGHTS_0"]))
    return torch.zeros(len(joints), len(JOINTS)).scatter_add(1, joints, largest)


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
