"""Stage 1 of real videos: what one camera says, against what several calibrated ones see.

Real people come without ground truth. Where calibrated cameras film one person at the same time,
each video alone gives poses, a lens and the direction up, and the landmarks of all videos give
points in space. These err by a few centimetres, and a landmark is not quite the joint that it is
named after.

A calibration is a TOML file with a table for each camera, as Pose2Sim, anipose and FreeMoCap write
it: ``name``, ``size``, ``matrix``, ``distortions`` and ``rotation``, ``translation`` from the world
to the camera. Points X follow from where the cameras see them:

1. ``min Σ_c log(1 + |π_c(X) - x_c|² / τ²)``

by iteratively reweighted direct linear transformation (Hartley and Zisserman, *Multiple View
Geometry*, ch. 12): one camera that is far off is outvoted.

Figures (:mod:`gva_mi.evaluate.figures`) of a camera are means over the frames: focal lengths and
the median distance of landmarks from the points, pixels of the video; the angle between the
directions up; the distance of joints; the depth of the hips' middle, beyond the points'; the
distance of joints with the hips' middle in the same place (aligned), of that across the line of
sight (aside), and of the network's own metres, aligned, scaled as fits best.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from gva_mi.body import so3
from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import require_file
from gva_mi.evaluate.figures import Figure
from gva_mi.observe.landmark_noise import person_sizes
from gva_mi.splat import Camera
from gva_mi.stage1.prepare import PrepareVideoOptions, SolvedMotion, motion_of_video
from gva_mi.stage1.solver import Stage1Solution
from gva_mi.subject.landmarks import BODY_LANDMARKS, Landmarks
from gva_mi.subject.video_file import decoded, open_stream, size_of

CALIBRATION = (
    "a camera's name, size, matrix, distortions, rotation and translation, as in Pose2Sim's, "
    "anipose's or FreeMoCap's calibration"
)
ITERATIONS = 10  # of reweighting, and of undoing the distortion; chosen: both have settled
OUTLIER_SCALE = 0.01  # τ, share of a person's height; chosen: about the error of a landmark
# Pixels: codecs pad pictures to whole blocks on the right and below. A calibration of 1088 pixels
# holds for the 1080 that are shown.
CODEC_BLOCK = 16
LEAST_CONFIDENCE = 0.5  # of a landmark that counts; chosen: likelier right than wrong
COMPARED_JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera of a calibration, whose axes are x right, y down, z away."""

    name: str
    size: tuple[int, int]  # pixels
    K: np.ndarray  # (3, 3) pixels
    distortion: np.ndarray  # (4,) or (5,) of OpenCV
    R: np.ndarray  # (3, 3) from the world
    t: np.ndarray  # (3,) metres

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return x / z and y / z (..., 2) of points, by fixed-point iteration."""
        k1, k2, p1, p2, k3 = (*self.distortion, 0.0)[:5]
        seen = (pixels - self.K[:2, 2]) / self.K[[0, 1], [0, 1]]
        x = seen
        for _ in range(ITERATIONS):
            r2, xy = np.square(x).sum(-1, keepdims=True), x.prod(-1, keepdims=True)
            aside = 2 * xy * [p1, p2] + (r2 + 2 * np.square(x)) * [p2, p1]
            x = (seen - aside) / (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))
        return x

    def place(self, X: np.ndarray) -> np.ndarray:
        """Return points (..., 3) of the world in the camera's axes."""
        return X @ self.R.T + self.t


def read_calibration(path: Path) -> list[CalibratedCamera]:
    """Read the cameras of a calibration; tables without a matrix are ignored.

    Raises:
        InputError: the file is not one.
    """
    require_file(path, CALIBRATION)
    with expecting(path, CALIBRATION):
        tables = tomllib.loads(path.read_text())
        tables = {name: table for name, table in tables.items() if "matrix" in table}
        found = [_camera(name, table) for name, table in tables.items()]
    for name, table in tables.items():
        if table.get("fisheye") or np.size(table["distortions"]) not in (4, 5):
            raise InputError(
                f"{path}: {name} is a fisheye, or does not have 4 or 5 distortion "
                "coefficients; expected a lens of OpenCV with k1, k2, p1, p2 and perhaps k3"
            )
    if len(found) < 2:
        raise InputError(f"{path}: expected at least two cameras, found {len(found)}")
    return found


def _camera(key: str, table: dict) -> CalibratedCamera:
    K, distortion = np.array(table["matrix"], float), np.array(table["distortions"], float)
    turn = torch.tensor(table["rotation"], dtype=torch.float64)
    width, height = (int(side) for side in table["size"])
    t = np.array(table["translation"], float).reshape(3)
    R = so3.to_matrix(turn.reshape(3)).numpy()
    Camera.from_matrices(K, np.eye(4), width, height)  # refuses a skew, which rays() ignores
    name = str(table.get("name", key))
    return CalibratedCamera(name, (width, height), K.reshape(3, 3), distortion, R, t)


def triangulate(
    cameras: Sequence[CalibratedCamera], rays: np.ndarray, seen: np.ndarray, tau: np.ndarray
) -> np.ndarray:
    """Minimise eq. 1 from rays (C, N, 2).

    Args:
        cameras: C of them.
        rays: x / z and y / z, of N points.
        seen: (C, N) where a camera saw a point.
        tau: (C,) of x / z.

    Returns:
        X (N, 3) metres; NaN where fewer than two cameras saw a point.
    """
    P = np.stack([np.column_stack([camera.R, camera.t]) for camera in cameras])[:, None]
    x = np.where(seen[..., None], rays, 0)
    rows = x[..., None] * P[:, :, 2:] - P[:, :, :2]  # (C, N, 2, 4)
    weights = seen.astype(float)
    for _ in range(ITERATIONS):
        A = (weights[..., None, None] * rows).transpose(1, 0, 2, 3).reshape(len(x[0]), -1, 4)
        X = np.linalg.svd(A, full_matrices=False)[2][:, -1]
        X = X[:, :3] / X[:, 3:]
        local = np.stack([camera.place(X) for camera in cameras])
        off = np.square(local[..., :2] / local[..., 2:] - x).sum(-1)
        weights = seen / (local[..., 2] * np.sqrt(1 + off / tau[:, None] ** 2))
    return np.where((seen.sum(0) >= 2)[:, None], X, np.nan)


def compare(
    camera: CalibratedCamera,
    solved: Stage1Solution,
    landmarks: Landmarks,
    body: BodyModel,
    X: np.ndarray,
    up: np.ndarray,
) -> list[Figure]:
    """Compare one video's stage 1 with points X (T, 33, 3), world, one for each of BODY_LANDMARKS.

    ``up`` (3,) is the world's direction up.
    """
    names = [f"{side}_{name}" for name in COMPARED_JOINTS for side in SIDES]
    true = 1e3 * camera.place(X)[:, [BODY_LANDMARKS.index(name) for name in names]]
    T = np.asarray(solved.camera.T_camera_world)
    joints = body(solved.pose, solved.shape).joints[:, [JOINTS.index(name) for name in names]]
    found = 1e3 * (joints.double().numpy() @ T[:3, :3].T + T[:3, 3])
    guessed = 1e3 * landmarks.metric[:, landmarks.indices(names)].astype(float)
    hips = [names.index(f"{side}_hip") for side in SIDES]
    centred = lambda points: points - points[:, hips].mean(1, keepdims=True)
    length = lambda off: float(np.nanmean(np.linalg.norm(off, axis=-1)))
    off, own = centred(found) - centred(true), centred(guessed)
    scale = np.nansum(own * centred(true)) / np.nansum(np.where(np.isnan(true), 0, own**2))
    factor, local = solved.camera.width / camera.size[0], camera.place(X)
    pixels = landmarks.pixels[:, landmarks.indices(BODY_LANDMARKS)].astype(float)
    rays = camera.rays(pixels / factor)
    beside = np.linalg.norm(local[..., :2] / local[..., 2:] - rays, axis=-1)
    angle = np.degrees(np.arccos(np.clip(T[:3, 1] @ (camera.R @ up), -1, 1)))
    values = {
        "lens, px": solved.camera.fx,
        "true lens, px": factor * camera.K[0, 0],
        "points, px": np.nanmedian(factor * camera.K[0, 0] * beside),
        "up, degrees": angle,
        "joints, mm": length(found - true),
        "depth, mm": np.nanmean((found - true)[:, hips, 2]),
        "aligned, mm": length(off),
        "aside, mm": length(off[..., :2]),
        "network, mm": length(scale * own - centred(true)),
    }
    figures = [Figure(subject=camera.name, metric=k, value=float(x)) for k, x in values.items()]
    for name in COMPARED_JOINTS:
        joints = [k for k, full in enumerate(names) if full.endswith(name)]
        about = {"region": name, "metric": "aligned, mm", "value": length(off[:, joints])}
        figures.append(Figure(subject=camera.name, **about))
    return figures


def multiview(
    folder: Path,
    calibration: Path,
    body: BodyModel,
    options: PrepareVideoOptions,
    up: np.ndarray,
    known_lens: bool,
    progress: Progress | None = None,
) -> list[Figure]:
    """Solve the video of each camera alone, and compare it with all of them.

    Args:
        folder: of the videos, which start at the same time and have the same frames.
        calibration: of the cameras.
        body: of the poses.
        options: of the videos.
        up: (3,) the world's direction up.
        known_lens: whether each video is solved with its true focal length.
        progress: called as the work goes on.

    Raises:
        InputError: a file is missing, or videos differ in their frames.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected videos that are named after cameras")
    cameras = read_calibration(calibration)
    videos = [_video_of(folder, camera) for camera in cameras]
    motions: list[SolvedMotion] = []
    for k, (video, camera) in enumerate(zip(videos, cameras, strict=True)):
        scale = min(1.0, options.side / min(_size_of(video, camera)))
        lens = str(scale * camera.K[0, 0]) if known_lens else None
        part = part_of_progress(progress, k, 1, len(videos))
        motions.append(motion_of_video(video, options, body, lens=lens, progress=part))
        if motions[-1].pictures.numbers != motions[0].pictures.numbers:
            raise InputError(
                f"{video}: its pictures have other times than {videos[0]}; "
                "expected videos that start together and have one rate and length"
            )
    rays, seen, tau = (np.stack(x) for x in zip(*map(_seen, cameras, motions), strict=True))
    X = triangulate(cameras, rays.reshape(len(videos), -1, 2), seen.reshape(len(videos), -1), tau)
    X = X.reshape(*rays.shape[1:3], 3)
    figures = []
    for camera, motion in zip(cameras, motions, strict=True):
        figures += compare(camera, motion.solved, motion.watched.landmarks, body, X, up)
    return figures


def _video_of(folder: Path, camera: CalibratedCamera) -> Path:
    """Return the video of a camera: the file in a folder that is named after it."""
    named = sorted(path for path in folder.iterdir() if path.stem == camera.name)
    videos = [path for path in named if path.suffix != ".toml"]
    if len(videos) != 1:
        raise InputError(
            f"{folder}: expected one video of the camera {camera.name}, of that name, "
            f"found {len(videos)}"
        )
    return videos[0]


def _size_of(video: Path, camera: CalibratedCamera) -> tuple[int, int]:
    """Return a video's size, pixels; refuse one that the calibration does not hold for."""
    with closing(decoded(open_stream(video))) as frames:
        size = size_of(next(frames))
    padding = [of_camera - side for of_camera, side in zip(camera.size, size, strict=True)]
    if not all(0 <= pixels < CODEC_BLOCK for pixels in padding):
        shown, calibrated = ("{} x {}".format(*sides) for sides in (size, camera.size))
        raise InputError(f"{video}: {shown} pixels, calibrated with {calibrated}")
    return size


class SeenRays(NamedTuple):
    """The landmarks of one video, as rays of its camera."""

    rays: np.ndarray  # (T, 33, 2) x / z and y / z
    seen: np.ndarray  # (T, 33) bool
    tau: float  # τ of eq. 1


def _seen(camera: CalibratedCamera, motion: SolvedMotion) -> SeenRays:
    """Return the rays of a video's landmarks."""
    landmarks, scale = motion.watched.landmarks, motion.pictures.scale
    at = landmarks.indices(BODY_LANDMARKS)
    pixels = landmarks.pixels[:, at].astype(float)
    sure = np.nan_to_num(landmarks.confidence[:, at]) >= LEAST_CONFIDENCE
    seen = np.isfinite(pixels).all(2) & sure
    tall = float(np.median(person_sizes(landmarks)))
    tau = OUTLIER_SCALE * tall / (scale * camera.K[0, 0])
    return SeenRays(camera.rays(pixels / scale), seen, tau)
