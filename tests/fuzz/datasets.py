"""Good folders of data sets, as in seeds.py.

Folders of several cameras hold out views, so that the files of all of their cameras are read.
"""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gva_mi.data.importers.prepare import prepare_folder
from gva_mi.data.importers.prepare_options import PrepareOptions
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.pictures import write_image

W, H, T = 32, 24, 3
IMAGE = np.random.default_rng(0).integers(0, 256, (H, W, 3), np.uint8)
MASK = np.zeros((H, W), np.uint8)
MASK[6:20, 10:22] = 255
K = np.array([[40.0, 0, 16], [0, 40, 12], [0, 0, 1]])
THETAS, ROOT, PLACE = np.full((T, 72), 0.1), np.full((T, 3), 0.1), np.tile([0.0, 0, 4], (T, 1))
SMPLX = {"global_orient": 3, "body_pose": 63, "transl": 3, "jaw_pose": 3, "expression": 10,
         "left_hand_pose": 45, "right_hand_pose": 45}  # fmt: skip


def datasets():
    """All of them by name."""
    puppet = TargetBody.read(None)

    def prepared(kind, *views):
        def read(folder, _=None):
            with TemporaryDirectory() as out:
                prepare_folder(
                    Path(out), kind, folder, PrepareOptions(Path("puppet"), views=views), puppet
                )

        return read

    return {
        "instantavatar": (instantavatar, prepared("instantavatar")),
        "zju": (zju, prepared("zju", "all")),
        "easymocap": (easymocap, prepared("easymocap", "all")),
        "easymocap smplx": (easymocap_smplx, prepared("easymocap")),
        "avatarrex": (avatarrex, prepared("avatarrex", "all")),
        "exavatar": (exavatar, prepared("exavatar")),
    }


def instantavatar(folder):
    for k in range(T):
        write_image(folder / f"images/image_{k:04d}.png", IMAGE)
        write_image(folder / f"masks/mask_{k:04d}.png", MASK)
    np.savez(folder / "cameras.npz", intrinsic=K, extrinsic=np.eye(4), height=H, width=W)
    np.savez(folder / "poses.npz", transl=PLACE, thetas=THETAS, betas=np.zeros(10))


def zju(folder, cameras=(1, 2)):
    for k in range(T):
        for camera in cameras:
            write_image(folder / f"Camera_B{camera}/{k:06d}.jpg", IMAGE)
            write_image(folder / f"mask_cihp/Camera_B{camera}/{k:06d}.png", MASK // 255 * 13)
        params = {"poses": THETAS[:1], "Rh": ROOT[:1], "Th": PLACE[:1], "shapes": np.zeros((1, 10))}
        (folder / "new_params").mkdir(exist_ok=True)
        np.save(folder / f"new_params/{k}.npy", params)
    names = [{"ims": [f"Camera_B{c}/{k:06d}.jpg" for c in cameras]} for k in range(T)]
    n = len(cameras)
    lenses = {"K": [K] * n, "D": [np.full((5, 1), 0.01)] * n, "R": [np.eye(3)] * n,
              "T": [np.full((3, 1), 100.0 * c) for c in range(n)]}  # fmt: skip
    np.save(folder / "annots.npy", {"cams": lenses, "ims": names})


def zju_of_five(folder):
    zju(folder, range(1, 6))


def easymocap(folder, person=None, cameras=("1", "2"), where="smpl"):
    """Of SMPL, or of what a person's entry says."""
    plain = {"poses": THETAS[:1].tolist(), "shapes": [[0.0] * 10]}
    person = {"id": 0, "Rh": ROOT[:1].tolist(), "Th": PLACE[:1].tolist()} | (person or plain)
    (folder / where).mkdir(parents=True)
    for k in range(T):
        for camera in cameras:
            write_image(folder / f"images/{camera}/{k:06d}.jpg", IMAGE)
            write_image(folder / f"mask/{camera}/{k:06d}.png", MASK)
        (folder / where / f"{k:06d}.json").write_text(json.dumps([person]))
    inner = {f"{name}_{c}": x for c in cameras for name, x in (("K", K), ("dist", np.zeros(5)))}
    outer = {f"{name}_{c}": x for c in cameras for name, x in (("R", np.zeros(3)), ("T", ROOT[0]))}
    for name, found in (("intri.yml", inner), ("extri.yml", outer | {"Rot_1": np.eye(3)})):
        text = "".join(f"{key}: {opencv_matrix(np.atleast_2d(x))}" for key, x in found.items())
        (folder / name).write_text(f"%YAML:1.0\n{text}")


def easymocap_smplx(folder):
    """SMPL-X, joint by joint."""
    person = {"poses": [[0.1] * 165], "shapes": [[0.0] * 10], "expression": [[0.0] * 10]}
    easymocap(folder, person, ("1",), "output/smplx/smpl")


def opencv_matrix(x):
    numbers = ", ".join(map(str, x.ravel().tolist()))
    return (
        f"!!opencv-matrix\n  rows: {x.shape[0]}\n  cols: {x.shape[1]}\n  dt: d\n"
        f"  data: [{numbers}]\n"
    )


def avatarrex(folder):
    for camera in ("1", "2"):
        for k in range(T):
            write_image(folder / f"{camera}/{k:08d}.jpg", IMAGE)
            write_image(folder / f"{camera}/mask/pha/{k:08d}.jpg", MASK)
    camera = {"K": K.ravel().tolist(), "R": np.eye(3).ravel().tolist(), "T": [0, 0, 4],
              "distCoeff": [0.01] * 5, "imgSize": [W, H]}  # fmt: skip
    (folder / "calibration_full.json").write_text(json.dumps({"1": camera, "2": camera}))
    arrays = {name: np.full((T, size), 0.1) for name, size in SMPLX.items()}
    np.savez(folder / "smpl_params.npz", betas=np.zeros((1, 10)), **arrays)


def exavatar(folder):
    sizes = {"root_pose": 3, "body_pose": 63, "lhand_pose": 45, "rhand_pose": 45, "jaw_pose": 3,
             "expr": 10}  # fmt: skip
    params = {name: [0.1] * size for name, size in sizes.items()} | {"trans": [0.0, 0.0, 4.0]}
    camera = {"R": np.eye(3).tolist(), "t": [0.0] * 3, "focal": [40.0] * 2, "princpt": [16.0, 12.0]}
    poses = folder / "smplx_optimized/smplx_params_smoothed"
    poses.mkdir(parents=True)
    (folder / "cam_params").mkdir()
    for k in range(T):
        write_image(folder / f"frames/{k}.png", IMAGE)
        write_image(folder / f"masks/{k}.png", MASK)
        (poses / f"{k}.json").write_text(json.dumps(params))
        (folder / f"cam_params/{k}.json").write_text(json.dumps(camera))
    (folder / "smplx_optimized/shape_param.json").write_text(json.dumps([0.0] * 100))
    (folder / "frame_list_train.txt").write_text("0\n1\n")
    (folder / "frame_list_test.txt").write_text("2\n")
