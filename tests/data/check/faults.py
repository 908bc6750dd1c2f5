"""Ways to break a subject's folder, by name: the finding that has to name each, and how it is done.

Faults of the pictures' meaning work on any subject, so that they are tried on people with noise,
too: ``FAULTS[name](folder)`` changes the folder.
"""

import json
import shutil

import numpy as np

from gva_mi.data.film import Film
from gva_mi.data.pictures import read_image, write_image

FAULTS = {}


def fault(what):
    def keep(function):
        FAULTS[what] = function
        return function

    return keep


def arrays(path):
    with np.load(path) as file:
        return {key: file[key] for key in file.files}


def change(path, **changes):
    """Replace arrays of an .npz by functions of them."""
    found = arrays(path)
    np.savez(path, **found | {key: change(found[key]) for key, change in changes.items()})


def masks(folder, change):
    for path in sorted((folder / "masks").glob("*.png")):
        write_image(path, np.ascontiguousarray(change(read_image(path, 1))))


def maps(folder, change):
    """Normals as floating point; zero where unknown."""
    for path in sorted((folder / "normals").glob("*")):
        if path.suffix == ".npy":
            stored = np.load(path)
        else:
            stored = read_image(path, 3) / np.float32(127.5) - 1
            stored[np.linalg.norm(stored, axis=-1) > 1.5] = 0
            path.unlink()
        np.save(path.with_suffix(".npy"), np.ascontiguousarray(change(stored), np.float32))


def pictures(folder, change):
    if (folder / "video.mp4").exists():
        for k, image in enumerate(Film(folder / "video.mp4")):
            write_image(folder / f"frames/{k:06d}.png", image)
        (folder / "video.mp4").unlink()
    for path in sorted((folder / "frames").glob("*.png")):
        write_image(path, np.ascontiguousarray(change(read_image(path, 3))))


def all_pictures(folder, change):
    pictures(folder, change)
    masks(folder, change)


@fault("K is not normalised")
def _(folder):
    change(folder / "cameras.npz", K=lambda K: 0.5 * K)


@fault("K is transposed")
def _(folder):
    change(folder / "cameras.npz", K=lambda K: K.swapaxes(-1, -2))


@fault("T_camera_world is mirrored")
def _(folder):
    change(folder / "cameras.npz", T_camera_world=lambda T: np.diag([-1, 1, 1, 1]) @ T)


@fault("T_camera_world is transposed")
def _(folder):
    change(folder / "cameras.npz", T_camera_world=lambda T: T.swapaxes(-1, -2))


@fault("T_camera_world has a scale")
def _(folder):
    change(folder / "cameras.npz", T_camera_world=lambda T: np.diag([2, 2, 2, 1]) @ T)


@fault("T_camera_world is no rotation")
def _(folder):
    change(folder / "cameras.npz", T_camera_world=lambda T: T + np.eye(4) * (0.1, 0, 0, 0))


@fault("T_camera_world is inverted")
def _(folder):
    change(folder / "cameras.npz", T_camera_world=np.linalg.inv)


@fault("cameras in OpenGL's axes")
def _(folder):
    change(folder / "cameras.npz", T_camera_world=lambda T: np.diag([1, -1, -1, 1]) @ T)


@fault("poses in a world with y down")
def _(folder):
    change(folder / "cameras.npz", T_camera_world=lambda T: T @ np.diag([1, -1, -1, 1]))


@fault("poses in a world with z up")
def _(folder):
    z_up = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    change(folder / "cameras.npz", T_camera_world=lambda T: T @ z_up)


@fault("cameras in millimetres")
def _(folder):
    far = np.ones((4, 4))
    far[:3, 3] = 1000
    change(folder / "cameras.npz", T_camera_world=lambda T: T * far)


@fault("poses in millimetres")
def _(folder):
    away = np.array([0.3, 0.2, 0.1], "f4")  # the person is not at the origin, so that units count
    R = arrays(folder / "cameras.npz")["T_camera_world"][..., :3, :3]

    def moved(T):  # the camera goes with the person
        T = T.copy()
        T[..., :3, 3] -= R @ away
        return T

    change(folder / "cameras.npz", T_camera_world=moved)
    change(folder / "poses.npz", transl=lambda t: (t + away) * np.float32(1000))


@fault("poses in degrees")
def _(folder):
    degrees = lambda x: np.degrees(x).astype("f4")
    change(folder / "poses.npz", global_orient=degrees, body_pose=degrees)


@fault("K is of another picture size")
def _(folder):
    change(folder / "cameras.npz", K=lambda K: K * np.array([[2.0], [2.0], [1.0]]))


@fault("focal length or distance")
def _(folder):
    longer = np.array([[1.5, 1, 1], [1, 1.5, 1], [1, 1, 1]])
    change(folder / "cameras.npz", K=lambda K: K * longer)


@fault("masks beside the poses")
def _(folder):
    width = float(arrays(folder / "cameras.npz")["width"])
    aside = np.zeros((3, 3))
    aside[0, 2] = 0.17 * width
    change(folder / "cameras.npz", K=lambda K: K - aside)


@fault("inverted masks")
def _(folder):
    masks(folder, lambda m: 255 - m)


@fault("full masks")
def _(folder):
    masks(folder, lambda m: 255 * np.ones_like(m))


@fault("empty masks")
def _(folder):
    masks(folder, np.zeros_like)


@fault("masks of labels")
def _(folder):
    masks(folder, lambda m: (m > 127) * np.uint8(3))


@fault("mask size")
def _(folder):
    masks(folder, lambda m: m[::2, ::2])


@fault("missing masks")
def _(folder):
    shutil.rmtree(folder / "masks")


@fault("mirrored video")
def _(folder):
    all_pictures(folder, lambda x: x[:, ::-1])
    maps(folder, lambda n: n[:, ::-1] * (-1, 1, 1))


@fault("pictures upside down")
def _(folder):
    all_pictures(folder, lambda x: x[::-1, ::-1])


@fault("frame offset")
def _(folder):
    keys = ("global_orient", "body_pose", "transl")
    late = lambda x: np.concatenate([x[2:], x[-1:], x[-1:]])
    change(folder / "poses.npz", **dict.fromkeys(keys, late))


@fault("axes of the normals")
def _(folder):
    maps(folder, lambda n: n * (1, -1, -1))


@fault("few normals")
def _(folder):
    maps(folder, lambda n: 5 * n)


@fault("normals cannot be read")
def _(folder):
    maps(folder, lambda n: n[::2, ::2])


@fault("betas")
def _(folder):
    change(folder / "poses.npz", betas=lambda b: b + np.float32(30) * (np.arange(len(b)) == 0))


@fault("poses are not finite")
def _(folder):
    bad = lambda x: np.where(np.arange(len(x))[:, None] == 2, np.float32(np.nan), x)
    change(folder / "poses.npz", body_pose=bad)


@fault("counts")
def _(folder):
    keys = ("global_orient", "body_pose", "transl", "expression", "jaw_pose", "leye_pose")
    keys += ("reye_pose", "left_hand_pose", "right_hand_pose")
    change(folder / "poses.npz", **dict.fromkeys(keys, lambda x: x[:-1]))


@fault("splits overlap")
def _(folder):
    (folder / "splits.json").write_text(json.dumps({"train": [0, 1, 2], "test": [2, 3]}))


@fault("splits beyond the video")
def _(folder):
    (folder / "splits.json").write_text(json.dumps({"train": [0, 1], "test": [9999]}))


@fault("picture size")
def _(folder):
    pictures(folder, lambda x: x[::2, ::2])


@fault("unreadable")
def _(folder):
    (folder / "poses.npz").write_bytes(b"cut short")


@fault("views of other cameras")
def _(folder):
    shutil.copytree(folder / "masks", folder / "views/masks")
    shutil.copy(folder / "cameras.npz", folder / "views/cameras.npz")
    (folder / "views/views.json").write_text(json.dumps({"frames": [0, 1], "cameras": ["a", "b"]}))
