"""Learn how the film solver errs: the prior of stage 2, from rendered films with ground truth.

    python -m tools.film_errors SUBJECT ...

prints the table of :mod:`gva_mi.pose.prior.error_model`.

Each subject is a folder whose ``poses.npz`` the solver of :mod:`gva_mi.pose.film` found, and whose
person has the body that it fitted. An error ``e`` is what would correct a pose, in the camera's
axes. The products of one coordinate in frames ``k`` and ``l``, over the joints of a group, follow

1. ``e_k e_l = (slow² + lag² (v_k² + v_l²) / 2) κ(|k - l| / memory) + bias² + noise``

with ``v``, ``κ`` and the memory of the prior: linear in three squares that are not negative. Least
squares weigh a product by ``w / (S_k S_l)``, with the size ``S`` that the model gives; and a film
by the weight ``w`` of Student's t distribution, so that one film that went wrong does not decide
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
from gva_mi.data.folder import POSES
from gva_mi.data.ground_truth import load_ground_truth
from gva_mi.pose.prior.error_model import FILM_FPS, FILM_MEMORY, FREEDOM, GROUPS, Stage1ErrorModel
from gva_mi.pose.prior.inference import AXES
from gva_mi.pose.stage1 import Stage1, turns_between

LAGS = (0, 1, 2, 4, 8, 16, 24)  # frames between k and l
ROUNDS = 12  # of the weights
LEAST_SLOW = 0.2  # relative to the whole error: a joint that rests errs, too


class FilmTrack(NamedTuple):
    """The errors of one film in a group of C joints or coordinates, each a vector of d."""

    errors: Tensor  # (T, C, d) radians or metres
    steps: Tensor  # (T - 1, C, d) of stage 1


def solver_errors(subject: Path) -> dict[str, FilmTrack]:
    """Return what would correct the poses of a film, by group, in the camera's axes.

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
    return {name: FilmTrack(*tracks) for name, tracks in (joints | axes).items()}


def learn(films: Iterable[Mapping[str, FilmTrack]]) -> dict[str, Stage1ErrorModel]:
    """Fit eq. 1 to the errors of several films, group by group; times in seconds."""
    films = list(films)
    return {name: _fit([film[name] for film in films]) for name in (*GROUPS, *AXES)}


def _fit(films: list[FilmTrack]) -> Stage1ErrorModel:
    from scipy.optimize import nnls

    size = float(np.median([float(film.errors.square().mean()) for film in films])) ** 0.5
    rows = products, terms, _, _ = _rows(films)
    weights = _weights(rows, len(films))
    squares, _ = nnls(terms * weights[:, None], products * weights)
    slow, lag, bias = np.sqrt(squares).tolist()
    return Stage1ErrorModel(0.0, max(slow, LEAST_SLOW * size), FILM_MEMORY, bias, lag / FILM_FPS)


def _weights(rows: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], films: int) -> np.ndarray:
    """Return the weight (N,) of each row, from the sizes of errors alone (k = l)."""
    from scipy.optimize import nnls

    products, terms, film, lags = rows
    sizes = np.stack([np.ones(len(terms)), terms[:, 1] / terms[:, 0]], axis=1)
    now, of_film = lags == 0, np.ones(films)
    square = np.full(len(products), products[now].mean())
    least = LEAST_SLOW**2 * square[0]
    for _ in range(ROUNDS):
        weights = of_film[film] / square
        found, _ = nnls(sizes[now] * weights[now, None], products[now] * weights[now])
        square = np.maximum(sizes @ found, least)
        ratio = np.bincount(film[now], products[now] / square[now]) / np.bincount(film[now])
        of_film = (FREEDOM + 1) / (FREEDOM + ratio)
    return of_film[film] / square


def _rows(films: list[FilmTrack]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return eq. 1: products (N,), the terms of its squares (N, 3), numbers of films, and lags."""
    rows = []
    model = Stage1ErrorModel(
        0.0, 1.0, FILM_MEMORY * FILM_FPS, 0.0, lag=1.0
    )  # its growth shows the speed
    for number, (errors, steps) in enumerate(films):
        times = torch.arange(len(errors))
        growth = torch.stack([model.growth(own, times) for own in steps.unbind(1)], 1)
        square_speed, kernel = growth.square() - 1, model.lasting(times, torch.ones(len(times)))[0]
        for lag in (lag for lag in LAGS if lag < len(errors)):
            stop = len(errors) - lag
            product = (errors[lag:] * errors[:stop]).mean(-1).flatten()
            speed = ((square_speed[lag:] + square_speed[:stop]) / 2).flatten()
            kappa, one = torch.full_like(speed, float(kernel[lag])), torch.ones_like(speed)
            rows.append(torch.stack([product, kappa, kappa * speed, one, number * one, lag * one]))
    found = torch.cat(rows, 1).double().numpy()
    return found[0], found[1:4].T, found[4].astype(int), found[5].astype(int)


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
