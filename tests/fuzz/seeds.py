"""Good files of every kind that is read: pairs of what writes some into an empty folder, and what
reads them again, when one of them has been damaged."""

import json
import pickle
import shutil

import numpy as np
import torch

from gva_mi.avatar.formats.without_body import save_without_body
from gva_mi.body.puppet import PUPPET
from gva_mi.body.smplx import load_body
from gva_mi.check import check_subject
from gva_mi.data.fingerprint import fingerprint, require_same_body
from gva_mi.data.importers.datasets import read_dataset
from gva_mi.data.importers.estimators import read_estimator
from gva_mi.data.importers.footage import masks, pictures
from gva_mi.data.importers.hdf5 import read_hdf5
from gva_mi.data.importers.motions import MotionOptions, read_motion
from gva_mi.data.importers.readings import View
from gva_mi.data.importers.recordings import Wanted, read_ranges
from gva_mi.data.pictures import read_background, write_image, write_movie
from gva_mi.data.synthetic import SynthOptions, describe_noise
from gva_mi.data.synthetic.recorded import made_of
from gva_mi.data.truth import load_truth
from gva_mi.data.video import load_video
from gva_mi.fit import run_folder
from gva_mi.fit.evaluation.metrics import load_metrics
from gva_mi.pose.evaluation.cases import HELD_OUT
from gva_mi.pose.evaluation.figures import PoseFigures
from gva_mi.pose.evaluation.study import CaseResult, StudyOptions
from gva_mi.pose.evaluation.study_file import load_study, save_study
from gva_mi.splat.formats.ply import load_ply, save_ply
from gva_mi.splat.formats.splat import load_splat, save_splat
from gva_mi.splat.scene import Scene, random_scene

W, H, T = 32, 24, 3
VIEW = View((W, H), 40.0)


def seeds(subject, avatar):
    """All readers by name; ``subject`` is the folder of a tiny one, ``avatar`` its avatar."""
    body = load_body()
    small = body_of_few_vertices()

    def copied(folder):
        for path in ("cameras.npz", "poses.npz", "splits.json", "frames", "masks"):
            copy = shutil.copytree if (subject / path).is_dir() else shutil.copy
            copy(subject / path, folder / path)
        for k in range(0, 6, 2):
            normals = np.zeros((48, 48, 3), np.float32) + [0, 0, -1]
            (folder / "normals").mkdir(exist_ok=True)
            np.save(folder / f"normals/{k:06d}.npy", normals.astype(np.float32))
        about = {"convention": "icon", "boxes": [[0, 0, 48, 48]] * 6}
        (folder / "normals.json").write_text(json.dumps(about))

    def opened(folder, _=None):
        video = load_video(folder)
        for frame in video.frames():
            frame.on_background()

    def filmed(folder):
        copied(folder)
        shutil.rmtree(folder / "frames")
        shutil.rmtree(folder / "normals")
        write_movie(
            folder / "video.mp4", [np.full((48, 48, 3), 40 * k, np.uint8) for k in range(6)]
        )

    def synthetic(folder):
        about = {"options": SynthOptions().recorded(), "body": fingerprint(body)}
        (folder / "synth.json").write_text(json.dumps(about))
        (folder / "prepare.json").write_text(
            json.dumps({"body": {"name": "a"} | fingerprint(body)})
        )
        (folder / "truth").mkdir()
        shutil.copy(subject / "poses.npz", folder / "truth")
        shutil.copy(subject / "cameras.npz", folder)
        noise = {
            "pose": {"lost_left_hand": [], "lost_right_hand": [1], "vertex_mm": 1.0, "sideways": 1,
                     "hand_vertex_mm": 2.0, "foot_vertex_mm": 3.0},
            "levels": {"pose": 1, "mask": 1, "normal": 1}, "mask": {"iou": 0.9},
            "normal": {"angle_deg": 3.0, "missing": 1}, "floor": {"joint_mm": 1.0, "limb_mm": 2.0},
        }  # fmt: skip
        (folder / "noise.json").write_text(json.dumps(noise))

    def run(folder):
        avatar.save(folder / "avatar.npz")
        save_without_body(folder / "bare.npz", avatar, body, "the built-in puppet")
        options = {"options": {"steps": 3, "seed": 0}, "versions": {}, "video": {"frames": "0"}}
        (folder / "options.json").write_text(json.dumps(options))
        state = {"step": 3, "avatar": avatar.record(), "history": {"loss": [1.0, 2.0]}}
        run_folder.save_state(folder, state)
        np.savez(folder / "history.npz", loss=np.arange(3.0))
        arrays = {"vertices": np.zeros((4, 3)), "faces": np.zeros((2, 3), int)}
        for side in ("before", "after"):
            for name in run_folder.GAUSSIANS:
                arrays[f"{side}_{name}"] = getattr(avatar.canonical, name).detach().numpy()
        (folder / "reinit").mkdir()
        np.savez(folder / "reinit/000002.npz", **arrays)
        row = {"name": "full", "split": "test", "psnr": 20.0, "ssim": 0.9, "lpips": None,
               "rand_vgg": 0.1}  # fmt: skip
        metrics = {"rows": [row], "refinement": {"figures": {}}, "options": {"seed": 0},
                   "training": {"steps": 1, "seconds": 1.0, "gaussians": 2, "size": [4, 4]},
                   "versions": {}, "protocol": None}  # fmt: skip
        (folder / "metrics.json").write_text(json.dumps(metrics))

    def read_run(folder, path=None):
        each(folder, path, {
            "avatar.npz": run_folder.load_avatar, "bare.npz": run_folder.load_avatar,
            "checkpoint.pt": lambda path: run_folder.load_state(folder),
            "metrics.json": lambda path: load_metrics(folder),
            "options.json": lambda path: run_folder.load_options(folder),
            "history.npz": lambda path: run_folder.load_history(folder),
            "reinit/000002.npz": lambda path: list(run_folder.load_snapshots(folder)),
        })  # fmt: skip

    def study(folder):
        result = CaseResult(HELD_OUT[0], 1.0, PoseFigures.from_json({}))
        save_study(folder / "refine.json", [result], body, StudyOptions(), [])

    def read_study(folder, _=None):
        assert load_study(folder / "refine.json", body, StudyOptions()) is not None

    def gaussians(folder):
        scene = random_scene(torch.Generator().manual_seed(0), gaussians=9, width=8, height=6)
        save_ply(folder / "a.ply", scene.gaussians)
        save_splat(folder / "a.splat", scene.gaussians)
        c = scene.camera
        camera = {"viewmat": c.T_camera_world, "K": c.K, "width": c.width, "height": c.height}
        arrays = {k: v.numpy() for k, v in scene.inputs().items()}
        np.savez(folder / "a.npz", **arrays, **camera)
        (folder / "compressed.ply").write_bytes(compressed_ply())

    def read_gaussians(folder, path=None):
        each(folder, path, {"a.ply": load_ply, "a.splat": load_splat, "a.npz": Scene.load,
                      "compressed.ply": load_ply})  # fmt: skip

    def bodies(folder):
        np.savez(folder / "body.npz", **small)
        (folder / "body.pkl").write_bytes(pickle.dumps(small, 2))

    def read_bodies(folder, path=None):
        each(folder, path, {"body.npz": load_body, "body.pkl": load_body})

    def motions(folder):
        poses = np.zeros((T, 156))
        poses[:, 3:] = 0.1
        found = {"poses": poses, "trans": np.zeros((T, 3)), "betas": np.zeros(16),
                 "mocap_framerate": 30.0}  # fmt: skip
        np.savez(folder / "amass.npz", **found)
        aist = {"smpl_poses": poses[:, :72], "smpl_trans": poses[:, :3], "smpl_scaling": [90.0]}
        (folder / "aist.pkl").write_bytes(pickle.dumps(aist, 2))
        torch.save({k: torch.as_tensor(v) for k, v in found.items()}, folder / "motion.pt")

    def read_motions(folder, path=None):
        read = lambda path: read_motion(path, body, MotionOptions())
        each(folder, path, {"amass.npz": read, "aist.pkl": read, "motion.pt": read})

    def footage(folder):
        image = np.arange(W * H * 3, dtype=np.uint8).reshape(H, W, 3)
        from PIL import Image

        for suffix in ("png", "jpg", "bmp", "tif", "webp"):
            Image.fromarray(image).save(folder / f"a.{suffix}")
        np.save(folder / "masks.npy", np.ones((T, H, W), bool))
        write_movie(folder / "film.mp4", [image] * T)

    def read_footage(folder, path=None):
        read = {f"a.{suffix}": lambda path: list(pictures((path,), 3))
                for suffix in ("png", "jpg", "bmp", "tif", "webp")}  # fmt: skip
        whole = lambda path: list(masks(path))
        each(folder, path, read | {"masks.npy": whole, "film.mp4": whole})
        read_background(str(folder / "a.png"), 9, 9)

    def ranges(folder):
        text = "train:\n  start: 0\n  end: 2\n  skip: 1\ntest:\n  start: 3\n  end: 4\n"
        (folder / "a.yaml").write_text(text)

    def hdf5(folder):
        import h5py

        with h5py.File(folder / "masks.hdf5", "w") as file:
            file.create_dataset(
                "masks", data=np.ones((T, H, W), "u1"), chunks=True, compression="lzf"
            )
            file.create_dataset("pose", data=np.ones((T, 72), "f4"))

    def read_arrays_of_hdf5(folder, path=None):
        each(
            folder, path, {"masks.hdf5": lambda path: (list(masks(path)), read_hdf5(path, "pose"))}
        )

    readers = {
        "subject": (copied, opened),
        "film": (filmed, opened),
        "check": (copied, lambda folder, _=None: check_subject(folder, body)),
        "synth.json": (synthetic, lambda folder, path=None: each(folder, path, {
            "synth.json": lambda path: made_of(folder),
            "noise.json": lambda path: describe_noise(folder),
            "truth/poses.npz": lambda path: load_truth(path.parent, body),
            "prepare.json": lambda path: require_same_body(folder, body)})),
        "run": (run, read_run),
        "study": (study, read_study),
        "gaussians": (gaussians, read_gaussians),
        "body": (bodies, read_bodies),
        "motion": (motions, read_motions),
        "footage": (footage, read_footage),
        "ranges": (ranges, lambda folder, _=None: read_ranges(folder / "a.yaml", 5)),
        "hdf5": (hdf5, read_arrays_of_hdf5),
    }  # fmt: skip
    return readers | estimators() | datasets()


def each(folder, path, readers):
    """Read one file, if somebody reads it apart; else all of them."""
    alone = {name: read for name, read in readers.items() if name == str(path)}
    for name, read in (alone or readers).items():
        read(folder / name)


def body_of_few_vertices():
    """SMPL-X's arrays of the puppet's first triangles."""
    with np.load(PUPPET) as file:
        arrays = {key: file[key] for key in file.files}
    n, corner = 60, np.arange(6)[:, None] * 10 + np.arange(9)  # of a grid of 6 x 10
    for key in ("v_template", "shapedirs", "posedirs", "weights"):
        arrays[key] = arrays[key][:n]
    a, b, c, d = (corner[:-1] + k for k in (0, 1, 10, 11))
    arrays["f"] = np.concatenate([np.stack(x, -1).reshape(-1, 3) for x in ((a, c, b), (b, c, d))])
    regressor = np.zeros((55, n))
    regressor[:, 0] = 1
    return arrays | {"J_regressor": regressor}


def compressed_ply():
    """SuperSplat's form: one chunk of 8 Gaussians."""
    bounds = [
        f"{e}_{a}" for e in ("min", "max") for a in ("x", "y", "z", "scale_x", "scale_y", "scale_z")
    ]
    packed = [f"packed_{name}" for name in ("position", "rotation", "scale", "color")]
    head = ["ply", "format binary_little_endian 1.0", "element chunk 1"]
    head += [f"property float {name}" for name in bounds] + ["element vertex 8"]
    head += [f"property uint {name}" for name in packed] + ["end_header\n"]
    table = np.arange(12, dtype="<f4").tobytes() + np.arange(32, dtype="<u4").tobytes()
    return "\n".join(head).encode() + table


def estimators():
    """Files of pose estimators."""
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
        "vibe": ("a.pkl", {1: {
            "pred_cam": np.ones((T, 3)), "orig_cam": np.ones((T, 4)), "verts": np.zeros((T, 9, 3)),
            "pose": pose, "betas": betas, "joints2d": None, "bboxes": np.zeros((T, 4)),
            "frame_ids": frames,
        }}),
        "gvhmr": ("a.pt", {
            "smpl_params_global": incam, "smpl_params_incam": incam, "K_fullimg": tensor(K),
        }),
        "4dhumans": ("a.pkl", {f"img/{k}.jpg": {
            "tid": [2], "tracked_ids": [2], "smpl": [smpl], "time": k, "camera": [transl[k]],
            "size": [[H, W]], "mask": [],
        } for k in range(T)}),
        "glamr": ("a.pkl", {"cam_pose": np.tile(np.eye(4), (T, 1, 1)), "meta": {"num_fr": T},
                            "person_data": {0: {
            "visible": np.ones(T), "exist_frames": np.ones(T, bool), "frames": frames,
            "frame2ind": {k: k for k in range(T)}, "scale": None, "smpl_pose": pose[:, :69],
            "smpl_beta": betas, "smpl_orient_cam": pose[:, :3], "root_trans_cam": transl,
            "smpl_orient_cam_in_world": pose[:, :3], "root_trans_cam_in_world": transl, "cam_K": K,
        }}}),
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
            path.parent.mkdir(exist_ok=True)
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
    return made | {
        "smplerx": (smplerx, lambda folder, _=None: read_estimator("auto", folder, VIEW))
    }


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


def datasets():
    """Folders of data sets."""
    image = np.full((H, W, 3), 99, np.uint8)
    matrix = lambda x: (
        f"!!opencv-matrix\n  rows: {np.atleast_2d(x).shape[0]}\n  cols: {np.atleast_2d(x).shape[1]}"
        f"\n  dt: d\n  data: [{', '.join(map(str, np.ravel(x).tolist()))}]\n"
    )
    K = np.array([[40.0, 0, 16], [0, 40, 12], [0, 0, 1]])

    def instantavatar(folder):
        for k in range(T):
            write_image(folder / f"images/image_{k:04d}.png", image)
            write_image(folder / f"masks/mask_{k:04d}.png", image[..., 0])
        np.savez(folder / "cameras.npz", intrinsic=K, extrinsic=np.eye(4), height=H, width=W)
        thetas = {"thetas": np.full((T, 72), 0.1), "betas": np.zeros(10)}
        np.savez(folder / "poses.npz", transl=np.ones((T, 3)), **thetas)

    def easymocap(folder):
        person = {"id": 0, "Rh": [[0.1, 0, 0]], "Th": [[0, 0, 4.0]], "poses": [[0.1] * 72],
                  "shapes": [[0.0] * 10]}  # fmt: skip
        (folder / "smpl").mkdir()
        for k in range(T):
            write_image(folder / f"images/1/{k:06d}.jpg", image)
            write_image(folder / f"mask/1/{k:06d}.png", image[..., 0])
            (folder / f"smpl/{k:06d}.json").write_text(json.dumps([person]))
        (folder / "intri.yml").write_text(
            f"%YAML:1.0\nK_1: {matrix(K)}dist_1: {matrix(np.zeros(5))}"
        )
        outer = f"R_1: {matrix(np.zeros(3))}Rot_1: {matrix(np.eye(3))}T_1: {matrix(np.ones(3))}"
        (folder / "extri.yml").write_text(outer)

    def neuman(folder):
        lines, aligned = ["# images"], {}
        for k in range(T):
            write_image(folder / f"images/{k:05d}.png", image)
            write_image(folder / f"segmentations/{k:05d}.png", image[..., 0])
            aligned[f"{k:05d}.png"] = np.concatenate([np.eye(3), [[0, 0, 4]]])
            lines += [f"{k} 1 0 0 0 0 0 0 1 {k:05d}.png", "1.0 2.0 -1"]
        (folder / "sparse").mkdir()
        (folder / "sparse/images.txt").write_text("\n".join(lines))
        (folder / "sparse/cameras.txt").write_text(f"1 PINHOLE {W} {H} 40 40 16 12\n")
        np.save(folder / "alignments.npy", aligned)
        found = {1: {"pose": np.full((T, 72), 0.1), "betas": np.zeros((T, 10))}}
        (folder / "smpl_output_romp.pkl").write_bytes(pickle.dumps(found))

    def avatarrex(folder):
        for k in range(T):
            write_image(folder / f"1/{k:08d}.jpg", image)
            write_image(folder / f"1/mask/pha/{k:08d}.jpg", image[..., 0])
        camera = {"K": K.ravel().tolist(), "R": np.eye(3).ravel().tolist(), "T": [0, 0, 4],
                  "imgSize": [W, H]}  # fmt: skip
        (folder / "calibration_full.json").write_text(json.dumps({"1": camera}))
        sizes = {"global_orient": 3, "body_pose": 63, "transl": 3, "jaw_pose": 3, "expression": 10,
                 "left_hand_pose": 45, "right_hand_pose": 45}  # fmt: skip
        arrays = {name: np.full((T, size), 0.1) for name, size in sizes.items()}
        np.savez(folder / "smpl_params.npz", betas=np.zeros((1, 10)), **arrays)

    makers = {"instantavatar": instantavatar, "easymocap": easymocap, "neuman": neuman,
              "avatarrex": avatarrex}  # fmt: skip
    reader = lambda kind: lambda folder, _=None: read_dataset(kind, folder, Wanted())
    return {kind: (make, reader(kind)) for kind, make in makers.items()}
