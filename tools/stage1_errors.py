"""Measure how stage 1 errs on rendered videos with ground truth: the prior of stage 2.

    python -m tools.stage1_errors SUBJECT ...

prints the table of :mod:`gva_mi.prior.error_model`.

Each subject is a folder whose ``poses.npz`` was made by the solver of :mod:`gva_mi.stage1`, and
whose person has the built-in body. An error ``e`` is the correction that a pose needs, in the
camera's axes. The products of one coordinate in frames ``k`` and ``l``, over the joints of a group,
follow

1. ``e_k e_l = (slow² + lag² (v_k² + v_l²) / 2) κ(|k - l| / memory) + bias² + noise``

with ``v``, ``κ`` and the memory of the prior. This is linear in three squares, which are fitted by
non-negative least squares. A product has the weight ``w / (S_k S_l)``, with the size ``S`` of the
errors by the model. ``w`` is the weight of a video by Student's t distribution, so that one video
that went wrong does not decide the prior of all. Both weights follow from the fit, which is
repeated.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import load_poses
from gva_mi.body.smplx import load_body
from gva_mi.body.so3 import turns_between
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.prior.error_model import (
    GROUPS,
    STAGE1_MEMORY,
    STUDENT_DOF,
    Stage1ErrorModel,
)
from gva_mi.prior.inference import PLACE_AXES
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.subject.fingerprint import prepared_from
from gva_mi.subject.folder import POSES
from gva_mi.subject.ground_truth import load_ground_truth

LAGS = (0, 1, 2, 4, 8, 16, 24)  # frames between k and l; chosen: beyond the memory
WEIGHT_ROUNDS = 12  # updates of the weights; chosen by eye
SLOW_FLOOR = 0.2  # least slow part, relative to the whole error; chosen: a resting joint errs, too


class SolvedTrack(NamedTuple):
    """Errors of one video in a group of C joints or coordinates, each a vector of d."""

    errors: Tensor  # (T, C, d) radians or metres
    steps: Tensor  # (T - 1, C, d) of the stage-1 poses from frame to frame, radians or metres
    seconds: Tensor  # (T,) times of the frames


class Products(NamedTuple):
    """Both sides of eq. 1 for N products of errors."""

    values: np.ndarray  # (N,) e_k e_l
    terms: np.ndarray  # (N, 3) factors of slow², lag² and bias²
    videos: np.ndarray  # (N,) number of the video
    lags: np.ndarray  # (N,) frames between k and l


def solver_errors(subject: Path) -> dict[str, SolvedTrack]:
    """Return the errors of a video's poses by group, in the camera's axes.

    Raises:
        InputError: the person does not have the built-in body, or no rate of the video is known.
    """
    body = load_body()
    truth = load_ground_truth(subject / "truth", body)
    if truth.foreign:
        raise InputError(f"{subject}: expected a person with the built-in body")
    _, fps = prepared_from(subject)
    if fps is None:
        raise InputError(f"{subject}: prepare.json must hold the frames a second of its video")
    pose, shape = load_poses(subject / POSES)
    stage1 = Stage1Poses.of(pose, range(len(pose)), truth.cameras[0])
    turns = stage1.to_camera_axes(turns_between(pose.rotations, truth.pose.rotations))
    pelvis = body.rest(truth.shape).joints[0] - body.rest(shape).joints[0]
    moves = (truth.pose.transl - pose.transl + pelvis) @ stage1.R_camera_world.T
    turned, moved = stage1.steps(pose)
    joints = {name: (turns[:, list(g)], turned[:, list(g)]) for name, g in GROUPS.items()}
    axes = {k: (moves[:, list(a), None], moved[:, list(a), None]) for k, a in PLACE_AXES.items()}
    seconds = torch.arange(len(pose)) / fps
    return {name: SolvedTrack(*tracks, seconds) for name, tracks in (joints | axes).items()}


def learn(videos: Iterable[Mapping[str, SolvedTrack]]) -> dict[str, Stage1ErrorModel]:
    """Fit eq. 1 to the errors of several videos, group by group; times in seconds."""
    videos = list(videos)
    return {name: _fit([video[name] for video in videos]) for name in (*GROUPS, *PLACE_AXES)}


def _fit(tracks: list[SolvedTrack]) -> Stage1ErrorModel:
    from scipy.optimize import nnls

    size = float(np.median([float(track.errors.square().mean()) for track in tracks])) ** 0.5
    products = _products(tracks)
    weights = _weights(products, len(tracks))
    squares, _ = nnls(products.terms * weights[:, None], products.values * weights)
    slow, lag, bias = np.sqrt(squares).tolist()
    slow = max(slow, SLOW_FLOOR * size)
    return Stage1ErrorModel(0.0, slow, STAGE1_MEMORY, bias, lag)


def _weights(products: Products, videos: int) -> np.ndarray:
    """Return the weight (N,) of each product, from the sizes of errors alone (k = l)."""
    from scipy.optimize import nnls

    values, terms, video, lags = products
    sizes = np.stack([np.ones(len(terms)), terms[:, 1] / terms[:, 0]], axis=1)
    now, of_video = lags == 0, np.ones(videos)
    square = np.full(len(values), values[now].mean())
    floor = SLOW_FLOOR**2 * square[0]
    for _ in range(WEIGHT_ROUNDS):
        weights = of_video[video] / square
        found, _ = nnls(sizes[now] * weights[now, None], values[now] * weights[now])
        square = np.maximum(sizes @ found, floor)
        total = np.bincount(video[now], values[now] / square[now])
        ratio = total / np.bincount(video[now])
        of_video = (STUDENT_DOF + 1) / (STUDENT_DOF + ratio)
    return of_video[video] / square


def _products(tracks: list[SolvedTrack]) -> Products:
    """Return the products of errors of several videos, at all :data:`LAGS`."""
    rows = []
    # With this model growth² - 1 is the square speed.
    model = Stage1ErrorModel(0.0, 1.0, STAGE1_MEMORY, 0.0, lag=1.0)
    for number, (errors, steps, times) in enumerate(tracks):
        growth = torch.stack([model.growth(own, times) for own in steps.unbind(1)], 1)
        square_speed = growth.square() - 1
        kernel = model.covariance_without_white(times, torch.ones(len(times)))[0]
        for lag in (lag for lag in LAGS if lag < len(errors)):
            stop = len(errors) - lag
            product = (errors[lag:] * errors[:stop]).mean(-1).flatten()
            speed = ((square_speed[lag:] + square_speed[:stop]) / 2).flatten()
            kappa, one = torch.full_like(speed, float(kernel[lag])), torch.ones_like(speed)
            rows.append(torch.stack([product, kappa, kappa * speed, one, number * one, lag * one]))
    found = torch.cat(rows, 1).double().numpy()
    return Products(found[0], found[1:4].T, found[4].astype(int), found[5].astype(int))


def table(errors: Mapping[str, Stage1ErrorModel]) -> Iterator[str]:
    """Yield the lines of the table: slow part and bias in degrees or metres, lag in seconds."""
    for name, model in errors.items():
        unit, digits = (1.0, 3) if name in PLACE_AXES else (np.degrees(1), 1)
        slow, bias = (round(float(unit * x), digits) for x in (model.slow, model.bias))
        yield f'"{name}": ({slow}, {bias}, {round(model.lag, 3)}),'


if __name__ == "__main__":
    torch.set_num_threads(1)
    for line in table(learn(solver_errors(Path(name)) for name in sys.argv[1:])):
        say(line)
