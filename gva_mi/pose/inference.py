"""Infers how stage 1 errs, and how the person moves, from stage 1 and from what pictures corrected.

Before any picture is looked at, white errors and outliers can be told, for a person cannot move
like that; how errors that last look like, cannot. Pictures then correct, and show it: sideways, at
right angles to the line of sight, they leave nothing to believe. So beliefs are formed twice, by
:func:`from_stage1` and by :func:`from_pictures`; what they say goes with the poses into the record
of the refinement.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.pose import motion
from gva_mi.pose.belief import Belief
from gva_mi.pose.camera_lean import CameraLean
from gva_mi.pose.ground import Footing, Ground
from gva_mi.pose.noise import GROUPS, Noise, lasting_part, white_level
from gva_mi.pose.stage1 import Stage1

# What is believed of errors that last before pictures have shown them; small, for a motion of a few
# degrees must not be taken for an error. Only videos too short to infer anything keep it.
TURN = Noise(white=0.0, slow=0.05, memory=6.0)  # radians
PLACE = {"aside": Noise(0.0, 0.02, 6.0), "depth": Noise(0.0, 0.05, 6.0)}  # metres

AXES: Mapping[str, tuple[int, ...]] = {"aside": (0, 1), "depth": (2,)}  # the camera's
PELVIS = GROUPS["pelvis"]
JOINTS = tuple(i for name, group in GROUPS.items() if name != "pelvis" for i in group)
LEAST_SLOW = 0.5  # of what all groups together show: no group is believed to err less


@dataclass(frozen=True)
class Beliefs:
    """About all that is corrected.

    Attributes:
        noise: of stage 1: of each group of joints in radians, and of the place in metres.
        pelvis: one joint, which may turn steadily.
        joints: all others but those of the face, in the order of ``JOINTS``.
        place: of the person, three coordinates in the camera's axes; it may change steadily.
        lean: how far joints lean toward the camera by chance.
        ground: that soles stand on; None before it is looked for.
    """

    noise: Mapping[str, Noise]
    pelvis: Belief
    joints: Belief
    place: Belief
    lean: CameraLean
    ground: Ground | None = None


def in_words(noise: Mapping[str, Noise], footing: Footing | None) -> Iterator[str]:
    """How stage 1 errs, and how the person stands: lines for people, none where it is not known."""
    if not noise:
        return
    turns = ", ".join(f"{name} {np.degrees(noise[name].size):.1f}°" for name in GROUPS)
    places = " and ".join(f"{1000 * noise[name].size:.0f} mm {name}" for name in AXES)
    yield f"stage 1     errs by {turns}; by {places}"
    white = ", ".join(f"{name} {np.degrees(noise[name].white):.1f}°" for name in GROUPS)
    lasts = sorted({noise[name].memory for name in GROUPS})
    yield f"            white {white}; the rest lasts {lasts[0]:g} to {lasts[-1]:g} frames"
    if footing is not None:
        stands = f"soles stand {footing.share:.0%} of the time"
        yield f"ground      {stands}, within {1000 * footing.spread:.0f} mm of one plane"


def from_stage1(stage1: Stage1) -> Beliefs:
    """What stage 1 alone tells: its white errors, and how fast it moves."""
    turns, shifts = stage1.steps(stage1.pose)
    noise = {
        name: replace(TURN, white=white_level(turns[:, list(group)]))
        for name, group in GROUPS.items()
    }
    for name, axes in AXES.items():
        noise[name] = replace(PLACE[name], white=white_level(shifts[:, list(axes), None]))
    return Beliefs(
        noise,
        Belief.of_stage1(stage1.times, turns[:, list(PELVIS)], _by_joint(noise, PELVIS), True),
        Belief.of_stage1(stage1.times, turns[:, list(JOINTS)], _by_joint(noise, JOINTS)),
        Belief.of_stage1(stage1.times, shifts[..., None], _by_axis(noise), True),
        CameraLean.of(stage1, stage1.pose.rotations),
    )


def from_pictures(before: Beliefs, stage1: Stage1, turns: Tensor, moves: Tensor) -> Beliefs:
    """What corrections show that pictures have made, believing less.

    Args:
        before: what was believed.
        stage1: what was corrected.
        turns: (n, J, 3) in the camera's axes, radians.
        moves: (n, 3) in the camera's axes, metres.
    """
    noise = _noise(before.noise, stage1.times, turns, moves)
    pose = stage1.corrected(range(len(moves)), turns, moves)
    steps, shifts = stage1.steps(pose)
    root, sideways = list(PELVIS), stage1.in_camera(steps, slice(0, -1))[:, list(JOINTS), 2:]
    return Beliefs(
        noise,
        renewed(before.pelvis, _by_joint(noise, PELVIS), turns[:, root], steps[:, root]),
        renewed(before.joints, _by_joint(noise, JOINTS), turns[:, list(JOINTS)], sideways),
        renewed(before.place, _by_axis(noise), moves[..., None], shifts[..., None]),
        CameraLean.of(stage1, pose.rotations),
    )


def renewed(before: Belief, noises: list[Noise], corrections: Tensor, steps: Tensor) -> Belief:
    """A belief after corrections have shown more.

    Args:
        before: what was believed.
        noises: how C values err, as far as that is known by now.
        corrections: (n, C, d).
        steps: (n - 1, C, ...) from frame to frame, of what pictures show of them.
    """
    changes = before.changes(steps)
    times = before.times[: len(changes)].float()
    square = motion.excursions(changes, motion.SPAN).square().mean(-1)
    believed = before.with_noise(noises).moving(motion.mean_square(square, times))
    return believed.doubting(corrections)


def _noise(
    before: Mapping[str, Noise], times: Tensor, turns: Tensor, moves: Tensor
) -> dict[str, Noise]:
    """How stage 1 errs, group by group, from corrections in the camera's axes."""
    seen = {name: turns[:, list(group), 2] for name, group in GROUPS.items()}  # about the sight
    seen |= {name: moves[:, list(axes)] for name, axes in AXES.items()}
    found = {
        name: lasting_part(-errors, times, before[name].white, before[name])
        for name, errors in seen.items()
    }
    # Where a group is small in the picture, little is corrected: that is no proof of no errors.
    least = LEAST_SLOW * torch.tensor([found[name].slow for name in GROUPS]).square().mean().sqrt()
    for name in GROUPS:
        found[name] = replace(found[name], slow=max(found[name].slow, float(least)))
    return found


def _by_joint(noise: Mapping[str, Noise], joints: tuple[int, ...]) -> list[Noise]:
    kind = {i: name for name, group in GROUPS.items() for i in group}
    return [noise[kind[i]] for i in joints]


def _by_axis(noise: Mapping[str, Noise]) -> list[Noise]:
    return [noise[name] for name, axes in AXES.items() for _ in axes]
