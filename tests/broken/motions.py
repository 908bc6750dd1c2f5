"""Ways to break a motion's file by hand: ``MOTIONS[name](folder)`` writes it and returns it."""

import pickle

import numpy as np

T = 4
POSES = np.full((T, 72), 0.1)
PLACES = np.tile([0.0, 0.9, 0.0], (T, 1))
IDENTITY = np.tile(np.eye(3), (T, 24, 1, 1))


def wham():  # of its two motions, the one in the world
    return {"pose_world": POSES, "trans_world": PLACES, "betas": np.zeros((T, 10)),
            "frame_ids": np.arange(T)}  # fmt: skip


def phalp():
    smpl = {"global_orient": IDENTITY[0, :1], "body_pose": IDENTITY[0, 1:], "betas": np.zeros(10)}
    return {"tid": [2], "tracked_ids": [2], "smpl": [smpl], "time": 0, "camera": [PLACES[0] + 4],
            "size": [[480, 640]]}  # fmt: skip


def pymafx():
    hand = IDENTITY[:, :15]
    batch = {"shape": np.zeros((T, 10)), "body_pose": IDENTITY, "left_hand_pose": hand,
             "right_hand_pose": hand, "jaw_pose": IDENTITY[:, :1], "leye_pose": IDENTITY[:, :1],
             "reye_pose": IDENTITY[:, :1]}  # fmt: skip
    return {"orig_cam": np.ones((T, 4)), "orig_cam_t": PLACES + [0, 0, 20],
            "frame_ids": np.arange(T), "smplx_params": [batch]}  # fmt: skip


FORMS = {  # how a form's whole file is written, given the arrays by name in which it may be broken
    "amass": (lambda x: x, {
        "poses": np.full((T, 165), 0.1), "trans": PLACES, "mocap_framerate": 25.0,
        "betas": np.zeros(16),
    }),
    "aist": (lambda x: x, {
        "smpl_poses": POSES, "smpl_trans": PLACES, "smpl_scaling": np.array([90.0]), "fps": 60,
    }),
    "parts": (lambda x: x, {
        "root_orient": POSES[:, :3], "pose_body": POSES[:, :63], "pose_hand": np.zeros((T, 90)),
        "trans": PLACES, "fps": 25,
    }),
    "names": (lambda x: x, {
        "global_orient": POSES[:, :3], "body_pose": POSES[:, :63],
        "left_hand_pose": np.zeros((T, 45)), "transl": PLACES, "betas": np.zeros((T, 10)),
        "fps": 25,
    }),
    "gvhmr": (lambda x: {"smpl_params_global": x}, {
        "global_orient": POSES[:, :3], "body_pose": POSES[:, :63], "transl": PLACES,
        "betas": np.zeros((T, 10)),
    }),
    "wham": (lambda x: {0: x}, wham()),
    "phalp": (lambda x: {"0.jpg": x}, phalp()),
    "pymafx": (lambda x: x, pymafx()),
}  # fmt: skip
WAYS = {
    "missing": None,
    "text": lambda x: "x",
    "a table of text": lambda x: np.array([["a", "b"]]),
    "a number": lambda x: 3.5,
    "empty": lambda x: np.zeros((0, 3)),
    "NaN": lambda x: np.full(np.shape(x), np.nan) if np.asarray(x).dtype.kind in "fi" else np.nan,
    "one row less": lambda x: x[:-1] if np.ndim(x) else -1,
    "too wide": lambda x: np.ones((*np.shape(x)[:-1], 7)) if np.ndim(x) else np.ones(7),
}


def broken(form, field, way):
    def write(folder):
        whole, arrays = FORMS[form]
        change = WAYS[way]
        found = {k: v for k, v in arrays.items() if k != field}
        if change is not None:
            found[field] = change(arrays[field])
        path = folder / "motion.pkl"
        path.write_bytes(pickle.dumps(whole(found)))
        return path

    return write


MOTIONS = {
    f"{form}: {field} is {way}": broken(form, field, way)
    for form, (_, arrays) in FORMS.items()
    for field in arrays
    for way in WAYS
}
NO_MATTER = {  # what a motion may lack: places stay, hands relax, frames follow each other
    "amass": ("trans", "betas"), "aist": ("smpl_trans", "smpl_scaling", "fps"),
    "parts": ("trans", "pose_hand"), "names": ("transl", "betas", "left_hand_pose"),
    "gvhmr": ("transl", "betas"), "wham": ("trans_world", "betas", "frame_ids"),
    "phalp": ("time", "tracked_ids"),
}  # fmt: skip
TAKEN = {f"{form}: {field} is missing" for form, x in NO_MATTER.items() for field in x} | {
    f"{form}: {field} is {way}"  # numbers as good as those that were there
    for form, field, ways in (
        ("amass", "mocap_framerate", ("a number", "too wide")), ("aist", "fps", ("a number",)),
        ("aist", "fps", ("too wide",)), ("aist", "smpl_scaling", ("a number",)),
        ("parts", "fps", ("a number", "too wide")), ("names", "fps", ("a number", "too wide")),
        ("amass", "betas", ("a number", "one row less", "too wide")),
        ("names", "betas", ("a number", "one row less", "too wide")),
        ("gvhmr", "betas", ("a number", "too wide")), ("wham", "betas", ("a number", "too wide")),
        ("phalp", "time", ("a number", "one row less")),
    )
    for way in ways
}  # fmt: skip
