"""Good files of this program's own formats and of bodies, motions and footage.

For each kind: a function that writes files into an empty folder, and one that reads them again when
one of them has been damaged.
"""

import functools
import json
import pickle
import shutil

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.without_body import save_without_body
from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.body.pose import is_pose_file
from gva_mi.body.smplx import load_body
from gva_mi.evaluate.figures import Figure
from gva_mi.evaluate.measure import Metrics
from gva_mi.evaluate.refinement import load_refinement
from gva_mi.fit import run_folder
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody
from gva_mi.splat.formats.ply import load_ply, save_ply
from gva_mi.splat.scene import random_scene
from gva_mi.study import report
from gva_mi.study.cases import HELD_OUT
from gva_mi.study.engine import Outcome, Study
from gva_mi.subject.fingerprint import fingerprint, require_same_body
from gva_mi.subject.video import load_video
from gva_mi.subject.video_file import write_video

W, H, T = 32, 24, 3
target = functools.cache(lambda: TargetBody.read(None))


class Made(Study):
    """A study whose inputs do not matter."""

    kind, made_with, stamp = "refine", {}, "0"
    variants = ("refined",)

    def rounds(self, missing):
        raise AssertionError("its results are there")


def seeds(subject, avatar):
    """All readers by name; ``subject`` is the folder of a tiny one, ``avatar`` its avatar."""
    body = load_body()
    small = body_of_few_vertices()

    def copied(folder):
        body_of = {"name": "a"} | fingerprint(body)
        (folder / "prepare.json").write_text(json.dumps({"body": body_of}))
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
        require_same_body(folder, body)
        video = load_video(folder)
        video.offsets_of(len(body.v_template))
        for frame in video.frames():
            frame.on_background()

    def filmed(folder):
        copied(folder)
        shutil.rmtree(folder / "frames")
        shutil.rmtree(folder / "normals")
        write_video(
            folder / "video.mp4", [np.full((48, 48, 3), 40 * k, np.uint8) for k in range(6)]
        )

    def run(folder):
        avatar.save(folder / "avatar.npz")
        save_without_body(folder / "bare.npz", avatar, body, "the built-in body")
        options = {"options": {"steps": 3, "seed": 0}, "versions": {}, "video": {"frames": "0"}}
        (folder / "options.json").write_text(json.dumps(options))
        state = {"step": 3, "avatar": avatar.record(), "history": {"loss": [1.0, 2.0]}}
        run_folder.save_state(folder, state)
        row = {"split": "test", "region": "white", "metric": "PSNR, dB", "value": 20.0}
        about = {"figures": [row, {"metric": "LPIPS", "value": None}], "options": {"seed": 0},
                 "size": [4, 4], "versions": {}, "protocol": {"seen": {}}}  # fmt: skip
        (folder / "metrics.json").write_text(json.dumps(about))
        refinement = {"figures": [row], "test_frames": "seen"}
        (folder / "refinement.json").write_text(json.dumps(refinement))

    def read_run(folder, path=None):
        each(folder, path, {
            "avatar.npz": Avatar.load, "bare.npz": run_folder.load_avatar,
            "checkpoint.pt": lambda path: run_folder.load_state(folder),
            "metrics.json": lambda path: Metrics.load(folder).tables(),
            "refinement.json": lambda path: load_refinement(folder),
            "options.json": lambda path: run_folder.load_options(folder),
        })  # fmt: skip

    def study(folder):
        about = {"subject": HELD_OUT[0].name, "variant": "refined", "region": "body"}
        change = Figure(**about, metric="change", value=-0.5)
        Made(folder, None, None).save([Outcome(HELD_OUT[0], "refined", (change,))])

    def read_study(folder, path=None):
        each(folder, path, {
            "refine.json": lambda path: report.study_tables(
                "refine", Made(folder, None, None).load()),
        })  # fmt: skip

    def gaussians(folder):
        scene = random_scene(torch.Generator().manual_seed(0), gaussians=9, width=8, height=6)
        save_ply(folder / "a.ply", scene.gaussians)

    def read_gaussians(folder, path=None):
        each(folder, path, {
            "a.ply": load_ply,
        })  # fmt: skip

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
        def read(path):
            assert path.suffix != ".npz" or not is_pose_file(path)
            read_motion(path, target(), MotionOptions())

        each(folder, path, {"amass.npz": read, "aist.pkl": read, "motion.pt": read})

    return {"subject": (copied, opened), "video": (filmed, opened), "run": (run, read_run),
        "study": (study, read_study), "gaussians": (gaussians, read_gaussians),
        "body": (bodies, read_bodies), "motion": (motions, read_motions)}  # fmt: skip


def each(folder, path, readers):
    """Read one file if it has a reader of its own, else all of them."""
    alone = {name: read for name, read in readers.items() if name == str(path)}
    for name, read in (alone or readers).items():
        read(folder / name)


def body_of_few_vertices():
    """SMPL-X's arrays of the first triangles of the built-in body."""
    with np.load(BUILT_IN_BODY) as file:
        arrays = {key: file[key] for key in file.files}
    n, corner = 60, np.arange(6)[:, None] * 10 + np.arange(9)  # of a grid of 6 x 10
    for key in ("v_template", "shapedirs", "posedirs", "weights"):
        arrays[key] = arrays[key][:n]
    a, b, c, d = (corner[:-1] + k for k in (0, 1, 10, 11))
    arrays["f"] = np.concatenate([np.stack(x, -1).reshape(-1, 3) for x in ((a, c, b), (b, c, d))])
    regressor = np.zeros((55, n))
    regressor[:, 0] = 1
    return arrays | {"J_regressor": regressor}
