"""Stage 1 of real films: what one camera says, against what several calibrated ones see.

Real people come without ground truth. Where calibrated cameras film one person at the same time,
each film alone gives poses, a lens and the direction up, and the landmarks of all films give points
in space (:mod:`gva_mi.study.calibrated`). These err by a few centimetres, and a landmark is not
quite the joint that it is named after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.errors import InputError
from gva_mi.data.landmarks import BODY, Landmarks
from gva_mi.pose.film.landmark_noise import BONES, person_sizes
from gva_mi.pose.film.prepare_film import FilmOptions, SolvedMotion, motion_of_film
from gva_mi.pose.film.rig import LandmarkRig
from gva_mi.pose.film.solver import SolvedFilm
from gva_mi.study.calibrated import CalibratedCamera, read_calibration, triangulate

APART = 0.01  # τ of triangulation, of a person's height
SEEN = 0.5  # least confidence of a landmark
COMPARED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True)
class OneCamera:
    """What one film says, against the points of all of them; lengths in mm, means over frames."""

    camera: str
    lens: float  # focal length, pixels of the film
    true_lens: float
    points: float  # median distance of landmarks from the points of all films, pixels of the film
    up: float  # degrees between the directions up
    joints: float
    depth: float  # of the hips' middle, beyond the points'
    aligned: float  # with the hips' middle in the same place
    aside: float  # of that, across the line of sight
    network: float  # of the network's own metres, aligned, scaled as fits best
    by_joint: dict[str, float]  # aligned


@dataclass(frozen=True)
class BoneFound:
    """How a network's depths along a bone follow the true ones: eq. 3 of landmark_noise.

    Its ``gain`` and ``bias`` (mm) by least squares over all films, ``error`` (mm) what is left, and
    what stage 1 takes them to be.
    """

    bone: str
    gain: float
    used_gain: float
    bias: float
    used_bias: float
    error: float


def bones_found(
    cameras: Sequence[CalibratedCamera],
    films: Sequence[tuple[SolvedFilm, Landmarks]],
    body: BodyModel,
    X: np.ndarray,
) -> list[BoneFound]:
    """Compare depths along the bones of the body with points X (T, 33, 3) of the world."""
    rig = LandmarkRig.of(body, list(BODY))
    true, seen = [], []
    for camera, (solved, landmarks) in zip(cameras, films, strict=True):
        scale = rig.scale(landmarks, solved.shape.betas)
        true.append(camera.place(X)[..., 2])
        seen.append(scale * landmarks.metric[:, landmarks.indices(BODY), 2].astype(float))
    true, seen, found = np.concatenate(true), np.concatenate(seen), []
    for (one, other), used in BONES.items():
        sides = [(one, other)] if {one, other} <= set(BODY) else [
            tuple(name if name in BODY else f"{side}_{name}" for name in (one, other))
            for side in SIDES
        ]  # fmt: skip
        if not set(sides[0]) <= set(BODY):  # of a hand
            continue
        pairs = [[BODY.index(name) for name in pair] for pair in sides]
        z, m = (np.concatenate([x[:, j] - x[:, i] for i, j in pairs]) for x in (true, seen))
        known = np.isfinite(z) & np.isfinite(m)
        gain, bias = np.polyfit(z[known], m[known], 1)
        left = np.std(m[known] - gain * z[known])
        numbers = gain, used.gain, 1e3 * bias, 1e3 * used.bias, 1e3 * left
        found.append(BoneFound(f"{one} to {other}", *map(float, numbers)))
    return found


def compare(
    camera: CalibratedCamera,
    solved: SolvedFilm,
    landmarks: Landmarks,
    body: BodyModel,
    X: np.ndarray,
    up: np.ndarray,
) -> OneCamera:
    """Compare one film's stage 1 with points X (T, 33, 3) of the world, in the order of BODY.

    ``up`` (3,) is the world's direction up.
    """
    names = [f"{side}_{name}" for name in COMPARED for side in SIDES]
    true = 1e3 * camera.place(X)[:, [BODY.index(name) for name in names]]
    T = np.asarray(solved.camera.T_camera_world)
    joints = body(solved.pose, solved.shape).joints[:, [JOINTS.index(name) for name in names]]
    found = 1e3 * (joints.double().numpy() @ T[:3, :3].T + T[:3, 3])
    guessed = 1e3 * landmarks.metric[:, landmarks.indices(names)].astype(float)
    hips = [names.index(f"{side}_hip") for side in SIDES]
    centred = lambda points: points - points[:, hips].mean(1, keepdims=True)
    length = lambda off: float(np.nanmean(np.linalg.norm(off, axis=-1)))
    off, own = centred(found) - centred(true), centred(guessed)
    scale = np.nansum(own * centred(true)) / np.nansum(np.where(np.isnan(true), 0, own**2))
    sides = lambda name: [k for k, full in enumerate(names) if full.endswith(name)]
    factor, local = solved.camera.width / camera.size[0], camera.place(X)
    rays = camera.rays(landmarks.pixels[:, landmarks.indices(BODY)].astype(float) / factor)
    beside = np.linalg.norm(local[..., :2] / local[..., 2:] - rays, axis=-1)
    angle = np.degrees(np.arccos(np.clip(T[:3, 1] @ (camera.R @ up), -1, 1)))
    return OneCamera(
        camera=camera.name,
        lens=float(solved.camera.fx),
        true_lens=float(factor * camera.K[0, 0]),
        points=float(np.nanmedian(factor * camera.K[0, 0] * beside)),
        up=float(angle),
        joints=length(found - true),
        depth=float(np.nanmean((found - true)[:, hips, 2])),
        aligned=length(off),
        aside=length(off[..., :2]),
        network=length(scale * own - centred(true)),
        by_joint={name: length(off[:, sides(name)]) for name in COMPARED},
    )


def multiview_table(rows: Sequence[OneCamera]) -> list[list[str]]:
    """Return the lines of a table, heads first; lengths in mm."""
    head = ["camera", "lens, px", "true", "points, px", "up, degrees", "joints", "depth", "aligned",
            "aside", "network", *COMPARED]  # fmt: skip
    found = [
        [row.camera, *(f"{x:.0f}" for x in (row.lens, row.true_lens, row.points)), f"{row.up:.1f}"]
        + [f"{x:.0f}" for x in (row.joints, row.depth, row.aligned, row.aside, row.network)]
        + [f"{row.by_joint[name]:.0f}" for name in COMPARED]
        for row in rows
    ]
    return [head, *found]


def bones_table(rows: Sequence[BoneFound]) -> list[list[str]]:
    """Return the lines of a table, heads first; lengths in mm."""
    head = ["depths of the network along", "gain", "used", "bias", "used", "error"]
    found = [
        [row.bone, *(f"{x:.2f}" for x in (row.gain, row.used_gain))]
        + [f"{x:.0f}" for x in (row.bias, row.used_bias, row.error)]
        for row in rows
    ]
    return [head, *found]


def multiview(
    folder: Path,
    calibration: Path | None,
    body: BodyModel,
    options: FilmOptions,
    up: np.ndarray,
    known_lens: bool,
    progress: Progress | None = None,
) -> tuple[list[OneCamera], list[BoneFound]]:
    """Solve the film of each camera alone, and compare it with all of them.

    Args:
        folder: of the films, which start at the same time and have the same frames.
        calibration: of the cameras; None: the one in the folder.
        body: of the poses.
        options: of the films.
        up: (3,) the world's direction up.
        known_lens: whether each film is solved with its true focal length.
        progress: called as the work goes on.

    Raises:
        InputError: a file is missing, or films differ in their frames.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected films that are named after cameras")
    cameras = read_calibration(calibration or _calibration_in(folder))
    films = [_film_of(folder, camera) for camera in cameras]
    motions: list[SolvedMotion] = []
    for k, (film, camera) in enumerate(zip(films, cameras, strict=True)):
        scale = min(1.0, options.side / min(camera.size))
        lens = str(scale * camera.K[0, 0]) if known_lens else None
        part = part_of_progress(progress, k, 1, len(films))
        motions.append(motion_of_film(film, options, body, lens=lens, progress=part))
        if motions[-1].pictures.numbers != motions[0].pictures.numbers:
            raise InputError(
                f"{film}: its pictures are not at the same times as those of {films[0]}; expected "
                "films that start together and have one rate and length"
            )
    rays, seen, tau = (np.stack(x) for x in zip(*map(_seen, cameras, motions), strict=True))
    X = triangulate(cameras, rays.reshape(len(films), -1, 2), seen.reshape(len(films), -1), tau)
    X = X.reshape(*rays.shape[1:3], 3)
    found = [(motion.solved, motion.watched.landmarks) for motion in motions]
    rows = [
        compare(camera, *film, body, X, up) for camera, film in zip(cameras, found, strict=True)
    ]
    return rows, bones_found(cameras, found, body, X)


def _calibration_in(folder: Path) -> Path:
    found = sorted(folder.glob("*.toml"))
    if len(found) != 1:
        raise InputError(f"{folder}: expected one calibration, *.toml, found {len(found)}")
    return found[0]


def _film_of(folder: Path, camera: CalibratedCamera) -> Path:
    """Return the film of a camera: the file in a folder that is named after it."""
    named = sorted(path for path in folder.iterdir() if path.stem == camera.name)
    films = [path for path in named if path.suffix != ".toml"]
    if len(films) != 1:
        raise InputError(
            f"{folder}: expected one film of the camera {camera.name}, of that name, "
            f"found {len(films)}"
        )
    return films[0]


def _seen(camera: CalibratedCamera, motion: SolvedMotion) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the rays of landmarks (T, 33, 2), where they were seen (T, 33), and τ."""
    landmarks, scale = motion.watched.landmarks, motion.pictures.scale
    at = landmarks.indices(BODY)
    pixels = landmarks.pixels[:, at].astype(float)
    seen = np.isfinite(pixels).all(2) & (np.nan_to_num(landmarks.confidence[:, at]) >= SEEN)
    tall = float(np.median(person_sizes(landmarks)))
    return camera.rays(pixels / scale), seen, APART * tall / (scale * camera.K[0, 0])
