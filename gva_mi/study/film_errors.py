"""Learn how the film solver errs: the prior of stage 2, from rendered films with ground truth.

    python -m gva_mi.study.film_errors SUBJECT ...

prints the table of :mod:`gva_mi.pose.prior.film_errors`.

Each subject is a folder whose ``poses.npz`` the solver of :mod:`gva_mi.pose.film` found, and whose
person has the body that it fitted. An error is what would correct a pose, in the camera's axes. Its
autocovariance at some lags, of a group of joints,

1. ``C_l = median over films of mean_{k, j, c} e_kjc e_(k+l)jc``

is fitted by ``slow² κ(l / memory) + bias²`` of :mod:`gva_mi.pose.prior.error_model`. The median
keeps one film that went wrong from deciding the prior of all.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import load_poses
from gva_mi.body.smplx import load_body
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.data.ground_truth import load_ground_truth
from gva_mi.data.video import POSES
from gva_mi.pose.prior.error_model import GROUPS, Stage1ErrorModel
from gva_mi.pose.prior.inference import AXES
from gva_mi.pose.stage1 import Stage1, turns_between

LAGS = 30  # largest lag of eq. 1, frames
MEMORIES = (3.0, 6.0, 12.0, 24.0)  # frames, candidates


def solver_errors(subject: Path) -> dict[str, Tensor]:
    """Return what would correct the poses of a film, by group, in the camera's axes.

    Returns:
        (T, J, 3) radians of each group of joints; (T, 2) or (T, 1) metres of the pelvis's place.

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
    found = {name: turns[:, list(group)] for name, group in GROUPS.items()}
    return found | {name: moves[:, list(axes)] for name, axes in AXES.items()}


def learn(films: Iterable[Mapping[str, Tensor]]) -> dict[str, Stage1ErrorModel]:
    """Fit eq. 1 to the errors of several films, group by group."""
    films = list(films)
    return {name: _fit([film[name] for film in films]) for name in (*GROUPS, *AXES)}


def _fit(films: list[Tensor]) -> Stage1ErrorModel:
    from scipy.optimize import nnls

    lags = np.arange(min(LAGS, min(map(len, films)) // 2))
    C = np.median([[float((e[lag:] * e[: len(e) - lag]).mean()) for lag in lags] for e in films], 0)
    fits = []
    for memory in MEMORIES:
        x = 3**0.5 * lags / memory
        (slow, bias), off = nnls(np.stack([(1 + x) * np.exp(-x), np.ones_like(x)], 1), C)
        fits.append((off, memory, slow, bias))
    _, memory, slow, bias = min(fits)
    return Stage1ErrorModel(0.0, float(slow**0.5), memory, float(bias**0.5))


def table(errors: Mapping[str, Stage1ErrorModel]) -> Iterator[str]:
    """Yield lines: slow part and bias, in degrees or metres, and the memory."""
    for name, model in errors.items():
        unit, digits = (1.0, 3) if name in AXES else (np.degrees(1), 1)
        slow, bias = (round(float(unit * x), digits) for x in (model.slow, model.bias))
        yield f'"{name}": ({slow}, {bias}, {model.memory}),'


if __name__ == "__main__":
    torch.set_num_threads(1)
    for line in table(learn(solver_errors(Path(name)) for name in sys.argv[1:])):
        say(line)
