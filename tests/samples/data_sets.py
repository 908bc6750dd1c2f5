"""Data sets of a few frames: where their cameras stood, and folders in their form.

``thetas`` are SMPL's poses (T, 72) and ``pelvises`` (T, 3) the places, in a world that TURN and
MOVE take to the camera.
"""

import numpy as np

from gva_mi.body.rotations import to_matrices, to_rotvecs
from gva_mi.subject.pictures import write_image

matrices, vectors = to_matrices, to_rotvecs

WIDTH, HEIGHT, FRAMES = 64, 48, 5
SMPL, SMPLX = np.array([-0.0018, -0.2233, 0.0282]), np.array([0.0031, -0.3514, 0.0120])  # pelvises
K = np.array([[70.0, 0, 33], [0, 72, 23], [0, 0, 1]])
TURN, MOVE = np.array([0.1, -0.4, 0.05]), np.array([0.2, 0.1, 0.5])  # x_cam = R(TURN) x + MOVE
OTHER_K = np.array([[90.0, 0, 30], [0, 95, 27], [0, 0, 1]])  # of a second camera
OTHER_TURN, OTHER_MOVE = np.array([-0.2, 1.1, 0.3]), np.array([-0.4, 0.2, 1.0])
HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV's first pixel is centred at 0
BUILT_IN_BODY = ("--body", "built-in")
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
