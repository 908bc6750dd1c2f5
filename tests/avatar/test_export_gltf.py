"""A .glb file is consistent, and skinning by its own numbers gives the avatar's surface."""

import json
import struct

import numpy as np
import pytest
import torch
import trimesh

from gva_mi.avatar.export import (
    NamedMotion,
    load_gltf_avatar,
    load_gltf_motion,
    save_gltf,
    surface_colors,
)
from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.body.skinning import skin_points, strongest
from gva_mi.body.so3 import to_matrix

DTYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Read:
    """A .glb, parsed from its bytes alone."""

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON" and size % 4 == 0
        self.json = json.loads(data[20 : 20 + size])
        left, kind = struct.unpack_from("<I4s", data, 20 + size)
        assert kind == b"BIN\0" and left % 4 == 0 and 28 + size + left == len(data)
        self.binary = data[28 + size :]
        assert self.json["buffers"] == [{"byteLength": left}]

    def array(self, number):
        accessor = self.json["accessors"][number]
        view = self.json["bufferViews"][accessor["bufferView"]]
        dtype, width = DTYPES[accessor["componentType"]], WIDTHS[accessor["type"]]
        assert view["byteLength"] == accessor["count"] * width * dtype().itemsize
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= len(self.binary)
        flat = np.frombuffer(self.binary, dtype, accessor["count"] * width, view["byteOffset"])
        found = flat.reshape(accessor["count"], width)
        if "min" in accessor:
            assert np.array_equal(found.min(0), np.float32(accessor["min"]))
            assert np.array_equal(found.max(0), np.float32(accessor["max"]))
        return found

    def vertices(self, name, mesh=0):
        return self.array(self.json["meshes"][mesh]["primitives"][0]["attributes"][name])

    def inverse_bind(self):
        flat = self.array(self.json["skins"][0]["inverseBindMatrices"])
        return flat.reshape(-1, 4, 4).swapaxes(1, 2).astype(np.float64)

    def moves(self, frame):
        """The animation's rotations and translations of a frame, by node."""
        (animation,) = self.json["animations"]
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            values = self.array(sampler["output"])
            assert len(values) == len(self.array(sampler["input"]))
            target = channel["target"]
            yield target["node"], target["path"], values[frame].astype(np.float64)

    def globals(self, moves=()):
        """The global transform of each joint's node, by walking down from the scene's root."""
        nodes = [dict(node) for node in self.json["nodes"]]
        for node, path, value in moves:
            nodes[node][path] = value
        found = {}

        def walk(number, above):
            found[number] = above @ local(nodes[number])
            for child in nodes[number].get("children", ()):
                walk(child, found[number])

        for root in self.json["scenes"][self.json["scene"]]["nodes"]:
            walk(root, np.eye(4))
        return np.stack([found[j] for j in self.json["skins"][0]["joints"]])

    def skinned(self, globals_, mesh=0):
        """Vertices by linear blend skinning, as the format defines it."""
        maps = globals_ @ self.inverse_bind()
        joints, weights = self.vertices("JOINTS_0", mesh), self.vertices("WEIGHTS_0", mesh)
        blended = np.einsum("vk,vkij->vij", weights.astype(np.float64), maps[joints])
        x = self.vertices("POSITION", mesh).astype(np.float64)
        return np.einsum("vij,vj->vi", blended[:, :3, :3], x) + blended[:, :3, 3]


def local(node):
    T = np.eye(4)
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    T[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]  # fmt: skip
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T


@pytest.fixture(scope="module")
def motion(turning):
    pose, _ = turning(5)
    pose.rotations[:] += 0.2 * torch.sin(torch.arange(pose.rotations.numel())).view_as(
        pose.rotations
    )
    pose.transl[:] = torch.linspace(-1, 1, 15).view(5, 3)
    return pose


@pytest.fixture(scope="module")
def read(known, motion, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "a.glb"
    save_gltf(path, known, [NamedMotion("walk", motion, 25)])
    return Read(path)


def test_it_has_a_surface_a_skeleton_and_a_motion(read, known):
    rig = known.rig
    for number in range(len(read.json["accessors"])):
        read.array(number)
    assert read.json["asset"]["version"] == "2.0"
    assert [node["name"] for node in read.json["nodes"][:55]] == list(JOINTS)
    for j, node in enumerate(read.json["nodes"][:55]):
        assert all(PARENTS[child] == j for child in node.get("children", ()))
    assert np.allclose(read.vertices("POSITION"), rig.vertices)
    indices = read.array(read.json["meshes"][0]["primitives"][0]["indices"])
    assert np.array_equal(indices.reshape(-1, 3), rig.faces)
    assert np.allclose(np.linalg.norm(read.vertices("NORMAL"), axis=1), 1, atol=1e-5)
    times = read.array(read.json["animations"][0]["samplers"][0]["input"])
    assert np.allclose(times[:, 0], np.arange(5) / 25)
    surface = read.json["nodes"][55]
    assert (surface["mesh"], surface["skin"]) == (0, 0)


@pytest.mark.parametrize("frame", [0, 3])
def test_skinning_by_the_file_is_the_avatars(read, known, motion, frame):
    rig, pose = known.rig, motion[frame]
    maps = joint_transforms(pose.rotations, rig.joints, rig.parents, pose.transl)[0]
    ours = skin_points(rig.vertices, strongest(rig.weights, 4), maps).numpy()
    theirs = read.skinned(read.globals(read.moves(frame)))
    assert np.abs(theirs - ours).max() < 2e-6
    assert np.abs(ours - rig.vertices.numpy()).max() > 0.3  # and something moved


@pytest.fixture(scope="module")
def with_splats(known, motion, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "splats.glb"
    save_gltf(path, known, [NamedMotion("walk", motion, 25)], splats=True)
    return path


def test_gaussians_stand_beside_the_surface_on_the_same_skeleton(with_splats, known, motion):
    """By the file's bytes: at rest those of the avatar, in a pose where skinning puts them."""
    read, G = Read(with_splats), known.canonical
    assert "KHR_gaussian_splatting" in read.json["extensionsUsed"]
    assert "extensionsRequired" not in read.json  # others show the surface
    assert [read.json["nodes"][k]["skin"] for k in (55, 56)] == [0, 0]
    of = lambda name: read.vertices(f"KHR_gaussian_splatting:{name}", 1)
    w, x, y, z = torch.nn.functional.normalize(G.quats.detach(), dim=1).T
    assert np.allclose(of("ROTATION"), torch.stack([x, y, z, w], 1), atol=1e-6)
    assert np.allclose(of("SCALE"), G.scales.detach(), rtol=1e-5)
    assert np.allclose(of("OPACITY")[:, 0], G.opacities.detach(), atol=1e-6)
    with torch.no_grad():
        at_rest = known(Pose.rest())
    assert np.allclose(of("SH_DEGREE_0_COEF_0"), at_rest.sh[:, 0], atol=1e-5)
    rig, pose = known.rig, motion[2]
    maps = joint_transforms(pose.rotations, rig.joints, rig.parents, pose.transl)[0]
    ours = skin_points(G.means.detach(), strongest(G.weights, 4), maps).numpy()
    assert np.abs(read.skinned(read.globals(read.moves(2)), 1) - ours).max() < 2e-6


def test_another_library_reads_both(with_splats, known):
    read = trimesh.load(with_splats)
    assert np.allclose(read.geometry["surface"].vertices, known.rig.vertices)
    assert np.allclose(read.geometry["gaussians"].vertices, known.canonical.means.detach())


def test_such_a_file_is_an_avatar_again(with_splats, known, motion):
    """At rest to the last digits; in a pose without blend shapes, and with four weights."""
    read = load_gltf_avatar(with_splats)
    with torch.no_grad():
        for pose, close in ((Pose.rest(), 1e-5), (motion[2], 0.03)):
            found, exact = read(pose), known(pose)
            assert (found.means - exact.means).abs().max() < close  # metres
            assert (found.covars - exact.covars).abs().max() < close * exact.covars.max()
    pose, shape = load_gltf_motion(with_splats)
    assert torch.allclose(to_matrix(pose.rotations), to_matrix(motion.rotations), atol=1e-5)
    assert torch.allclose(pose.transl, motion.transl, atol=1e-6)
    assert torch.equal(shape.betas, known.rig.betas)


def test_vertices_have_the_colors_of_nearby_gaussians(known):
    at = known.canonical.means.detach()
    own = known.canonical.sh.detach()[:, 0].numpy() * 0.28209479 + 0.5
    found = surface_colors(known, at)
    assert (
        np.abs(found - own).mean() < 0.05 and np.corrcoef(found.ravel(), own.ravel())[0, 1] > 0.95
    )


def test_without_a_motion_there_is_no_animation(known, tmp_path):
    save_gltf(tmp_path / "a.glb", known)
    assert "animations" not in Read(tmp_path / "a.glb").json


def test_consecutive_rotations_take_the_short_way(known, tmp_path):
    spin = Pose.rest(8)
    spin.rotations[:, 0, 1] = torch.linspace(-6, 6, 8)
    save_gltf(tmp_path / "a.glb", known, [NamedMotion("spin", spin, 25)])
    read = Read(tmp_path / "a.glb")
    found = [{(n, path): x for n, path, x in read.moves(k)}[0, "rotation"] for k in range(8)]
    assert all(a @ b > 0 for a, b in zip(found, found[1:], strict=False))
