"""Ways to break a subject's folder, by the problem that has to name each: ``FAULTS[what](folder)``.

They work on any subject, including synthetic ones in clothes with noisy poses.
"""

import json
import shutil

import numpy as np

from gva_mi.data.film import Film
from gva_mi.data.pictures import read_image, write_image
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
    """Normals as floating point; zero if unknown."""

    def write(folder):
        for path in sorted((folder / "normals").glob("*")):
            if path.suffix == ".npy":
                stored = np.load(path)
            else:
                stored = read_image(path, 3) / np.float32(127.5) - 1
                stored[np.linalg.norm(stored, axis=-1) > 1.5] = 0
                path.unlink()
            np.save(path.with_suffix(".npy"), np.ascontiguousarray(new(stored), np.float32))

    return write


def pictures(new):
    def write(folder):
        if (folder / "video.mp4").exists():
            for k, image in enumerate(Film(folder / "video.mp4")):
                write_image(folder / f"frames/{k:06d}.png", image)
            (folder / "video.mp4").unlink()
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
FAULTS = {
    "T_camera_world is inverted": cameras(T_camera_world=np.linalg.inv),
    "cameras in OpenGL's axes": extrinsics([1, -1, -1, 1]),
    "poses in a world with y down": cameras(T_camera_world=lambda T: T @ np.diag([1, -1, -1, 1])),
    "poses in a world with z up": cameras(T_camera_world=lambda T: T @ Z_UP),
    "cameras in millimetres": cameras(T_camera_world=lambda T: T * FAR),
    "poses in millimetres": poses_in_millimetres,
    "poses in degrees": poses(global_orient=degrees, body_pose=degrees),
    "K is of another picture size": cameras(K=lambda K: K * np.array([[2.0], [2.0], [1.0]])),
    "focal length or distance": longer(1.5),
    "masks beside the poses": aside,
    "inverted masks": masks(lambda m: 255 - m),
    "full masks": masks(lambda m: 255 * np.ones_like(m)),
    "empty masks": masks(lambda m: 0 * m),
    "mask size": masks(lambda m: m[::2, ::2]),
    "missing masks": lambda folder: shutil.rmtree(folder / "masks"),
    "mirrored video": both(
        pictures(lambda x: x[:, ::-1]), masks(lambda x: x[:, ::-1]),
        maps(lambda n: n[:, ::-1] * (-1, 1, 1))),
    "pictures upside down": both(
        pictures(lambda x: x[::-1, ::-1]), masks(lambda x: x[::-1, ::-1])),
    "axes of the normals": maps(lambda n: n * (1, -1, -1)),
    "normals cannot be read": maps(lambda n: n[::2, ::2]),
    "betas": poses(betas=lambda b: b + np.float32(30) * (np.arange(len(b)) == 0)),
    "counts": each_pose(lambda x: x[:-1]),
    "splits": text("splits.json", json.dumps({"train": [0, 1, 2], "test": [2, 3]})),
    "picture size": pictures(lambda x: x[::2, ::2]),
    "unreadable": both(text("poses.npz", "cut short"), extrinsics([-1, 1, 1, 1])),
    "views of other cameras": views,
}  # fmt: skip
