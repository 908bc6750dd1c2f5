"""Good files of pose estimators, as in seeds.py."""

import json
import pickle

import numpy as np
import torch

from gva_mi.data.importers.estimator_record import VideoInfo
from gva_mi.data.importers.estimators import read_estimator

W, H, T = 32, 24, 3
VIEW = VideoInfo((W, H), 40.0)


def estimators():
    """All of them by name."""
    pose, transl, betas = np.full((T, 72), 0.1), np.tile([0.0, 0, 4], (T, 1)), np.zeros((T, 10))
    R, frames = np.tile(np.eye(3), (T, 24, 1, 1)), np.arange(T)
    tensor = lambda x: torch.as_tensor(np.array(x), dtype=torch.float32)
    K = np.tile(np.array([[40.0, 0, W / 2], [0, 40, H / 2], [0, 0, 1]]), (T, 1, 1))
    incam = {"global_orient": tensor(pose[:, :3]), "body_pose": tensor(pose[:, :63]),
             "transl": tensor(transl), "betas": tensor(betas)}  # fmt: skip
    smpl = {"global_orient": R[0, :1], "body_pose": R[0, 1:], "betas": betas[0]}
    files = {
        "wham": ("a.pkl", {0: {
            "pose": pose, "trans": transl, "betas": betas, "frame_ids": frames,
            "pose_world": pose, "trans_world": transl, "verts": np.zeros((T, 9, 3)),
        }}),
        "gvhmr": ("a.pt", {
            "smpl_params_global": incam, "smpl_params_incam": incam, "K_fullimg": tensor(K),
        }),
        "4dhumans": ("a.pkl", {f"img/{k}.jpg": {
            "tid": [2], "tracked_ids": [2], "smpl": [smpl], "time": k, "camera": [transl[k]],
            "size": [[H, W]], "mask": [],
        } for k in range(T)}),
        "hybrik": ("a.pk", {
            "pred_thetas": R.reshape(T, -1), "pred_betas": betas, "pred_cam_root": transl,
            "transl": transl, "bbox": np.tile([0.0, 0, 20, 20], (T, 1)), "height": np.full(T, H),
            "width": np.full(T, W), "img_path": np.array([f"a_{k}.png" for k in range(T)]),
        }),
        "multihmr": ("out/frame_0.pkl", [{
            "scores": tensor(0.9), "loc": tensor([0, 0]), "transl": tensor([0, 0, 4]),
            "transl_pelvis": tensor([[0, 0, 4]]), "rotvec": tensor(np.zeros((53, 3))),
            "expression": tensor(np.zeros(10)), "shape": tensor(np.zeros(10)),
        }]),
        "pymafx": ("a.pkl", {
            "orig_cam_t": transl, "frame_ids": frames, "person_ids": ["p0"] * T, "smplx_params": [{
                "shape": tensor(betas), "body_pose": tensor(R[:, :24]),
                "left_hand_pose": tensor(R[:, :15]), "right_hand_pose": tensor(R[:, :15]),
                "jaw_pose": tensor(R[:, :1]), "leye_pose": tensor(R[:, :1]),
                "reye_pose": tensor(R[:, :1]), "expression": tensor(betas),
            }],
        }),
        "smplifyx": ("out/results/img_0/000.pkl", {
            "camera_rotation": np.eye(3)[None], "camera_translation": transl[:1],
            "betas": betas[:1], "global_orient": pose[:1, :3], "body_pose": pose[:1, :63],
            "left_hand_pose": pose[:1, :45], "right_hand_pose": pose[:1, :45],
            "jaw_pose": pose[:1, :3], "expression": betas[:1],
        }),
        "parameters": ("a.npz", {
            "global_orient": pose[:, :3], "body_pose": pose[:, :63], "transl": transl,
            "betas": betas, "left_hand_pose": pose[:, :45], "right_hand_pose": pose[:, :45],
        }),
        "romp": ("out/00000000.npz", {"results": np.array({
            "smpl_thetas": pose[:1], "smpl_betas": betas[:1], "cam": np.ones((1, 3)),
            "cam_trans": transl[:1], "center_confs": np.ones(1),
        }, object)}),
    }  # fmt: skip

    def writer(name, value):
        def write(folder):
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if name.endswith(".npz"):
                np.savez(path, **value)
            elif name.endswith(".pt"):
                torch.save(value, path)
            else:
                path.write_bytes(pickle.dumps(value))

        return write

    def reader(name):
        where = name.split("/")[0]
        return lambda folder, _=None: read_estimator("auto", folder / where, VIEW)

    made = {kind: (writer(*file), reader(file[0])) for kind, file in files.items()}
    of_folder = {"smplerx": smplerx, "tram": tram, "osx": osx, "smplestx": smplestx}
    return made | {kind: (write, reader(".")) for kind, write in of_folder.items()}


def smplerx(folder):
    """An .npz and a .json for each frame."""
    (folder / "smplx").mkdir()
    (folder / "meta").mkdir()
    sizes = {"global_orient": 3, "body_pose": 63, "left_hand_pose": 45, "right_hand_pose": 45,
             "jaw_pose": 3, "transl": 3, "betas": 10, "expression": 10}  # fmt: skip
    for k in range(T):
        arrays = {name: np.full((1, size), 0.1) for name, size in sizes.items()}
        np.savez(folder / f"smplx/{k + 1:05}_0.npz", **arrays)
        meta = {"focal": [40.0, 40.0], "princpt": [16, 12], "bbox": [0, 0, 9, 9]}
        (folder / f"meta/{k + 1:05}_0.json").write_text(json.dumps(meta))


def tram(folder):
    """A file a person, and a lens."""
    (folder / "hps").mkdir()
    person = {"pred_rotmat": np.tile(np.eye(3), (T, 24, 1, 1)), "pred_shape": np.zeros((T, 10)),
              "pred_trans": np.tile([0.0, 0, 4], (T, 1, 1)), "frame": np.arange(T)}  # fmt: skip
    np.save(folder / "hps/hps_track_0.npy", person)
    np.save(folder / "camera.npy", {"img_focal": 40.0, "img_center": np.array([16.0, 12])})


def osx(folder):
    """A .json for each frame and person."""
    for k in range(T):
        about = {"smplx_param": smplx_params(), "cam_param": LENS}
        (folder / f"{k}_0.json").write_text(json.dumps(about))


def smplestx(folder):
    """A fork's folder for each frame, with its camera beside."""
    for k in range(T):
        run = folder / f"output_frame{k}/person_0"
        run.mkdir(parents=True)
        (run / "smplx_params_person_0.json").write_text(json.dumps(smplx_params()))
        (run / "camera_metadata.json").write_text(json.dumps(LENS))


LENS = {"focal": [40.0, 40.0], "princpt": [16.0, 12.0]}


def smplx_params():
    """One frame, by OSX's names."""
    sizes = {"root_pose": 3, "body_pose": 63, "lhand_pose": 45, "rhand_pose": 45, "jaw_pose": 3,
             "shape": 10, "expr": 10}  # fmt: skip
    return {name: [0.1] * size for name, size in sizes.items()} | {"trans": [0.0, 0.0, 4.0]}
