"""Files in exactly the form of each estimator, by whose readers and damage they are tested."""

import json
import pickle
from functools import partial

import numpy as np
import torch

from gva_mi.body.body_file import BUILT_IN_BODY
from samples.data_sets import FRAMES, HEIGHT, SMPL, SMPLX, WIDTH
from samples.rotations import matrices

CENTRED = lambda f: np.array([[f, 0, WIDTH / 2], [0, f, HEIGHT / 2], [0, 0, 1]])
LENSES = np.array([  # another one a frame, as of networks that look at a box
    [[300.0 + 10 * k, 0, 30 + k], [0, 310 + 10 * k, 25 - k], [0, 0, 1]] for k in range(FRAMES)
])  # fmt: skip


def tensor(x):
    return torch.as_tensor(x, dtype=torch.float32)


def of_smpl(rotations):
    """SMPL's 24 joints, (T, 24, 3)."""
    return np.concatenate([rotations[:, :22], np.ones((len(rotations), 2, 3))], axis=1)


def flat(rotations, part):
    return rotations[:, part].reshape(len(rotations), -1)


def dumped(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(value))
    return path


def written(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value))


def with_mean_hands(rotations):
    with np.load(BUILT_IN_BODY) as body:
        mean = np.concatenate([body["hands_meanl"], body["hands_meanr"]]).reshape(30, 3)
    rotations = rotations.copy()
    rotations[:, 25:] += mean
    rotations[:, 23:25] = 0  # no eyes
    return rotations


# Each writes a source, and returns it with what is reported, the lens, the pelvises of the person,
# and, where they differ from 22 of ``seen``, rotations, the number of joints, and options.


def wham(folder, rotations, transl):
    person = {"pose": of_smpl(rotations).reshape(-1, 72), "trans": transl,
        "betas": np.zeros((FRAMES, 10)), "verts": np.zeros((FRAMES, 9, 3), "f4"),
        "frame_ids": np.arange(FRAMES)}  # fmt: skip
    source = dumped(folder / "wham_output.pkl", {np.int64(0): person})
    return source, "wham, SMPL", CENTRED(np.hypot(WIDTH, HEIGHT)), SMPL + transl


def gvhmr(folder, rotations, transl):
    person = {"global_orient": tensor(rotations[:, 0]), "transl": tensor(transl),
              "body_pose": tensor(flat(rotations, slice(1, 22))),
              "betas": torch.linspace(0, 1, FRAMES)[:, None].repeat(1, 10)}  # fmt: skip
    K = tensor(CENTRED(70)).repeat(FRAMES, 1, 1)
    found = {"smpl_params_global": person, "smpl_params_incam": person, "K_fullimg": K}
    torch.save(found, folder / "hmr4d_results.pt")
    return folder / "hmr4d_results.pt", "gvhmr, SMPL-X", CENTRED(70), SMPLX + transl


def four_d_humans(folder, rotations, transl):
    R, found = matrices(rotations), {}
    for k in range(FRAMES):
        body = np.concatenate([R[k, 1:22], np.eye(3)[None].repeat(2, 0)])
        smpl = {"global_orient": R[k, :1], "body_pose": body, "betas": np.zeros(10, "f4")}
        found[f"img/{k:06d}.jpg"] = {
            "tid": [2, 9], "tracked_ids": [2], "smpl": [smpl, smpl], "time": k,
            "camera": [transl[k], transl[k]], "size": [[HEIGHT, WIDTH]] * 2, "mask": [],
        }  # fmt: skip
    source = dumped(folder / "PHALP.pkl", found)
    return source, "4dhumans, SMPL", CENTRED(5000 / 256 * WIDTH), SMPL + transl


def hybrik(folder, rotations, transl, joints=24):
    angles = of_smpl(rotations) if joints == 24 else rotations
    wide = np.array([20.0, 24, 28, 32, 36])
    res = {
        "pred_thetas": matrices(angles).reshape(FRAMES, 9 * joints).astype("f4"),
        "pred_betas": np.zeros((FRAMES, 10)), "pred_cam_root": transl, "transl": transl * 0,
        "bbox": np.stack([0 * wide + 3, 0 * wide, wide + 3, wide], axis=1),
        "height": np.full(FRAMES, 2 * HEIGHT), "width": np.full(FRAMES, 2 * WIDTH),
        "img_path": np.array([f"raw_images/walk-2_{k + 1:06d}.png" for k in range(FRAMES)]),
    }  # fmt: skip
    K = np.stack([CENTRED(1000 / 256 * w / 2) for w in wide])
    form, joints = ("SMPL", 22) if joints == 24 else ("SMPL-X", 55)
    source = dumped(folder / "res.pk", res)
    return source, f"hybrik, {form}, 5 frames", K, transl, rotations, joints


def romp(folder, rotations, transl, form):
    """ROMP's files a frame, its results of a video with tracks, or BEV's files."""
    thetas, results = of_smpl(rotations).reshape(FRAMES, 72), {}
    hips = np.array([0.0, -0.09, -0.01])
    for k in range(FRAMES):
        other = k % 2  # another person, before or behind in the list
        place = transl[k] + (SMPL + matrices(rotations[k, 0]) @ hips if form == "bev" else 0)
        pair = np.stack([place, place + [1.5, 0, 1]])
        pick = lambda x, other=other: x[::-1] if other else x
        results[f"{k:08d}"] = {
            "smpl_thetas": pick(np.stack([thetas[k], 0 * thetas[k]])).astype("f4"),
            "smpl_betas": np.zeros((2, 11 if form == "bev" else 10), "f4"),
            "cam_trans": pick(pair).astype("f4"),
        } | ({"track_ids": pick(np.array([3, 8]))} if form == "video" else {})  # fmt: skip
    (folder / "out").mkdir()
    for name, result in results.items() if form != "video" else ():
        name += "__2_0.1" if form == "bev" else ""
        np.savez(folder / f"out/{name}.npz", results=result)
    if form == "video":
        named = {f"{name}.png": result for name, result in results.items()}
        np.savez(folder / "out/video_results.npz", results=named, sequence_results={})
    K, person = CENTRED(443.4 / 512 * WIDTH), "3" if form == "video" else "0"
    return folder / "out", "romp, SMPL", K, SMPL + transl, rotations, 22, "--person", person


def smplerx(folder, rotations, transl):
    (folder / "run/smplx").mkdir(parents=True)
    for k in range(FRAMES):
        name, r = f"{k + 1:05}_0", rotations[k]
        np.savez(folder / f"run/smplx/{name}.npz", global_orient=r[:1], body_pose=r[1:22],
            left_hand_pose=r[25:40], right_hand_pose=r[40:], jaw_pose=r[22:23],
            leye_pose=np.zeros((1, 3)), reye_pose=np.zeros((1, 3)), betas=np.zeros((1, 10)),
            expression=np.zeros((1, 10)), transl=transl[k : k + 1])  # fmt: skip
        meta = {"focal": [80.0, 80.0], "princpt": [WIDTH / 2, HEIGHT / 2], "bbox": [0, 0, 9, 9]}
        written(folder / f"run/meta/{name}.json", meta)
    expected = SMPLX + transl, with_mean_hands(rotations), 55
    return folder / "run", "smplerx, SMPL-X", CENTRED(80), *expected


def without_hands(folder, K, roots, transl, betas=(0.0,) * 10):
    """A person of SMPLer-X whose root (n, 3) turns alone, before lenses (n, 3, 3)."""
    for k, (lens, root, place) in enumerate(zip(K, roots, transl, strict=True), 1):
        about = {"focal": lens[[0, 1], [0, 1]].tolist(), "princpt": lens[:2, 2].tolist()}
        written(folder / f"meta/{k:05d}_0.json", about)
        (folder / "smplx").mkdir(exist_ok=True)
        np.savez(folder / f"smplx/{k:05d}_0.npz", global_orient=root[None], transl=place[None],
                 body_pose=np.zeros((21, 3)), betas=np.array(betas)[None])  # fmt: skip
    return folder


def named(rotations, transl, **more):
    return {
        "global_orient": flat(rotations, slice(0, 1)), "body_pose": flat(rotations, slice(1, 22)),
        "transl": transl, "betas": np.zeros((1, 10)),
    } | more  # fmt: skip


def parameters(folder, rotations, transl):
    """smpl_params.npz of AnimatableGaussians has these names; the lens is given."""
    hands = {"left_hand_pose": flat(rotations, slice(25, 40)), "expression": np.zeros((FRAMES, 10)),
             "right_hand_pose": flat(rotations, slice(40, 55)),
             "jaw_pose": flat(rotations, slice(22, 23))}  # fmt: skip
    np.savez(folder / "p.npz", **named(rotations, transl, **hands))
    given = (rotations, 23, "--lens", 70)
    return folder / "p.npz", "parameters, SMPL-X", CENTRED(70), SMPLX + transl, *given


def parameters_a_frame(folder, rotations, transl):
    """AGORA's form: each (1, J, 3, 3)."""
    R = matrices(rotations)
    for k in range(FRAMES):
        frame = {"global_orient": R[k : k + 1, :1], "body_pose": R[k : k + 1, 1:22],
            "left_hand_pose": R[k : k + 1, 25:40], "right_hand_pose": R[k : k + 1, 40:],
            "transl": transl[k : k + 1], "betas": np.zeros((1, 10)), "gender": "neutral",
            "K": LENSES[k]}  # fmt: skip
        dumped(folder / f"agora/{k}.pkl", frame)
    rotations = rotations.copy()
    rotations[:, 22:25] = 0
    return folder / "agora", "parameters", LENSES, SMPLX + transl, rotations, 55


def parameters_of_smpl(folder, rotations, transl):
    """The root is repeated in the body's pose."""
    body = of_smpl(rotations).reshape(FRAMES, 72)
    np.savez(folder / "p.npz", **named(rotations, transl, body_pose=body, focal=np.array(70.0)))
    return folder / "p.npz", "parameters, SMPL, ", CENTRED(70), SMPL + transl


WRITTEN = {f.__name__: f for f in (
    wham, gvhmr, four_d_humans, hybrik, smplerx, parameters, parameters_a_frame, parameters_of_smpl,
)} | {f"romp {form}": partial(romp, form=form) for form in ("frames", "video", "bev")} | {
    "hybrik of SMPL-X": partial(hybrik, joints=55),
}  # fmt: skip
