"""Ways to break a subject's folder, and the problems that ``gva-mi check`` has to name then."""

import json
import shutil

import numpy as np

from gva_mi.subject.pictures import read_image, write_image
from samples.broken_cases import both, cameras, poses, text


def each_pose(change_rows):
    names = ("global_orient", "body_pose", "transl", "expression", "jaw_pose", "leye_pose",
             "reye_pose", "left_hand_pose", "right_hand_pose")  # fmt: skip
    return poses(**dict.fromkeys(names, change_rows))


def extrinsics(matrix):
    return cameras(T_camera_world=lambda T: np.diag(matrix) @ T)


def longer(factor):
    return cameras(K=lambda K: K * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]]))


def masks(new):
    def write(folder):
        for path in sorted((folder / "masks").glob("*.png")):
            write_image(path, np.ascontiguousarray(new(read_image(path, 1))))

    return write


def maps(new):
    def write(folder):
        for path in sorted((folder / "normals").glob("*.npy")):
            np.save(path, np.ascontiguousarray(new(np.load(path)), np.float32))

    return write


def pictures(new):
    def write(folder):
        for path in sorted((folder / "frames").glob("*.png")):
            write_image(path, np.ascontiguousarray(new(read_image(path, 3))))

    return write


def poses_in_millimetres(folder):
    away = np.array([0.3, 0.2, 0.1], "f4")  # the person is not at the origin, so that units count
    with np.load(folder / "cameras.npz") as file:
        R = file["T_camera_world"][..., :3, :3]

    def moved(T):  # the camera goes with the person
        T = T.copy()
        T[..., :3, 3] -= R @ away
        return T

    cameras(T_camera_world=moved)(folder)
    poses(transl=lambda t: (t + away) * np.float32(1000))(folder)


def aside(folder):
    with np.load(folder / "cameras.npz") as file:
        moved = np.zeros((3, 3))
        moved[0, 2] = 0.17 * float(file["width"])
    cameras(K=lambda K: K - moved)(folder)


def views(folder):
    shutil.copytree(folder / "masks", folder / "views/masks")
    shutil.copy(folder / "cameras.npz", folder / "views/cameras.npz")
    (folder / "views/views.json").write_text(json.dumps({"frames": [0, 1], "cameras": ["a", "b"]}))


Z_UP = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
FAR = np.array([[1, 1, 1, 1000]] * 3 + [[1, 1, 1, 1]])
degrees = lambda x: np.degrees(x).astype("f4")
OUTSIDE, SIZE, CENTRE = "poses outside the masks", "focal length or distance", "principal point"
FAULTS = {  # name: the problems that name it, and how the folder is broken
    "T_camera_world is inverted": ({OUTSIDE}, cameras(T_camera_world=np.linalg.inv)),
    "cameras in OpenGL's axes": ({OUTSIDE}, extrinsics([1, -1, -1, 1])),
    "poses in a world with z up": (
        {OUTSIDE, SIZE}, cameras(T_camera_world=lambda T: T @ Z_UP)),
    "cameras in millimetres": ({OUTSIDE, SIZE}, cameras(T_camera_world=lambda T: T * FAR)),
    "poses in millimetres": ({OUTSIDE}, poses_in_millimetres),
    "poses in degrees": (
        {"rotations", "silhouettes beside the masks"},
        poses(global_orient=degrees, body_pose=degrees)),
    "K with a skew": ({"cameras"}, cameras(K=lambda K: K + [[0, 5.0, 0], [0, 0, 0], [0, 0, 0]])),
    "K is of another picture size": (
        {OUTSIDE, SIZE, CENTRE}, cameras(K=lambda K: K * np.array([[2.0], [2.0], [1.0]]))),
    "focal length 1.5 times too long": ({OUTSIDE, SIZE}, longer(1.5)),
    "pictures of a crop": ({OUTSIDE, CENTRE}, aside),
    "inverted masks": ({"inverted masks"}, masks(lambda m: 255 - m)),
    "full masks": ({"full masks"}, masks(lambda m: 255 * np.ones_like(m))),
    "empty masks": ({"frames", "frames left out"}, masks(lambda m: 0 * m)),
    "masks of another size": (
        {"masks", "frames", "frames left out"}, masks(lambda m: m[::2, ::2])),
    "no masks": ({"frames", "frames left out"}, lambda folder: shutil.rmtree(folder / "masks")),
    "mirrored video": (
        {OUTSIDE}, both(pictures(lambda x: x[:, ::-1]), masks(lambda x: x[:, ::-1]))),
    "normals of another size": ({"normals"}, maps(lambda n: n[::2, ::2])),
    "betas": ({"betas"}, poses(betas=lambda b: b + np.float32(30) * (np.arange(len(b)) == 0))),
    "poses of fewer frames": ({"poses"}, each_pose(lambda x: x[:-1])),
    "splits": ({"splits"}, text("splits.json", json.dumps({"train": [0, 1, 2], "test": [2, 3]}))),
    "pictures of another size": ({"pictures"}, pictures(lambda x: x[::2, ::2])),
    "two files cut short": (
        {"poses", "cameras"}, both(text("poses.npz", "cut short"), text("cameras.npz", "x"))),
    "views of other cameras": ({"views of other cameras"}, views),
}  # fmt: skip
