"""Tiny files that a page presupposes: films, masks, estimators' poses, data sets, views."""

import importlib.util
import pickle
import shutil
import warnings
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.built_in import BUILT_IN_BODY
from gva_mi.body.pose import JOINTS, save_poses
from gva_mi.data.pictures import write_image, write_movie
from gva_mi.data.video import save_cameras
from gva_mi.splat import Camera, look_at
from gva_mi.splat.scene import random_scene

FUZZ = Path(__file__).parents[1] / "fuzz"
W, H, T = 32, 24, 3  # as in tests/fuzz


def of_fuzz(name):
    spec = importlib.util.spec_from_file_location(name, FUZZ / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def prepare(page, folder, known, turning):
    """Write what a page needs beside the results of README's commands."""
    dance(folder)
    scene(folder)
    if page in ("export.md", "motions.md"):  # an avatar that visibly moves
        shutil.rmtree(folder / "run")
        known.save(folder / "run/avatar.npz")
        save_poses(folder / "run/poses.npz", *turning(3), stage=2)
    if page == "licences.md":
        known.save(folder / "run/avatar.npz")
    if page == "own_video.md":
        two_more(folder)
    if page == "reproducibility.md":
        shutil.rmtree(folder / "renders")
    if page == "sources.md":
        shutil.rmtree(folder / "subject")  # another one is made
        footage(folder)
        estimated(folder)
        data_sets(folder)
        networks(folder)
        bodies(folder)
    if page == "viewer.md":
        save_poses(folder / "walk.npz", *turning(3), stage=2)
        camera = Camera(60.0, 60.0, 24, 24, look_at((0, 0, 3), (0, 0, 0)), 48, 48)
        (folder / "view").mkdir()
        save_cameras(folder / "view/cameras_000.npz", [camera] * 4)


def dance(folder):
    """Write a motion in AMASS's form."""
    poses = np.zeros((9, 156))
    poses[:, 0] = np.pi / 2  # z is up
    poses[:, 50] = np.linspace(0, 0.5, 9)
    amass = {"poses": poses, "trans": np.zeros((9, 3)), "betas": np.zeros(16)}
    np.savez(folder / "dance.npz", **amass, mocap_framerate=60.0)


def scene(folder):
    """Write a scene of 8 Gaussians and a camera."""
    s = random_scene(torch.Generator().manual_seed(0), gaussians=8, width=20, height=16)
    c = s.camera
    arrays = {k: v.numpy() for k, v in s.inputs().items()}
    camera = {"viewmat": c.T_camera_world, "K": c.K, "width": c.width, "height": c.height}
    np.savez(folder / "scene.npz", **arrays, **camera)


def two_more(folder):
    """Write unrefined subjects A and B."""
    for name in "AB":
        shutil.copytree(folder / "subject", folder / name)
        for path in (folder / name).glob("*refine*"):
            path.unlink()


def footage(folder):
    """Write a film and its frames; masks as film, pictures and array; normal maps."""
    shots = np.random.default_rng(0).integers(0, 256, (T, H, W, 3), np.uint8)
    mask = np.zeros((H, W), np.uint8)
    mask[6:20, 10:22] = 255
    write_movie(folder / "video.mp4", list(shots))
    write_movie(folder / "masks.mp4", [np.repeat(mask[..., None], 3, 2)] * T)
    np.save(folder / "masks.npy", np.stack([mask > 0] * T))
    (folder / "maps").mkdir()
    for k, shot in enumerate(shots):
        write_image(folder / f"frames/{k + 1:05d}.png", shot)
        write_image(folder / f"masks/{k + 1:05d}.png", mask)
        leaning = np.float32((-0.6, 0, 0.8))  # y up and z to the viewer
        np.save(folder / f"maps/{k + 1:05d}.npy", np.tile(leaning, (H, W, 1)))


def estimated(folder):
    """Write the output of four estimators for a person inside the masks."""
    made = of_fuzz("estimators").estimators()
    for kind, name, path in (
        ("wham", "a.pkl", "wham_output.pkl"), ("gvhmr", "a.pt", "hmr4d_results.pt"),
        ("parameters", "a.npz", "poses.npz"),
    ):  # fmt: skip
        made[kind][0](folder)
        (folder / name).rename(folder / path)
    (folder / "results").mkdir()
    made["smplerx"][0](folder / "results")


def data_sets(folder):
    made = of_fuzz("datasets")
    for name, write in (("male-3-casual", made.instantavatar), ("CoreView_377", made.zju_of_five)):
        (folder / name).mkdir()
        write(folder / name)
    ranges = "train:\n  start: 0\n  end: 1\n  skip: 1\ntest:\n  start: 2\n  end: 3\n  skip: 1\n"
    (folder / "male-3-casual.yaml").write_text(ranges)


class Facing(torch.nn.Module):
    """A network whose normals always face the camera."""

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return torch.cat([torch.zeros_like(seen[:, :2]), torch.ones_like(seen[:, :1])], dim=1)


def networks(folder):
    """Write Segment Anything with random weights, and two networks of normals."""
    made = of_fuzz("networks")
    torch.manual_seed(0)
    made.sam(folder / "sam2.1-hiera-tiny")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.jit.save(torch.jit.script(Facing()), folder / "icon.pt")
    made.of_tests("test_normal_networks").onnx_file(folder / "scene.onnx", (16, 16))


def bodies(folder):
    """Write the built-in body under licensed names: as SMPL-X, and reduced to SMPL's joints."""
    shutil.copy(BUILT_IN_BODY, folder / "SMPLX_NEUTRAL.npz")
    with np.load(BUILT_IN_BODY) as file:
        arrays = {name: file[name] for name in file.files}
    fingers = [[j for j, name in enumerate(JOINTS) if name.startswith(side) and j > 24]
               for side in ("left", "right")]  # fmt: skip
    weights = arrays["weights"]
    hands = [weights[:, of].sum(1) for of in fingers]
    body = weights[:, :22].copy()
    body[:, 15] += weights[:, 22:25].sum(1)  # jaw and eyes go with the head
    regressor = arrays["J_regressor"]
    parents = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
    smpl = {
        "v_template": arrays["v_template"], "f": arrays["f"],
        "shapedirs": arrays["shapedirs"][..., :10], "posedirs": arrays["posedirs"][..., : 9 * 23],
        "J_regressor": np.concatenate([regressor[:22], regressor[[fingers[0][3], fingers[1][3]]]]),
        "weights": np.concatenate([body, np.stack(hands, 1)], axis=1),
        "kintree_table": np.stack([parents, np.arange(24)]),
    }  # fmt: skip
    (folder / "SMPL_NEUTRAL.pkl").write_bytes(pickle.dumps(smpl, 2))
