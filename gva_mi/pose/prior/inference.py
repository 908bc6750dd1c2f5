"""Infer the prior of a video: how stage 1 errs, and how the person moves.

Before any image is used, white errors and outliers can be inferred from stage 1 alone, because
people cannot move like that (:func:`prior_from_stage1`). Errors that last look like motion. Images
then correct them, most reliably about the line of sight, and the corrections show how large they
are (:func:`prior_from_corrections`). The error model goes into the record of the refinement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from gva_mi.core.cpu import sqrt
from gva_mi.pose.prior import motion
from gva_mi.pose.prior.camera_tilt import TiltPrior
from gva_mi.pose.prior.error_model import GROUPS, Stage1ErrorModel, fit_slow_part, white_level
from gva_mi.pose.prior.ground import Ground
from gva_mi.pose.prior.process import ProcessPrior
from gva_mi.pose.stage1 import Stage1

# Lasting errors before images have shown them. They are small, because a motion of a few degrees
# must not be taken for an error. Only videos too short to infer anything keep them.
TURN = Stage1ErrorModel(white=0.0, slow=0.05, memory=6.0)  # radians
PLACE = {
    "aside": Stage1ErrorModel(0.0, 0.02, 6.0),
    "depth": Stage1ErrorModel(0.0, 0.05, 6.0),
}  # metres

AXES: Mapping[str, tuple[int, ...]] = {"aside": (0, 1), "depth": (2,)}  # the camera's
PELVIS = list(GROUPS["pelvis"])
JOINTS = [i for name, group in GROUPS.items() if name != "pelvis" for i in group]
LEAST_SLOW = 0.5  # least slow error of a group, relative to the mean over all groups


class PriorTerm(Protocol):
    """How improbable a motion is without any image."""

    def energy(self, rotations: Tensor, transl: Tensor, times: Tensor) -> Tensor:
        """Return nats, differentiable, of poses (n, J, 3) and (n, 3) in frames of numbers (n,)."""
        ...


@dataclass(frozen=True)
class PosePrior:
    """The prior of all corrections of a clip."""

    # stage 1's errors: of groups of joints in radians, of the position in metres
    noise: Mapping[str, Stage1ErrorModel]
    pelvis: ProcessPrior  # of one joint, which may turn steadily
    joints: ProcessPrior  # of all others but the face, in the order of ``JOINTS``
    place: ProcessPrior  # of the person's position in the camera's axes; it may change steadily
    tilt: TiltPrior | None  # its nats are a mean over the frames; None: the estimator is known
    ground: Ground | None = None  # its nats are of the whole clip; None before it is fitted


def prior_from_stage1(
    stage1: Stage1, known: Mapping[str, Stage1ErrorModel] | None = None
) -> PosePrior:
    """Infer white errors and the speed of the motion from stage 1 alone.

    What is ``known`` of the estimator, by group, is not inferred.
    """
    turns, shifts = stage1.steps(stage1.pose)
    noise = {
        name: replace(TURN, white=white_level(turns[:, list(group)]))
        for name, group in GROUPS.items()
    }
    for name, axes in AXES.items():
        noise[name] = replace(PLACE[name], white=white_level(shifts[:, list(axes), None]))
    if known is not None:
        largest = lambda name: max(known[name].white, noise[name].white)
        noise |= {name: replace(known[name], white=largest(name)) for name in known}
    process = lambda *given: ProcessPrior.of_stage1(stage1.times, *given)
    return PosePrior(
        noise,
        process(turns[:, PELVIS], _by_joint(noise, PELVIS), True),
        process(turns[:, JOINTS], _by_joint(noise, JOINTS)),
        process(shifts[..., None], _by_axis(noise), True),
        TiltPrior.of(stage1, stage1.pose.rotations) if known is None else None,
    )


def prior_from_corrections(
    before: PosePrior, stage1: Stage1, turns: Tensor, moves: Tensor
) -> PosePrior:
    """Infer the prior from corrections that images made under a weaker one.

    The turns (n, J, 3) radians and the moves (n, 3) metres are in the camera's axes.
    """
    noise = _noise(before.noise, stage1.times, turns, moves)
    noise |= {name: model for name, model in before.noise.items() if model.known}
    pose = stage1.corrected(range(len(moves)), turns, moves)
    steps, shifts = stage1.steps(pose)
    root, sideways = steps[:, PELVIS], stage1.in_camera(steps, slice(0, -1))[:, JOINTS, 2:]
    return PosePrior(
        noise,
        updated_process(before.pelvis, _by_joint(noise, PELVIS), turns[:, PELVIS], root),
        updated_process(before.joints, _by_joint(noise, JOINTS), turns[:, JOINTS], sideways),
        updated_process(before.place, _by_axis(noise), moves[..., None], shifts[..., None]),
        None if before.tilt is None else TiltPrior.of(stage1, pose.rotations),
    )


def updated_process(
    before: ProcessPrior, error_models: list[Stage1ErrorModel], corrections: Tensor, steps: Tensor
) -> ProcessPrior:
    """Update a process after corrections (n, C, d) have shown more, with C updated error models.

    ``steps`` (n - 1, C, ...) lead from frame to frame, in the coordinates that images show.
    """
    changes = before.changes(steps)
    found = motion.mean_speed(changes, before.times[: len(changes)])
    updated = replace(before, error_models=error_models).with_speeds(found)
    speeds = torch.where(before.known, before.square_speed, updated.square_speed)
    return replace(updated, square_speed=speeds).with_outlier_factors(corrections)


def _noise(
    before: Mapping[str, Stage1ErrorModel], times: Tensor, turns: Tensor, moves: Tensor
) -> dict[str, Stage1ErrorModel]:
    """Infer stage 1's error models, group by group, from corrections in the camera's axes."""
    seen = {name: turns[:, list(group), 2] for name, group in GROUPS.items()}  # line of sight
    seen |= {name: moves[:, list(axes)] for name, axes in AXES.items()}
    found = {
        name: fit_slow_part(-errors, times, before[name].white, before[name])
        for name, errors in seen.items()
    }
    # A group that is small in the image is corrected little, which does not prove small errors.
    least = LEAST_SLOW * sqrt(torch.tensor([found[name].slow for name in GROUPS]).square().mean())
    for name in GROUPS:
        found[name] = replace(found[name], slow=max(found[name].slow, float(least)))
    return found


def _by_joint(
    noise: Mapping[str, Stage1ErrorModel], joints: Sequence[int]
) -> list[Stage1ErrorModel]:
    kind = {i: name for name, group in GROUPS.items() for i in group}
    return [noise[kind[i]] for i in joints]


def _by_axis(noise: Mapping[str, Stage1ErrorModel]) -> list[Stage1ErrorModel]:
    return [noise[name] for name, axes in AXES.items() for _ in axes]
