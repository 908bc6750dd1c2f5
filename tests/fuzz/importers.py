"""Good files of estimators, data sets and networks, one of each form of file, as in seeds.py.

Folders of several cameras hold out views, so that the files of all of their cameras are read.
"""

import json
import pickle
import runpy
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from gva_mi.data.importers.estimators import VideoInfo, read_estimator
from gva_mi.data.importers.prepare import prepare_folder
from gva_mi.data.importers.prepare_options import PrepareOptions
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.networks.normals import NormalNetwork, NormalsSpec
from gva_mi.data.pictures import write_image

W, H, T = 32, 24, 3
K = np.array([[40.0, 0, W / 2], [0, 40, H / 2], [0, 0, 1]])
THETAS, ROOT, PLACE = np.full((T, 72), 0.1), np.full((T, 3), 0.1), np.tile([0.0, 0, 4], (T, 1))
SMPLX = {"global_orient": 3, "body_pose": 63, "transl": 3, "jaw_pose": 3, "expression": 10,
         "left_hand_pose": 45, "right_hand_pose": 45, "betas": 10}  # fmt: skip
CAMERAS = ("1", "2")
DATA = Path(__file__).parents[1] / "data"


def importers():
    """All of them by name."""
    built_in = TargetBody.read(None)

    def estimated(where):
        return lambda folder, _=None: read_estimator(
            "auto", folder / where, VideoInfo((W, H), 40.0)
        )

    def prepared(kind):
        def read(folder, _=None):
            options = PrepareOptions(Path("puppet"), views=("all",))
            with TemporaryDirectory() as out:
                prepare_folder(Path(out), kind, folder, options, built_in)

        return read

    return {
        "wham": (wham, estimated("a.pkl")), "gvhmr": (gvhmr, estimated("a.pt")),
        "romp": (romp, estimated(".")), "smplerx": (smplerx, estimated(".")),
        "tram": (tram, estimated(".")), "osx": (osx, estimated(".")),
        "zju": (zju, prepared("zju")), "easymocap": (easymocap, prepared("easymocap")),
        "avatarrex": (avatarrex, prepared("avatarrex")), "onnx": (onnx, read_onnx),
    }  # fmt: skip


def arrays(frames):
    """SMPL-X's arrays by name."""
    return {name: np.full((frames, size), 0.1) for name, size in SMPLX.items()}


def wham(folder):
    """A pickle of all people."""
    person = {"pose": THETAS, "trans": PLACE, "betas": np.zeros((T, 10)), "frame_ids": np.arange(T)}
    world = {"pose_world": THETAS, "trans_world": PLACE, "verts": np.zeros((T, 9, 3))}
    (folder / "a.pkl").write_bytes(pickle.dumps({0: person | world}))


def gvhmr(folder):
    """A file of tensors."""
    tensor = lambda x: torch.as_tensor(np.array(x), dtype=torch.float32)
    names = ("global_orient", "body_pose", "transl", "betas")
    person = {name: tensor(arrays(T)[name]) for name in names}
    lens = {"K_fullimg": tensor(np.tile(K, (T, 1, 1)))}
    found = {"smpl_params_global": person, "smpl_params_incam": person} | lens
    torch.save(found, folder / "a.pt")


def romp(folder):
    """An .npz that holds a dictionary."""
    person = {"smpl_thetas": THETAS[:1], "smpl_betas": np.zeros((1, 10)), "cam": np.ones((1, 3)),
              "cam_trans": PLACE[:1], "center_confs": np.ones(1)}  # fmt: skip
    np.savez(folder / "00000000.npz", results=np.array(person, object))


def smplerx(folder):
    """An .npz and a .json for each frame."""
    (folder / "smplx").mkdir()
    (folder / "meta").mkdir()
    for k in range(T):
        np.savez(folder / f"smplx/{k + 1:05}_0.npz", **arrays(1))
        meta = {"focal": [40.0, 40.0], "princpt": [16, 12], "bbox": [0, 0, 9, 9]}
        (folder / f"meta/{k + 1:05}_0.json").write_text(json.dumps(meta))


def tram(folder):
    """A file a person, and a lens."""
    (folder / "hps").mkdir()
    person = {"pred_rotmat": np.tile(np.eye(3), (T, 24, 1, 1)), "pred_shape": np.zeros((T, 10)),
              "pred_trans": PLACE[:, None], "frame": np.arange(T)}  # fmt: skip
    np.save(folder / "hps/hps_track_0.npy", person)
    np.save(folder / "camera.npy", {"img_focal": 40.0, "img_center": np.array([16.0, 12])})


def osx(folder):
    """A .json for each frame and person."""
    sizes = {"root_pose": 3, "body_pose": 63, "lhand_pose": 45, "rhand_pose": 45, "jaw_pose": 3,
             "shape": 10, "expr": 10}  # fmt: skip
    found = {name: [0.1] * size for name, size in sizes.items()} | {"trans": [0.0, 0.0, 4.0]}
    lens = {"focal": [40.0, 40.0], "princpt": [16.0, 12.0]}
    for k in range(T):
        about = {"smplx_param": found, "cam_param": lens}
        (folder / f"{k}_0.json").write_text(json.dumps(about))


def footage(frame, mask, inside=255):
    """Write pictures and masks; names are formatted with ``camera`` and ``k``."""
    image = np.random.default_rng(0).integers(0, 256, (H, W, 3), np.uint8)
    person = np.zeros((H, W), np.uint8)
    person[6:20, 10:22] = inside
    for camera in CAMERAS:
        for k in range(T):
            write_image(Path(str(frame).format(camera=camera, k=k)), image)
            write_image(Path(str(mask).format(camera=camera, k=k)), person)


def zju(folder):
    """Arrays of objects."""
    footage(folder / "Camera_B{camera}/{k:06d}.jpg",
            folder / "mask_cihp/Camera_B{camera}/{k:06d}.png", inside=13)  # fmt: skip
    (folder / "new_params").mkdir()
    params = {"poses": THETAS[:1], "Rh": ROOT[:1], "Th": PLACE[:1], "shapes": np.zeros((1, 10))}
    for k in range(T):
        np.save(folder / f"new_params/{k}.npy", params)
    names = [{"ims": [f"Camera_B{c}/{k:06d}.jpg" for c in CAMERAS]} for k in range(T)]
    lenses = {"K": [K] * 2, "D": [np.full((5, 1), 0.01)] * 2, "R": [np.eye(3)] * 2,
              "T": [np.zeros((3, 1)), np.full((3, 1), 100.0)]}  # fmt: skip
    np.save(folder / "annots.npy", {"cams": lenses, "ims": names})


def easymocap(folder):
    """OpenCV's .yml, and a .json for each frame."""
    footage(folder / "images/{camera}/{k:06d}.jpg", folder / "mask/{camera}/{k:06d}.png")
    person = {"id": 0, "Rh": ROOT[:1].tolist(), "Th": PLACE[:1].tolist(),
              "poses": THETAS[:1].tolist(), "shapes": [[0.0] * 10]}  # fmt: skip
    (folder / "smpl").mkdir()
    for k in range(T):
        (folder / f"smpl/{k:06d}.json").write_text(json.dumps([person]))
    inner = {f"{name}_{c}": x for c in CAMERAS for name, x in (("K", K), ("dist", np.zeros(5)))}
    outer = {f"{name}_{c}": x for c in CAMERAS for name, x in (("R", np.zeros(3)), ("T", ROOT[0]))}
    for name, found in (("intri.yml", inner), ("extri.yml", outer | {"Rot_1": np.eye(3)})):
        text = "".join(f"{key}: {opencv_matrix(np.atleast_2d(x))}" for key, x in found.items())
        (folder / name).write_text(f"%YAML:1.0\n{text}")


def opencv_matrix(x):
    numbers = ", ".join(map(str, x.ravel().tolist()))
    size = f"  rows: {x.shape[0]}\n  cols: {x.shape[1]}\n"
    return f"!!opencv-matrix\n{size}  dt: d\n  data: [{numbers}]\n"


def avatarrex(folder):
    """A .json of all cameras, and an .npz."""
    footage(folder / "{camera}/{k:08d}.jpg", folder / "{camera}/mask/pha/{k:08d}.jpg")
    camera = {"K": K.ravel().tolist(), "R": np.eye(3).ravel().tolist(), "T": [0, 0, 4],
              "distCoeff": [0.01] * 5, "imgSize": [W, H]}  # fmt: skip
    about = json.dumps(dict.fromkeys(CAMERAS, camera))
    (folder / "calibration_full.json").write_text(about)
    found = arrays(T) | {"transl": PLACE, "betas": np.zeros((1, 10))}
    np.savez(folder / "smpl_params.npz", **found)


def onnx(folder):
    """A network of normals."""
    runpy.run_path(str(DATA / "conftest.py"))["onnx_file"](folder / "a.onnx", (16, 16))


def read_onnx(folder, _=None):
    mask = np.zeros((24, 32), np.float32)
    mask[4:20, 8:24] = 1
    network = NormalNetwork(folder / "a.onnx", NormalsSpec("icon", (16, 16)))
    network.see(np.full((24, 32, 3), 99, np.uint8), mask, np.array([8.0, 4, 24, 20]))
