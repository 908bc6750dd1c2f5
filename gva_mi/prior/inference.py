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

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.so3 import compose, to_matrix, to_rotvec
from gva_mi.core.cpu import sqrt
from gva_mi.prior.error_model import (
    FREEDOM,
    GROUPS,
    Stage1ErrorModel,
    fit_slow_part,
    median_of_square,
    white_level,
)
from gva_mi.prior.ground import Ground
from gva_mi.prior.process import ProcessPrior, mean_speed
from gva_mi.prior.stage1_poses import Stage1

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
TILTING_JOINTS = slice(1, 22)  # without the pelvis: a tilted camera tilts the whole person
LEAST_TILT = np.radians(0.1)  # σ: 2 mm at a foot
TILT_MEMORY = 6.0  # m, as for joints and soles that are off for a while
LEAST_TURN = 0.5  # least turn of the person: nearly half round


@dataclass(frozen=True)
class TiltPrior:
    """Penalise limbs that tilt toward the camera wherever the person turns: L joints of the body.

    This is for an estimator whose errors are inferred; those that are known tell how large such a
    tilt may be (:meth:`gva_mi.refine.corrections.Corrections.constant_turn_energy`).

    Stage 1's depth errors of a limb are often the same in every frame: legs tilt toward the camera
    whichever way the person faces, and images hardly show it. Relative to the body, such a limb
    tilts to and fro once per turn of the person: a motion that depends on the camera. With a
    joint's turn ``m_k`` from its mean pose, and ``R_k``, which rotates the camera's axes to the
    joint's, the part of a motion that is locked to the camera is, in the camera's axes,

    1. ``c = P mean_k (R_k - mean R)ᵀ m_k``,    ``P = A / |A|``,    ``A = mean_k |R_k - mean R|²``

    with ``A`` of the pelvis and ``|X|² = Xᵀ X``: ``P`` leaves out the axis about which the person
    turns. ``c`` is the tilt itself if the person turns round, and zero if not; below half a turn
    the term is off. Its coordinate ``c_z``, about the line of sight, is visible in images, so it
    shows how large ``c`` is by chance. In depth, what exceeds that costs, in nats in every frame,

    2. ``E = (ν + 1) / 2m · Σ_j log(1 + max(|(c_x, c_y)| / σ_j - 1, 0)² / ν)``,
       ``σ_j² = (ρ² v_j + s²) / 2``

    with ``v_j`` the mean square of joint ``j``'s motion about the line of sight, ``ρ²`` the usual
    ``c_z² / v_j``, and ``s²`` the usual ``c_z²``. It is Student's ``t``, because somebody may point
    at the camera from wherever they stand. ``m`` frames count as one, because images err in the
    same way in all frames where clothes look like a tilt.
    """

    means: Tensor  # (L, 3) their mean rotations, axis-angle
    swings: Tensor  # (n, L, 3, 3) ``R_k - mean R``
    across: Tensor  # (3, 3) ``P``
    chance: Tensor  # (L,) ``σ``, radians
    shown: bool  # whether the person turns far enough to separate a tilt from a gesture

    @staticmethod
    @torch.no_grad()
    def of(stage1: Stage1, rotations: Tensor) -> TiltPrior:
        """Estimate the chance level from a motion, rotations (n, J, 3)."""
        import roma  # here, as in stage1.py

        R = stage1.R_joint_camera[:, TILTING_JOINTS]
        means = to_rotvec(
            roma.special_procrustes(to_matrix(rotations[:, TILTING_JOINTS]).mean(0), method="svd")
        )
        none, shown = torch.ones(len(means)), stage1.turned > LEAST_TURN
        tilt = TiltPrior(means, R - R.mean(0), _across(stage1), none, shown)
        m = tilt._turns(rotations)
        sways = (R.mT @ (m - m.mean(0))[..., None])[..., 2, 0].square().mean(0)
        square = tilt._locked(m)[:, 2].square()
        usual = lambda some: some.median() / median_of_square(1)
        chance = (usual(square / sways.clamp_min(LEAST_TILT**2)) * sways + usual(square)) / 2
        return replace(tilt, chance=sqrt(chance).clamp_min(LEAST_TILT))

    def energy(self, rotations: Tensor, transl: Tensor, times: Tensor) -> Tensor:
        """Return eq. 2, a mean over the frames."""
        if not self.shown:
            return rotations.new_zeros(())
        in_depth = self._locked(self._turns(rotations))[:, :2]
        size = sqrt(in_depth.square().sum(1) + (0.01 * LEAST_TILT) ** 2)  # has a slope at 0, too
        beyond = (size / self.chance - 1).clamp_min(0)
        return (FREEDOM + 1) / (2 * TILT_MEMORY) * torch.log1p(beyond.square() / FREEDOM).sum()

    def _turns(self, rotations: Tensor) -> Tensor:
        """Return ``m`` (n, L, 3), radians."""
        return compose(-self.means, rotations[:, TILTING_JOINTS])

    def _locked(self, turns: Tensor) -> Tensor:
        """Return eq. 1 (L, 3), radians."""
        return (self.swings.mT @ turns[..., None]).mean(0)[..., 0] @ self.across


def _across(stage1: Stage1) -> Tensor:
    """Return ``P`` of eq. 1."""
    swings = stage1.R_joint_camera[:, 0]
    swings = swings - swings.mean(0)
    A = (swings.mT @ swings).mean(0)
    return A / torch.linalg.matrix_norm(A, 2).clamp_min(1e-12)


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
    found = mean_speed(changes, before.times[: len(changes)])
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
