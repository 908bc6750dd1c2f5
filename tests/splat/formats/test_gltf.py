"""Gaussians in a .glb: ours come back, other programs' forms are read, the rest is refused."""

import json

import numpy as np
import pytest
import torch
from samples.scenes import some_gaussians

from gva_mi.core.errors import InputError
from gva_mi.splat import reference
from gva_mi.splat.formats.gltf import SPLATTING, Glb, load_gltf
from gva_mi.splat.scene import Scene


def written(path, primitive, file, **node):
    file.description |= {"meshes": [{"primitives": [primitive]}],
        "nodes": [{"children": [1], "translation": [0, 0, 5]}, {"mesh": 0} | node],
        "scenes": [{"nodes": [0]}]}  # fmt: skip
    file.save(path)
    return path


@pytest.fixture
def whole():
    """Return a function: a path to a .glb of random Gaussians, changed by ``change``."""

    def write(path, change=lambda file, primitive: None, coefficients=4, **node):
        file = Glb()
        primitive = file.gaussians(path, some_gaussians(coefficients))
        change(file, primitive)
        return written(path, primitive, file, **node)

    return write


@pytest.mark.parametrize("coefficients", [1, 16])
def test_gaussians_come_back_where_their_node_is(whole, tmp_path, coefficients):
    exact, found = (some_gaussians(coefficients),
        load_gltf(whole(tmp_path / "a.glb", coefficients=coefficients)))  # fmt: skip
    torch.testing.assert_close(found.means, exact.means + torch.tensor([0.0, 0, 5]))
    same = lambda q: torch.nn.functional.normalize(q, dim=1)
    torch.testing.assert_close((same(found.quats) * same(exact.quats)).sum(1).abs(), torch.ones(20))
    for name in ("scales", "opacities", "sh"):
        torch.testing.assert_close(getattr(found, name), getattr(exact, name))


def test_a_node_turns_and_scales_its_gaussians_with_their_colours(whole, tmp_path):
    """Seen from the same side of the Gaussian, the colour stays."""
    half = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]  # xyzw, 90 degrees about y
    placed = {"rotation": half, "scale": [2, 2, 2], "translation": [1, 0, 0]}
    exact, found = some_gaussians(), load_gltf(whole(tmp_path / "a.glb", **placed))
    R = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    torch.testing.assert_close(found.means, 2 * exact.means @ R.T + torch.tensor([1.0, 0, 5]))
    torch.testing.assert_close(found.scales, 2 * exact.scales)
    turned = reference.rotation(found.quats), R @ reference.rotation(exact.quats)
    torch.testing.assert_close(*turned, atol=1e-5, rtol=0)
    d = torch.nn.functional.normalize(
        torch.randn(20, 3, generator=torch.Generator().manual_seed(1)), dim=1
    )
    band = lambda g, d: torch.einsum(
        "nk,nkc->nc", d[:, [1, 2, 0]] * torch.tensor([-1.0, 1, -1]), g.sh[:, 1:]
    )
    torch.testing.assert_close(band(found, d @ R.T), band(exact, d), atol=1e-5, rtol=1e-5)


def test_small_numbers_of_other_programs_are_read(tmp_path):
    """Rotations in bytes, opacities in 16 bits, scales in whole bytes, one buffer for all."""
    file, count = Glb(), 5
    file.add(np.zeros((count, 3), np.float32))
    constant = file.add(np.full((count, 3), 0.5, np.float32))
    rows = np.zeros(count, [("q", "i1", 4), ("o", "<u2"), ("s", "u1", 3), ("pad", "u1", 3)])
    rows["q"], rows["o"], rows["s"] = [0, 0, -127, 0], 65535 // 5, [1, 2, 3]
    file.add(np.frombuffer(rows.tobytes(), "<u4"))
    number = len(file.description["bufferViews"]) - 1
    file.description["bufferViews"][number]["byteStride"] = rows.itemsize
    numbers = {}
    for name, offset, kind, shape in (
        ("ROTATION", 0, 5120, "VEC4"),
        ("OPACITY", 4, 5123, "SCALAR"),
        ("SCALE", 6, 5121, "VEC3"),
    ):
        numbers[f"{SPLATTING}:{name}"] = len(file.description["accessors"])
        about = {"bufferView": number, "byteOffset": offset, "componentType": kind, "count": count,
            "type": shape}  # fmt: skip
        file.description["accessors"].append(
            about | ({} if name == "SCALE" else {"normalized": True})
        )
    about = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    attributes = {"POSITION": 0, f"{SPLATTING}:SH_DEGREE_0_COEF_0": constant} | numbers
    found = load_gltf(written(tmp_path / "a.glb",
        {"attributes": attributes, "extensions": {SPLATTING: about}}, file))  # fmt: skip
    assert found.quats[0].tolist() == [0, 0, 0, -1] and found.scales[3].tolist() == [1, 2, 3]
    assert torch.allclose(found.opacities, torch.tensor(0.2)) and found.sh.shape == (5, 1, 3)


def test_a_scene_looks_at_the_front_of_a_glb(whole, tmp_path):
    """Its z points to the viewer, so the camera stands before it."""
    scene = Scene.load(whole(tmp_path / "a.glb"))
    centre = np.linalg.inv(scene.camera.T_camera_world)[:3, 3]
    assert centre[2] > scene.gaussians.means[:, 2].median()


def extended(**about):
    return lambda file, primitive: primitive["extensions"][SPLATTING].update(about)


def first_accessor(**about):
    return lambda file, primitive: file.description["accessors"][0].update(about)


BAD = {
    "mesh": (lambda file, primitive: primitive.pop("extensions"), "holds no Gaussians"),
    "light": (extended(colorSpace="lin_rec709_display"), "colours are in 'lin_rec709_display'"),
    "compressed": (extended(extensions={"KHR_x_spz": {}}), "stored as 'KHR_x_spz'"),
    "kernel": (extended(kernel="disc"), "stored as 'disc'"),
    "scales": (
        lambda file, primitive: primitive["attributes"].pop(f"{SPLATTING}:SCALE"),
        "'KHR_gaussian_splatting:SCALE' is missing",
    ),
    "count": (first_accessor(count=10**9), "unexpected format"),
    "sparse": (first_accessor(sparse={}), "sparse or compressed"),
    "uneven": (lambda file, primitive: None, "scales its Gaussians unevenly"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_not_read_is_one_sentence(whole, tmp_path, name):
    change, sentence = BAD[name]
    node = {"scale": [1, 2, 1]} if name == "uneven" else {}
    with pytest.raises(InputError) as refused:
        load_gltf(whole(tmp_path / "a.glb", change, **node))
    assert sentence in str(refused.value) and str(tmp_path / "a.glb") in str(refused.value)


def test_a_file_that_is_cut_or_of_another_kind_is_refused(whole, tmp_path):
    path = whole(tmp_path / "a.glb")
    data = path.read_bytes()
    for content in (
        data[:700],
        data[: len(data) // 2],
        data[:10],
        b"ply\n",
        json.dumps({}).encode(),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"a\.glb"):
            load_gltf(path)
