"""Normal maps of both conventions, on the frame's pixels."""

import json

import numpy as np
import pytest

from gva_mi import InputError
from gva_mi.splat import Camera
from gva_mi.subject.normals import NormalMaps
from gva_mi.subject.pictures import write_image

SIZE = 96
CAMERA = Camera(120.0, 130.0, 40.0, 52.0, np.eye(4), SIZE, SIZE)
RADIUS = 0.02


def rays(camera=CAMERA):
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    d = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], -1)
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def ball(centre):
    """Camera-space normals of a ball that the camera sees, and the pixels that see it."""
    d = rays()
    along = d @ centre
    depth = RADIUS**2 - (centre @ centre - along**2)
    hit = depth > 0
    point = d * (along - np.sqrt(np.maximum(depth, 0)))[..., None]
    return (point - centre) / RADIUS * hit[..., None], hit


def folder_with(tmp_path, maps, about=None, suffix="npy"):
    (tmp_path / "normals").mkdir()
    for k, normals in enumerate(maps):
        if suffix == "npy":
            np.save(tmp_path / f"normals/{k:06d}.npy", normals.astype(np.float32))
        else:
            write_image(tmp_path / f"normals/{k:06d}.png", (normals + 1) / 2)
    if about is not None:
        (tmp_path / "normals.json").write_text(json.dumps(about))
    return NormalMaps.open(tmp_path, len(maps))


def angle(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(-1), -1, 1)))


@pytest.mark.parametrize("suffix", ["npy", "png"])
def test_maps_in_the_camera_s_space_come_back(tmp_path, suffix):
    normals, hit = ball(np.array([0.1, 0.05, 0.4]))
    maps = folder_with(tmp_path, [normals], suffix=suffix)
    found = maps.read(0, CAMERA)
    assert found.dtype == np.float32 and not found[~hit].any()
    assert angle(found[hit], normals[hit]).max() < (0.5 if suffix == "png" else 0.05)


def test_the_rotation_takes_the_axis_to_each_ray(tmp_path):
    """The least rotation from the axis to the ray, transposed, takes every ray to the axis."""
    d = rays()
    icon = d * (1, -1, -1)  # as if all of the surface faced away along the ray, unturned
    found = folder_with(tmp_path, [np.tile((0.0, 0.0, -1.0), (SIZE, SIZE, 1)), icon],
                        {"convention": "icon"})  # fmt: skip
    np.testing.assert_allclose(found.read(0, CAMERA), d, atol=1e-6)  # z away is the ray itself
    turned = found.read(1, CAMERA)
    c, twice = d[..., 2], 2 * np.arccos(np.clip(d[..., 2], -1, 1))
    np.testing.assert_allclose((turned * d).sum(-1), c, atol=1e-6)  # one angle further out
    np.testing.assert_allclose(turned[..., 2], np.cos(twice), atol=1e-5)


def test_opengl_s_normals_are_those_of_opencv_with_y_and_z_turned_round(tmp_path):
    truth = -rays() * np.ones((SIZE, SIZE, 1))
    found = folder_with(tmp_path, [truth * (1, -1, -1)], {"convention": "opengl"})
    assert angle(found.read(0, CAMERA), truth).max() < 0.05


def test_a_map_of_a_box_lands_in_its_box(tmp_path):
    """Also one that reaches out of the picture, and is finer than the frame's pixels."""
    normals, hit = ball(np.array([-0.1, 0.02, 0.4]))
    left, top, right, bottom = -20, 25, 60, 105
    padded = np.pad(normals, ((40, 40), (40, 40), (0, 0)))
    crop = padded[top + 40 : bottom + 40, left + 40 : right + 40]
    fine = crop.repeat(3, axis=0).repeat(3, axis=1)
    about = {"convention": "perspective", "boxes": [[left, top, right, bottom]]}
    found = folder_with(tmp_path, [fine], about).read(0, CAMERA)
    assert not found[:25].any() and not found[:, 60:].any()
    inner = hit & (np.linalg.norm(found, axis=-1) > 0)
    assert inner[26:, :59].sum() > 0.9 * hit.sum()
    assert np.median(angle(found[inner], normals[inner])) < 2


BAD = {
    "no JSON": ("{", "not readable as JSON"),
    "no convention": ("{}", "'convention' must be one of perspective, opengl, icon"),
    "boxes": ('{"convention": "icon", "boxes": [[1, 2, 3]]}', "'boxes' must be four numbers"),
    "too few": (
        '{"convention": "icon", "boxes": [[0, 0, 1, 1], [0, 0, 1, 1]]}',
        "four for each of the 3 frames",
    ),
    "turned": ('{"convention": "icon", "boxes": [5, 5, 1, 9]}', "right > left"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_file_that_cannot_be_used_is_refused_in_one_sentence(name, tmp_path):
    text, sentence = BAD[name]
    (tmp_path / "normals").mkdir()
    (tmp_path / "normals.json").write_text(text)
    with pytest.raises(InputError, match=sentence):
        NormalMaps.open(tmp_path, 3)


def test_maps_that_say_nothing_or_show_another_size(tmp_path):
    """Plain backgrounds are no normals; a frame may have no map; a smaller one needs its box."""
    assert NormalMaps.open(tmp_path, 2) is None
    maps = folder_with(tmp_path, [np.full((SIZE, SIZE, 3), c) for c in (-1.0, 0, 1)], suffix="png")
    assert not any(maps.read(k, CAMERA).any() for k in range(3)) and maps.read(3, CAMERA) is None
    np.save(tmp_path / "normals/000000.npy", np.ones((8, 8, 3), np.float32))
    with pytest.raises(InputError, match="need their 'boxes' in normals.json"):
        maps.read(0, CAMERA)


@pytest.mark.parametrize("about", [None, {"convention": "icon", "boxes": [[5, -8, 90.5, 77]]}])
def test_a_part_equals_that_part_of_the_whole_map(tmp_path, about):
    normals, _ = ball(np.array([0.03, 0.01, 0.4]))
    maps = folder_with(tmp_path, [normals], about)
    part = np.s_[30:75, 21:84]
    np.testing.assert_allclose(maps.read(0, CAMERA, part), maps.read(0, CAMERA)[part], atol=1e-5)
