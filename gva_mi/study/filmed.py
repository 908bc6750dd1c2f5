"""The error model "film": nothing is invented, real networks and the film solver see the pictures.

The poses of :mod:`gva_mi.pose.film` stand in a world of their own. They are brought to the world of
the ground truth: the camera sees the same, and errors can be measured.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import to_matrix, to_rotvec
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.files import write_json
from gva_mi.data.cameras import CAMERAS, save_cameras
from gva_mi.data.film_pictures import read_film
from gva_mi.data.fingerprint import FILM, PREPARED, SYNTH
from gva_mi.data.ground_truth import GroundTruth, load_ground_truth
from gva_mi.data.landmarks import LANDMARKS
from gva_mi.data.matting.film import film_masks
from gva_mi.data.networks.watch import watch_film
from gva_mi.data.pictures import in_8_bits
from gva_mi.data.splits import SPLITS
from gva_mi.data.video import POSES, load_video
from gva_mi.pose.film.face import with_face
from gva_mi.pose.film.front_back import with_backs
from gva_mi.pose.film.solver import KnownOfFilm, solve_film
from gva_mi.pose.film.vertical_lines import vertical_of
from gva_mi.splat import Camera

FPS = 30.0  # frames a second of a synthetic subject's video


def watch_take(take: Path, out: Path, body: BodyModel) -> None:
    """Write a copy of a synthetic subject whose masks, landmarks and poses come from its pictures.

    The height and the focal length are known. A camera that was held by hand is taken for one that
    stands, as in any film: then the true poses are those that the first camera would have seen so.

    Args:
        take: a folder that ``gva-mi synth`` made.
        out: the new folder, which must not exist; it appears when it is complete.
        body: the body that the poses move.
    """
    video, truth = load_video(take, normals="none"), load_ground_truth(take / "truth", body)
    camera, pictures = truth.cameras[0], read_film(take / "frames").pictures
    with atomic_dir(out) as folder:
        for name in ("frames", "truth", "video.mp4", SPLITS, SYNTH):
            if (take / name).is_dir():
                shutil.copytree(take / name, folder / name)
            elif (take / name).exists():
                shutil.copy2(take / name, folder / name)
        if any((other.T_camera_world != camera.T_camera_world).any() for other in truth.cameras):
            save_poses(folder / "truth" / POSES, steadied(truth), truth.shape, stage=2)
            save_cameras(folder / "truth" / CAMERAS, [camera] * len(video))
        seen: dict[int, np.ndarray] = {}
        keep = lambda k, silhouette: seen.update({k: in_8_bits(silhouette)})
        landmarks, _ = with_backs(watch_film(pictures, keep).landmarks, FPS)
        film_masks(pictures, [seen[k] for k in range(len(video))], folder / "masks")
        landmarks.save(folder / LANDMARKS)
        known = KnownOfFilm(height_of(truth), camera.fx, (camera.cx, camera.cy))
        lines = vertical_of(pictures, landmarks, known.K(video.size))
        solved = solve_film(landmarks, body, video.size, FPS, replace(known, lines=lines))
        solved, _ = with_face(solved, landmarks, body, FPS)
        pose = moved(solved.pose, solved.shape, body, solved.camera, camera)
        save_poses(folder / POSES, pose, solved.shape, stage=1)
        save_cameras(folder / CAMERAS, [camera] * len(video))
        write_json(folder / PREPARED, {"kind": FILM})


def moved(pose: Pose, shape: Shape, body: BodyModel, before: Camera, after: Camera) -> Pose:
    """Return poses that one camera sees where another one saw the given poses."""
    T = torch.from_numpy(np.linalg.inv(after.T_camera_world) @ before.T_camera_world)
    R, t = T[:3, :3].to(pose.transl), T[:3, 3].to(pose.transl)
    pelvis, rotations = body.rest(shape).joints[0], pose.rotations.clone()
    turned = R @ to_matrix(rotations[:, 0])
    rotations[:, 0] = to_rotvec(turned)
    return Pose(rotations, (pelvis + pose.transl) @ R.T + t - pelvis, pose.expression)


def steadied(truth: GroundTruth) -> Pose:
    """Return poses that the first camera would have to see, to see what each frame's camera saw."""
    frames = [
        moved(truth.pose[[k]], truth.shape, truth.body, camera, truth.cameras[0])
        for k, camera in enumerate(truth.cameras)
    ]
    return Pose.cat(frames)


def height_of(truth: GroundTruth) -> float:
    """Return the subject's height at rest, from head to soles, metres."""
    y = truth.body.rest(truth.shape).vertices[:, 1]
    return float(y.max() - y.min())
