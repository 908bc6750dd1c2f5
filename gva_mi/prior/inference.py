"""Infer the prior of a video: how stage 1 errs, and how the person moves.

White errors and outliers can be inferred from stage 1 alone, because people cannot move like that
(:func:`prior_from_stage1`). Slow errors cannot: they look like motion. Images correct them, most
reliably about the line of sight, and the corrections show how large slow errors are
(:func:`prior_from_corrections`). The refinement's record holds the error model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from gva_mi.core.cpu import sqrt
from gva_mi.prior.camera_tilt import TiltPrior
from gva_mi.prior.error_model import GROUPS, Stage1ErrorModel, fit_slow_part, white_level
from gva_mi.prior.ground import Ground
from gva_mi.prior.process import ProcessPrior, mean_square_speed
from gva_mi.prior.stage1_poses import Stage1Poses

# Error models before images have shown slow errors; videos too short to infer anything keep them.
# Chosen small, because a motion of a few degrees must not be taken for an error.
GUESSED_TURN_ERRORS = Stage1ErrorModel(white=0.0, slow=0.05, memory=6.0)  # radians, frames
GUESSED_PLACE_ERRORS = {  # metres, frames
    "aside": Stage1ErrorModel(white=0.0, slow=0.02, memory=6.0),
    "depth": Stage1ErrorModel(white=0.0, slow=0.05, memory=6.0),
}
# Least slow error of a group, relative to the quadratic mean over all groups. Chosen: a group that
# is small in the image is corrected little, which does not prove small errors.
SLOW_FLOOR = 0.5

PLACE_AXES: Mapping[str, tuple[int, ...]] = {"aside": (0, 1), "depth": (2,)}  # the camera's
PELVIS = list(GROUPS["pelvis"])
CORRECTED_JOINTS = [i for name, group in GROUPS.items() if name != "pelvis" for i in group]


class PriorTerm(Protocol):
    """A term of the prior: how improbable a motion is without any image."""

    def energy(self, rotations: Tensor, transl: Tensor, times: Tensor) -> Tensor:
        """Return the energy in nats, differentiable.

        Args:
            rotations: (n, J, 3) axis-angle.
            transl: (n, 3) metres, world.
            times: (n,) frame numbers.
        """
        ...


@dataclass(frozen=True)
class PosePrior:
    """The prior of all corrections of a clip.

    Attributes:
        error_models: of stage 1, by group of joints (radians) and axis of the position (metres).
        pelvis: process of one joint, which may turn steadily.
        joints: process of ``CORRECTED_JOINTS``.
        place: process of the person's position in the camera's axes, which may change steadily.
        tilt: camera-locked tilt, a mean over the frames; None: the estimator's errors are known.
        ground: ground contact, a sum over the clip; None before it is fitted.
    """

    error_models: Mapping[str, Stage1ErrorModel]
    pelvis: ProcessPrior
    joints: ProcessPrior
    place: ProcessPrior
    tilt: TiltPrior | None
    ground: Ground | None = None


def prior_from_stage1(
    stage1: Stage1Poses, known: Mapping[str, Stage1ErrorModel] | None = None
) -> PosePrior:
    """Infer white errors and the speed of the motion from stage 1 alone.

    Args:
        stage1: poses of n frames.
        known: error models of the estimator, by group, which are not inferred; None: unknown.
    """
    turns, shifts = stage1.steps(stage1.pose)
    models = {
        name: replace(GUESSED_TURN_ERRORS, white=white_level(turns[:, list(group)]))
        for name, group in GROUPS.items()
    }
    for name, axes in PLACE_AXES.items():
        white = white_level(shifts[:, list(axes), None])
        models[name] = replace(GUESSED_PLACE_ERRORS[name], white=white)
    if known is not None:
        largest = lambda name: max(known[name].white, models[name].white)
        models |= {name: replace(known[name], white=largest(name)) for name in known}
    process = lambda *given: ProcessPrior.of_stage1(stage1.times, *given)
    return PosePrior(
        models,
        process(turns[:, PELVIS], _of_joints(models, PELVIS), True),
        process(turns[:, CORRECTED_JOINTS], _of_joints(models, CORRECTED_JOINTS)),
        process(shifts[..., None], _of_axes(models), True),
        TiltPrior.of(stage1, stage1.pose.rotations) if known is None else None,
    )


def prior_from_corrections(
    before: PosePrior, stage1: Stage1Poses, turns: Tensor, moves: Tensor
) -> PosePrior:
    """Infer the prior from corrections that images made under a weaker prior.

    Args:
        before: the weaker prior.
        stage1: poses of n frames.
        turns: (n, J, 3) corrections of rotations in the camera's axes, radians.
        moves: (n, 3) corrections of positions in the camera's axes, metres.
    """
    models = _inferred_models(before.error_models, stage1.times, turns, moves)
    models |= {name: model for name, model in before.error_models.items() if model.known}
    pose = stage1.corrected(range(len(moves)), turns, moves)
    steps, shifts = stage1.steps(pose)
    root = steps[:, PELVIS]
    sideways = stage1.to_camera_axes(steps, slice(0, -1))[:, CORRECTED_JOINTS, 2:]
    return PosePrior(
        models,
        updated_process(before.pelvis, _of_joints(models, PELVIS), turns[:, PELVIS], root),
        updated_process(
            before.joints,
            _of_joints(models, CORRECTED_JOINTS),
            turns[:, CORRECTED_JOINTS],
            sideways,
        ),
        updated_process(before.place, _of_axes(models), moves[..., None], shifts[..., None]),
        None if before.tilt is None else TiltPrior.of(stage1, pose.rotations),
    )


def updated_process(
    before: ProcessPrior, error_models: list[Stage1ErrorModel], corrections: Tensor, steps: Tensor
) -> ProcessPrior:
    """Update the speeds and outlier factors of a process from corrections.

    Args:
        before: the process of C joints or coordinates.
        error_models: C updated ones.
        corrections: (n, C, d).
        steps: (n - 1, C, ...) of the corrected motion from frame to frame, in the coordinates that
            images show.
    """
    changes = before.changes(steps)
    found = mean_square_speed(changes, before.times[: len(changes)])
    updated = replace(before, error_models=error_models).with_speeds(found)
    speeds = torch.where(before.known, before.square_speed, updated.square_speed)
    return replace(updated, square_speed=speeds).with_outlier_factors(corrections)


def _inferred_models(
    before: Mapping[str, Stage1ErrorModel], times: Tensor, turns: Tensor, moves: Tensor
) -> dict[str, Stage1ErrorModel]:
    """Infer stage 1's error models, group by group, from corrections in the camera's axes."""
    seen = {name: turns[:, list(group), 2] for name, group in GROUPS.items()}  # line of sight
    seen |= {name: moves[:, list(axes)] for name, axes in PLACE_AXES.items()}
    slow = lambda name: fit_slow_part(-seen[name], times, before[name].white, before[name])
    models = {name: slow(name) for name in seen}
    floor = SLOW_FLOOR * sqrt(torch.tensor([models[name].slow for name in GROUPS]).square().mean())
    for name in GROUPS:
        models[name] = replace(models[name], slow=max(models[name].slow, float(floor)))
    return models


def _of_joints(
    models: Mapping[str, Stage1ErrorModel], joints: Sequence[int]
) -> list[Stage1ErrorModel]:
    group_of = {i: name for name, group in GROUPS.items() for i in group}
    return [models[group_of[i]] for i in joints]


def _of_axes(models: Mapping[str, Stage1ErrorModel]) -> list[Stage1ErrorModel]:
    return [models[name] for name, axes in PLACE_AXES.items() for _ in axes]
