"""Ways to break a run's folder by hand: ``RUNS[name](folder)`` changes it."""

import json
import shutil

import numpy as np

NAN = float("nan")


def arrays(path):
    with np.load(path) as file:
        return dict(file)


def with_arrays(path, **changes):
    """Change arrays of an .npz: functions of them, other values, or None for none."""

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


def text(path, content):
    def change(folder):
        whole = folder / path
        shutil.rmtree(whole) if whole.is_dir() else whole.unlink(missing_ok=True)
        whole.parent.mkdir(exist_ok=True)
        whole.write_bytes(content.encode() if isinstance(content, str) else content)

    return change


def a_folder(path):
    def change(folder):
        (folder / path).unlink(missing_ok=True)
        (folder / path).mkdir()

    return change


def cut(path):
    def change(folder):
        data = (folder / path).read_bytes()
        (folder / path).write_bytes(data[: len(data) // 2])

    return change


def nan(x):
    x = np.array(x, np.float32)
    x[(0,) * x.ndim] = NAN
    return x


AVATAR = {
    "no avatar": lambda folder: (folder / "avatar.npz").unlink(),
    "the avatar is cut": cut("avatar.npz"),
    "the avatar is text": text("avatar.npz", "x"),
    "the avatar is empty": text("avatar.npz", ""),
    "the avatar is a folder": a_folder("avatar.npz"),
    "the avatar is poses": lambda folder: shutil.copy(folder / "poses.npz", folder / "avatar.npz"),
} | {
    f"{name}, {how}": with_arrays("avatar.npz", **{name: change})
    for name in ("canonical.means", "canonical.quats", "canonical.weights", "rest_weights",
                 "rest_joints", "rest_vertices", "rest_expression_joints", "light")
    for how, change in (("NaN", nan), ("fewer", lambda x: x[:-1]), ("missing", None),
                        ("text", lambda x: x.astype(str)), ("flat", np.ravel))
    if (name, how) != ("light", "flat")
} | {
    "rest_weights negative": with_arrays("avatar.npz", rest_weights=lambda x: -x),
    "rest_weights that sum to two": with_arrays("avatar.npz", rest_weights=lambda x: 2 * x),
    "rest_faces beyond": with_arrays("avatar.npz", rest_faces=lambda x: x + 10**6),
    "rest_faces negative": with_arrays("avatar.npz", rest_faces=lambda x: -1 - x),
    "rest_faces of floats": with_arrays("avatar.npz", rest_faces=lambda x: x + 0.5),
    "no joint at all": with_arrays("avatar.npz", rest_joints=np.zeros((0, 3), np.float32)),
} | {
    f"the avatar describes itself as {said[:20]}": with_arrays("avatar.npz", description=said)
    for said in ("", "{", "[]", "null", "{}", '{"options": "many"}', "[" * 9999)
}  # fmt: skip
POSES = {
    "the run's poses are cut": cut("poses.npz"),
    "the run's poses are text": text("poses.npz", "x"),
    "the run's poses have a NaN": with_arrays("poses.npz", body_pose=nan),
    "the run's poses are of no frame": with_arrays("poses.npz", transl=np.zeros((0, 3))),
    "the run's poses lack a key": with_arrays("poses.npz", body_pose=None),
    "the run's poses are enormous": with_arrays("poses.npz", transl=lambda x: x + 1e30),
}
RECORDS = {
    f"{name} says {said[:20]}": text(name, said)
    for name in ("options.json", "metrics.json")
    for said in ("", "{", "[]", "null", "3", '{"options": 3}', '{"options": {}, "video": 3}',
                 '{"rows": "x"}', "[" * 100_000, "\ufeff{}", "NaN")
} | {
    "options.json is a folder": a_folder("options.json"),
    "options.json is cut": cut("options.json"),
    "options.json is no text": text("options.json", b"\xff\xfe\x00"),
    "options.json is of another video": lambda folder: (folder / "options.json").write_text(
        json.dumps({"options": {}, "video": {"frames": "0"}})),
}  # fmt: skip
STATE = {
    "the history is cut": cut("history.npz"),
    "the history is text": text("history.npz", "x"),
    "the history is of text": with_arrays("history.npz", loss=np.array(["a"])),
    "the checkpoint is cut": cut("checkpoint.pt"),
    "the checkpoint is text": text("checkpoint.pt", "x"),
    "the checkpoint is empty": text("checkpoint.pt", ""),
    "the checkpoint is a folder": a_folder("checkpoint.pt"),
    "the checkpoint is an avatar": lambda folder: shutil.copy(
        folder / "avatar.npz", folder / "checkpoint.pt"),
    "a snapshot is text": text("reinit/000002.npz", "x"),
    "a snapshot has no number": text("reinit/a.npz", "x"),
}  # fmt: skip
RUNS = AVATAR | POSES | RECORDS | STATE
