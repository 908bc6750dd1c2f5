"""Data sets of a few frames: where their cameras stood, and folders in their form.

``thetas`` are SMPL's poses (T, 72) and ``pelvises`` (T, 3) the places, in a world that TURN and
MOVE take to the camera.
"""

import json

import numpy as np

from gva_mi.body.rotations import to_matrices, to_rotvecs
from gva_mi.data.pictures import write_image

matrices, vectors = to_matrices, to_rotvecs

WIDTH, HEIGHT, FRAMES = 64, 48, 5
SMPL, SMPLX = np.array([-0.0018, -0.2233, 0.0282]), np.array([0.0031, -0.3514, 0.0120])  # pelvises
K = np.array([[70.0, 0, 33], [0, 72, 23], [0, 0, 1]])
TURN, MOVE = np.array([0.1, -0.4, 0.05]), np.array([0.2, 0.1, 0.5])  # x_cam = R(TURN) x + MOVE
OTHER_K = np.array([[90.0, 0, 30], [0, 95, 27], [0, 0, 1]])  # of a second camera
OTHER_TURN, OTHER_MOVE = np.array([-0.2, 1.1, 0.3]), np.array([-0.4, 0.2, 1.0])
HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV's first pixel is centred at 0
BUILT_IN_BODY = ("--body", "puppet")
MASK = np.zeros((HEIGHT, WIDTH), np.uint8)
MASK[10:40, 20:40] = 255


def shots():
    random = np.random.default_rng(0)
    return [random.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(FRAMES)]


def about_origin(thetas, pelvises, pelvis=SMPL):
    """EasyMocap's Rh and Th: the body turns about the origin and not about its pelvis."""
    return thetas[:, :3], pelvises - np.einsum("nij,j->ni", matrices(thetas[:, :3]), pelvis)


def zju(folder, thetas, pelvises, *, stem="{:06d}", first=0, cameras=(1,), D=0, images=None):
    """ZJU-MoCap: camera B1 stands at TURN and MOVE, B2 elsewhere; masks are parts by number."""
    Rh, Th = about_origin(thetas, pelvises)
    (folder / "params").mkdir(parents=True)
    ims = []
    for k, shot in enumerate(images or shots()):
        name = stem.format(k + first)
        ims.append({"ims": [f"Camera_B{c}/{name}.png" for c in cameras]})
        for c in cameras:
            write_image(folder / f"Camera_B{c}/{name}.png", shot // c)
            mask = np.roll(MASK // 255 * 13, 8 * (c == 2 and k > 0), 1)
            write_image(folder / f"mask/Camera_B{c}/{name}.png", mask)
        params = {"poses": np.concatenate([np.zeros(3), thetas[k, 3:]])[None], "Rh": Rh[k : k + 1],
                  "Th": Th[k : k + 1], "shapes": np.zeros((1, 10))}  # fmt: skip
        np.save(folder / f"params/{k + first}.npy", params)
    of = {1: (K, TURN, MOVE), 2: (OTHER_K, OTHER_TURN, OTHER_MOVE)}
    cams = {
        "K": [of[c][0] - HALF for c in cameras], "D": [np.zeros((5, 1)) + D] * len(cameras),
        "R": [matrices(of[c][1]) @ (np.eye(3) + 1e-4) for c in cameras],  # digits were lost
        "T": [1000 * of[c][2][:, None] for c in cameras],
    }  # fmt: skip
    np.save(folder / "annots.npy", {"cams": cams, "ims": ims})
    return folder


def yaml(path, **matrices_):
    text = '%YAML:1.0\r\n---\r\nnames:\r\n  - "2"\r\n  - "1"\r\n'
    for name, x in matrices_.items():
        x = np.atleast_2d(x)
        text += f"{name}: !!opencv-matrix\r\n  rows: {x.shape[0]}\r\n  cols: {x.shape[1]}\r\n"
        text += f"  dt: d\r\n  data: [{', '.join(f'{v:.9f}' for v in x.ravel())}]\r\n"
    path.write_text(text)


def easymocap(folder, people, *, under="smpl", wrap=lambda person: [person], cameras=(1,)):
    """EasyMocap: equal cameras, and a file of one person a frame; ``people``: Rh, Th and poses."""
    for k, (shot, (Rh, Th, poses)) in enumerate(
        zip(shots(), zip(*people, strict=True), strict=True)
    ):
        for c in cameras:
            write_image(folder / f"images/{c}/{k:06d}.jpg", shot)
            write_image(folder / f"mask/{c}/{k:06d}.png", MASK)
        person = {"id": 4, "Rh": [Rh.tolist()], "Th": [Th.tolist()], "shapes": [[0.0] * 10],
                  "poses": [poses.tolist()]}  # fmt: skip
        (folder / under).mkdir(parents=True, exist_ok=True)
        (folder / under / f"{k:06d}.json").write_text(json.dumps(wrap(person)))
    inner, outer = {"K": K - HALF, "dist": np.zeros(5)}, {"Rot": matrices(TURN), "T": MOVE[:, None]}
    for name, found in (("intri", inner), ("extri", outer)):
        of_all = {f"{key}_{c}": x for c in cameras for key, x in found.items()}
        yaml(folder / f"{name}.yml", **of_all)
    return folder


def avatarrex(folder, rotations, roots, pelvises, *, cameras=("22010708",), lost=()):
    """AvatarReX: equal cameras; ``rotations`` (T, 55, 3) with ``roots`` (T, 3) in the world."""
    for c in cameras:
        for k, shot in enumerate(shots()):
            if k not in lost:
                write_image(folder / f"{c}/{k:08d}.jpg", shot)
                write_image(folder / f"{c}/mask/pha/{k:08d}.jpg", MASK)
    camera = {"K": (K - HALF).ravel().tolist(), "T": MOVE.tolist(),
              "R": matrices(TURN).ravel().tolist(), "imgSize": [64, 48]}  # fmt: skip
    (folder / "calibration_full.json").write_text(json.dumps(dict.fromkeys(cameras, camera)))
    flat = lambda part: rotations[:, part].reshape(FRAMES, -1)
    np.savez(
        folder / "smpl_params.npz", betas=np.zeros((1, 10)), global_orient=roots,
        transl=pelvises - SMPLX, body_pose=flat(slice(1, 22)), jaw_pose=flat(slice(22, 23)),
        left_hand_pose=flat(slice(25, 40)), right_hand_pose=flat(slice(40, 55)),
        expression=np.zeros((FRAMES, 10)),
    )  # fmt: skip
    return folder
