"""Ways to break a subject or a run: dictionaries of ``change(folder)`` by name.

The name says field and kind of fault; there is one of each kind.
"""

import os
import shutil
import struct
import zlib

import numpy as np

NAN = float("nan")
FRAME, MASK = "frames/000002.png", "masks/000002.png"


def arrays(path):
    return dict(np.load(path))


def with_arrays(path, **changes):
    """Change arrays of an .npz: functions of them, other values, or None to remove them."""

    def change(folder):
        found = arrays(folder / path)
        for name, value in changes.items():
            other = value(found[name]) if callable(value) else value
            if other is None:
                del found[name]
            else:
                found[name] = np.asarray(other)
        np.savez(folder / path, **found)

    return change


def cameras(**changes):
    return with_arrays("cameras.npz", **changes)


def poses(**changes):
    return with_arrays("poses.npz", **changes)


def avatar(**changes):
    return with_arrays("avatar.npz", **changes)


def gone(path):
    def change(folder):
        whole = folder / path
        shutil.rmtree(whole) if whole.is_dir() else whole.unlink(missing_ok=True)

    return change


def text(path, content):
    def change(folder):
        gone(path)(folder)
        (folder / path).parent.mkdir(exist_ok=True, parents=True)
        (folder / path).write_bytes(content.encode() if isinstance(content, str) else content)

    return change


def a_folder(path):
    def change(folder):
        gone(path)(folder)
        (folder / path).mkdir(parents=True)

    return change


def cut(path):
    def change(folder):
        data = (folder / path).read_bytes()
        (folder / path).write_bytes(data[: len(data) // 2])

    return change


def copied(path, to):
    return lambda folder: shutil.copy(folder / path, folder / to)


def picture(path, size=(48, 48), mode="RGB", value=128):
    def change(folder):
        from PIL import Image

        (folder / path).parent.mkdir(exist_ok=True)
        Image.new(mode, size, value).save(folder / path)

    return change


def mask_as_npy(change):
    def write(folder):
        from PIL import Image

        mask = np.asarray(Image.open(folder / MASK)) / np.float32(255)
        (folder / MASK).unlink()
        np.save((folder / MASK).with_suffix(".npy"), change(mask))

    return write


def each_mask(change):
    def write(folder):
        from PIL import Image

        for path in (folder / "masks").glob("*.png"):
            Image.fromarray(change(np.asarray(Image.open(path)))).save(path)

    return write


def both(*ways):
    return lambda folder: [way(folder) for way in ways]


def claims(width, height):
    """A .png of one pixel whose head claims another size."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))


def loop(path):
    return lambda folder: (gone(path)(folder), os.symlink(folder / path, folder / path))


def at(index, value):
    def change(x):
        x = np.array(x, np.float64)
        x[index] = value
        return x

    return change


def frames(count):
    return lambda folder: np.savez(folder / "poses.npz", **{
        k: x[:count] if x.ndim > 1 else x for k, x in arrays(folder / "poses.npz").items()
    })  # fmt: skip


# What the commands accept: plausible numbers that are not the intended ones; `check` warns.
TAKEN = {
    "T is of 16 bits": cameras(T_camera_world=lambda T: T.astype(np.float16)),
    "camera is a kilometre away": cameras(T_camera_world=at((2, 3), 1000)),
    "transl is in millimetres": poses(transl=lambda x: 1000 * x + 700),
    "frame is missing": gone(FRAME),
    "mask is missing": gone(MASK),
    "masks are inverted": each_mask(lambda x: 255 - x),
}
SUBJECTS = TAKEN | {
    "width is an array": cameras(width=[48, 48]),
    "width is NaN": cameras(width=NAN),
    "width is another": cameras(width=47),
    "height is missing": cameras(height=None),
    "K is of another count": cameras(K=lambda K: np.repeat(K[None], 4, 0)),
    "K has a focal length of zero": cameras(K=at((0, 0), 0)),
    "K has a focal length of 1e-30": cameras(K=lambda K: at((1, 1), 1e-30)(at((0, 0), 1e-30)(K))),
    "T is mirrored": cameras(T_camera_world=lambda T: np.diag([-1.0, 1, 1, 1]) @ T),
    "cameras are cut": cut("cameras.npz"),
    "cameras are a link to themselves": loop("cameras.npz"),
    "transl is one number": poses(transl=1.0),
    "betas are of nobody": poses(betas=np.zeros((0, 10))),
    "betas are huge": poses(betas=np.full(10, 1e6)),
    "body_pose is of fewer frames": poses(body_pose=lambda x: x[:5]),
    "body_pose has a NaN": poses(body_pose=at((2, 5), NAN)),
    "body_pose is of objects": poses(body_pose=np.array([{}] * 6, object)),
    "poses are of no frame": frames(0),
    "poses are missing": gone("poses.npz"),
    "poses_refined.npz is cut": both(
        copied("poses.npz", "poses_refined.npz"), cut("poses_refined.npz")),
    "splits are no text": text("splits.json", b"\xff\xfe\x00"),
    "splits name a frame that is not there": text("splits.json", '{"train": [99], "test": []}'),
    "splits are of words": text("splits.json", '{"train": "all", "test": []}'),
    "no train frame is left": lambda folder: [
        gone(f"masks/{k:06d}.png")(folder) for k in (0, 1, 2, 4, 5)],
    "frame is cut": cut(FRAME),
    "frame is of another size": picture(FRAME, (50, 48)),
    "frame claims 100,000 pixels a side": text(FRAME, claims(100_000, 100_000)),
    "video is text": both(gone("frames"), text("video.mp4", "x")),
    "mask is of another size": picture(MASK, (47, 48), "L"),
    "mask is a .npy of NaN": mask_as_npy(lambda x: x * NAN),
    "masks are missing": gone("masks"),
    "normals are cut": both(picture("normals/000000.png"), cut("normals/000000.png")),
    "normals.json is of no convention": both(
        picture("normals/000000.png"), text("normals.json", '{"convention": "mine"}')),
    "prepare.json is cut": text("prepare.json", "["),
}  # fmt: skip


def not_a_number(x):
    return at((0,) * np.ndim(x), NAN)(x).astype(np.float32)


RUNS = {  # what of a run is broken, by the part that the commands of COMMANDS read
    "avatar": {
        "avatar is missing": gone("avatar.npz"),
        "avatar is cut": cut("avatar.npz"),
        "rest_faces are beyond the vertices": avatar(rest_faces=lambda x: x + 10**6),
        "canonical.means is NaN": avatar(**{"canonical.means": not_a_number}),
        "rest_joints is shorter": avatar(rest_joints=lambda x: x[:-1]),
        "light is missing": avatar(light=None),
        "rest_weights is text": avatar(rest_weights=lambda x: x.astype(str)),
        "an array is unknown": avatar(more=np.zeros(3)),
        "log_scales are huge": avatar(**{"canonical.log_scales": lambda x: 0 * x + 50}),
        "description is []": avatar(description="[]"),
        "description is nested": avatar(description="[" * 9999),
    },
    "poses": {
        "poses are cut": cut("poses.npz"),
        "poses have a NaN": poses(body_pose=not_a_number),
    },
    "records": {
        "options.json is cut": cut("options.json"),
        "options.json is null": text("options.json", "null"),
        "metrics.json is a list": text("metrics.json", "[]"),
    },
    "state": {
        "history is of text": with_arrays("history.npz", loss=np.array(["a"])),
        "checkpoint is cut": cut("checkpoint.pt"),
        "checkpoint is a folder": a_folder("checkpoint.pt"),
        "snapshot is text": text("reinit/000002.npz", "x"),
    },
}  # fmt: skip
