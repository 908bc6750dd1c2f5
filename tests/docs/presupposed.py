"""Tiny files that a page presupposes: a motion, a scene, more subjects."""

import shutil

import numpy as np
from samples.scenes import few_gaussians

from gva_mi.body.pose import save_poses


def prepare(page, folder, known, turning):
    """Write what a page needs beside the results of README's commands."""
    dance(folder)
    few_gaussians(folder / "scene.npz")
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
    if page == "viewer.md":
        save_poses(folder / "walk.npz", *turning(3), stage=2)


def dance(folder):
    """Write a motion in AMASS's form."""
    poses = np.zeros((9, 156))
    poses[:, 0] = np.pi / 2  # z is up
    poses[:, 50] = np.linspace(0, 0.5, 9)
    amass = {"poses": poses, "trans": np.zeros((9, 3)), "betas": np.zeros(16)}
    np.savez(folder / "dance.npz", **amass, mocap_framerate=60.0)


def two_more(folder):
    """Write unrefined subjects A and B."""
    for name in "AB":
        shutil.copytree(folder / "subject", folder / name)
        for path in (folder / name).glob("*refine*"):
            path.unlink()
