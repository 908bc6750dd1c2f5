"""Learn how stage 1 errs: the prior of stage 2, from rendered videos with ground truth.

    python -m tools.stage1_errors SUBJECT ...

prints the table of :mod:`gva_mi.prior.error_model`.

Each subject is a folder whose ``poses.npz`` the solver of :mod:`gva_mi.stage1` found, and whose
person has the body that it fitted. An error ``e`` is what would correct a pose, in the camera's
axes. The products of one coordinate in frames ``k`` and ``l``, over the joints of a group, follow

1. ``e_k e_l = (slow² + lag² (v_k² + v_l²) / 2) κ(|k - l| / memory) + bias² + noise``

with ``v``, ``κ`` and the memory of the prior: linear in three squares that are not negative. Least
squares weigh a product by ``w / (S_k S_l)``, with the size ``S`` that the model gives; and a video
by the weight ``w`` of Student's t distribution, so that one video that went wrong does not decide
the prior of all. Both follow the fit, which is repeated.
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
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.prior.error_model import FREEDOM, GROUPS, STAGE1_FPS, STAGE1_MEMORY, Stage1ErrorModel
from gva_mi.prior.inference import AXES
from gva_mi.prior.stage1_poses import Stage1, turns_between
from gva_mi.subject.folder import POSES
from gva_mi.subject.ground_truth import load_ground_truth

FRAME_LAGS = (0, 1, 2, 4, 8, 16, 24)  # frames between k and l; chosen: up to a second
REWEIGHTINGS = 12  # rounds of the weights; chosen: they have settled
LEAST_SLOW_SHARE = 0.2  # of the whole error; chosen: a joint that rests errs, too


class SolvedTrack(NamedTuple):
    """The errors of one video in a group of C joints or coordinates, each a vector of d."""

    errors: Tensor  # (T, C, d) radians or metres
    steps: Tensor  # (T - 1, C, d) of stage 1


class Rows(NamedTuple):
    """Eq. 1 for N pairs of frames."""

    products: np.ndarray  # (N,)
    terms: np.ndarray  # (N, 3) of slow², lag² and bias²
    recording: np.ndarray  # (N,) number of the video
    lag: np.ndarray  # (N,) frames


def solver_errors(subject: Path) -> dict[str, SolvedTrack]:
    """Return what would correct the poses of a video, by group, in the camera's axes.

    Raises:
        InputError: the person has another body.
    """
    body = load_body()
    truth = load_ground_truth(subject / "truth", body)
    if truth.foreign:
        raise InputError(f"{subject}: expected a person with the built-in body")
    pose, shape = load_poses(subject / POSES)
    stage1 = Stage1.of(pose, range(len(pose)), truth.cameras[0])
    turns = stage1.in_camera(turns_between(pose.rotations, truth.pose.rotations))
    pelvis = body.rest(truth.shape).joints[0] - body.rest(shape).joints[0]
    moves = (truth.pose.transl - pose.transl + pelvis) @ stage1.R_camera_world.T
    turned, moved = stage1.steps(pose)
    joints = {name: (turns[:, list(g)], turned[:, list(g)]) for name, g in GROUPS.items()}
    axes = {name: (moves[:, list(a), None], moved[:, list(a), None]) for name, a in AXES.items()}
    return {name: SolvedTrack(*tracks) for name, tracks in (joints | axes).items()}


def learn(recordings: Iterable[Mapping[str, SolvedTrack]]) -> dict[str, Stage1ErrorModel]:
    """Fit eq. 1 to the errors of several videos, group by group; times in seconds."""
    recordings = list(recordings)
    return {name: _fit([recording[name] for recording in recordings]) for name in (*GROUPS, *AXES)}


def _fit(recordings: list[SolvedTrack]) -> Stage1ErrorModel:
    from scipy.optimize import nnls

    size = (
        float(np.median([float(recording.errors.square().mean()) for recording in recordings]))
        ** 0.5
    )
    rows = _rows(recordings)
    weights = _weights(rows, len(recordings))
    squares, _ = nnls(rows.terms * weights[:, None], rows.products * weights)
    slow, lag, bias = np.sqrt(squares).tolist()
    return Stage1ErrorModel(
        0.0, max(slow, LEAST_SLOW_SHARE * size), STAGE1_MEMORY, bias, lag / STAGE1_FPS
    )


def _weights(rows: Rows, recordings: int) -> np.ndarray:
    """Return the weight (N,) of each row, from the sizes of errors alone (k = l)."""
    from scipy.optimize import nnls

    products, terms, recording = rows.products, rows.terms, rows.recording
    sizes = np.stack([np.ones(len(terms)), terms[:, 1] / terms[:, 0]], axis=1)
    now, of_video = rows.lag == 0, np.ones(recordings)
    square = np.full(len(products), products[now].mean())
    least = LEAST_SLOW_SHARE**2 * square[0]
    for _ in range(REWEIGHTINGS):
        weights = of_video[recording] / square
        found, _ = nnls(sizes[now] * weights[now, None], products[now] * weights[now])
        square = np.maximum(sizes @ found, least)
        ratio = np.bincount(recording[now], products[now] / square[now]) / np.bincount(
            recording[now]
        )
        of_video = (FREEDOM + 1) / (FREEDOM + ratio)
    return of_video[recording] / square


def _rows(recordings: list[SolvedTrack]) -> Rows:
    """Return eq. 1 for all pairs of frames."""
    rows = []
    model = Stage1ErrorModel(
        0.0, 1.0, STAGE1_MEMORY * STAGE1_FPS, 0.0, lag=1.0
    )  # its growth shows the speed
    for number, (errors, steps) in enumerate(recordings):
        times = torch.arange(len(errors))
        growth = torch.stack([model.growth(own, times) for own in steps.unbind(1)], 1)
        square_speed, kernel = growth.square() - 1, model.lasting(times, torch.ones(len(times)))[0]
        for lag in (lag for lag in FRAME_LAGS if lag < len(errors)):
            stop = len(errors) - lag
            product = (errors[lag:] * errors[:stop]).mean(-1).flatten()
            speed = ((square_speed[lag:] + square_speed[:stop]) / 2).flatten()
            kappa, one = torch.full_like(speed, float(kernel[lag])), torch.ones_like(speed)
            rows.append(torch.stack([product, kappa, kappa * speed, one, number * one, lag * one]))
    found = torch.cat(rows, 1).double().numpy()
    return Rows(found[0], found[1:4].T, found[4].astype(int), found[5].astype(int))


def table(errors: Mapping[str, Stage1ErrorModel]) -> Iterator[str]:
    """Yield lines: slow part and bias in degrees or metres, lag in seconds."""
    for name, model in errors.items():
        unit, digits = (1.0, 3) if name in AXES else (np.degrees(1), 1)
        slow, bias = (round(float(unit * x), digits) for x in (model.slow, model.bias))
        yield f'"{name}": ({slow}, {bias}, {round(model.lag, 3)}),'


if __name__ == "__main__":
    torch.set_num_threads(1)
    for line in table(learn(solver_errors(Path(name)) for name in sys.argv[1:])):
        say(line)
