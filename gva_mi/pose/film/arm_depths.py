"""How far arms reach toward the camera: the evidence of all frames together, not of each alone.

A bone's picture hardly tells its depth. Near the picture's plane its length hardly changes, and it
never tells the sign. So the most likely pose of a frame is often far from the mean of all poses
that the frame leaves possible. But an arm at rest in the axes of a body that turns round is seen
from all sides. With the direction ``s_t`` of a bone in the axes of the chest, whose rotation is
``R_t``, a frame says

1. ``E_t(s) = t_2((π(x + L R_t s) - π(x) - d) / σ) + t_1((gain L (R_t s)_z - m) / σ_z)``

where ``x`` is the joint at which the bone starts, ``L`` the bone's length, ``d`` its picture and
``m`` its depth in the network's eyes; ``t_d``, ``gain``, ``σ_z`` and the number of frames that
count as one are those of :mod:`gva_mi.pose.film.film_evidence`. The posterior of
:mod:`gva_mi.pose.film.limb_directions` has a mean and a variance of the bone's depth in every
frame. In the evidence they take the place of the network's depth.

Legs are left as they are: they hold each other and the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from gva_mi.body.pose import JOINTS
from gva_mi.pose.film.film_evidence import LEAST_DEPTH, FilmEvidence
from gva_mi.pose.film.film_state import FilmState
from gva_mi.pose.film.landmark_noise import FREEDOM
from gva_mi.pose.film.limb_directions import DirectionModel
from gva_mi.pose.film.posed_points import PosedPoints

CHEST = JOINTS.index("spine3")
ARMS = (("shoulder", "elbow"), ("elbow", "wrist"))


def with_arm_depths(
    evidence: FilmEvidence, names: Sequence[str], state: FilmState, dt: float
) -> FilmEvidence:
    """Return the evidence with the arms' depths from all frames.

    Args:
        evidence: of T frames.
        names: its P landmarks.
        state: a first solution: the chest's rotations, the joints' places and the bones' lengths
            are taken from it. Its offsets are those of the P landmarks.
        dt: seconds between frames.
    """
    offsets = pad(state.offsets, (0, 0, 0, len(evidence.points.rest) - len(names)))
    posed = PosedPoints.of(evidence.points, state.rotations, state.place, state.betas, offsets)
    model = DirectionModel.of(dt)
    gain, deep = evidence.gain.clone(), evidence.deep.clone()
    precision = evidence.deep_precision.clone()
    for bone, ends in _bones(evidence, names):
        energy, z, beyond = _energy(evidence, bone, ends, posed, state, model.directions)
        p = model.posterior(energy[None])[0]
        mean = (p * z).sum(1)
        gain[bone], deep[:, bone] = 1, mean + beyond
        precision[:, bone] = 1 / (p * (z - mean[:, None]).square()).sum(1)
    return replace(evidence, gain=gain, deep=deep, deep_precision=precision)


def _bones(evidence: FilmEvidence, names: Sequence[str]) -> list[tuple[int, tuple[int, int]]]:
    """Return the arms' bones among those of the evidence, and the joints at their ends."""
    found, bones = [], evidence.bones.tolist()
    for side in ("left", "right"):
        for bone in ARMS:
            ends = [f"{side}_{end}" for end in bone]
            if set(ends) <= set(names):
                start, end = (JOINTS.index(name) for name in ends)
                found.append((bones.index([list(names).index(n) for n in ends]), (start, end)))
    return found


def _energy(
    evidence: FilmEvidence,
    bone: int,
    ends: tuple[int, int],
    posed: PosedPoints,
    state: FilmState,
    directions: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return eq. 1 of a bone (T, N), the depth along it (T, N), and that of its landmarks (T,).

    Landmarks sit beside the joints, so what they see is moved by what lies between: the last
    value is how much deeper they lie apart than the joints do.
    """
    i, j = evidence.bones[bone].tolist()
    start, end = (posed.places[:, joint] for joint in ends)
    f = torch.stack([evidence.K[0, 0], evidence.K[1, 1]]) * state.focal.exp()
    project = lambda X: f * X[..., :2] / X[..., 2:].clamp_min(LEAST_DEPTH)
    beside = project(posed.X[:, j]) - project(posed.X[:, i]) - project(end) + project(start)
    beyond = posed.X[:, j, 2] - posed.X[:, i, 2] - end[:, 2] + start[:, 2]

    along = (end - start).norm(dim=1)[:, None, None] * torch.einsum(
        "tij,nj->tni", posed.A[:, CHEST], directions
    )
    z = along[..., 2]
    d = evidence.pixels[:, j] - evidence.pixels[:, i] - beside
    r = project(start[:, None] + along) - (project(start) + d)[:, None]
    m = evidence.deep[:, bone] - evidence.gain[bone] * beyond
    precisions = evidence.precision[:, [i, j]].unbind(1)
    of_both = precisions[0] * precisions[1] / (precisions[0] + precisions[1])
    square = _weighed(r.square().sum(2), of_both)
    energy = (FREEDOM + 2) / 2 * torch.log1p(square / FREEDOM)
    deeper = evidence.gain[bone] * z - m[:, None]
    square = _weighed(deeper.square(), evidence.deep_precision[:, bone])
    energy = energy + (FREEDOM + 1) / 2 * torch.log1p(square / FREEDOM)
    return energy / evidence.memory, z, beyond


def _weighed(square: Tensor, precision: Tensor) -> Tensor:
    """Return squares (T, N) times the precision (T,); zero in frames without any."""
    seen = precision > 0
    return torch.where(seen[:, None], square * precision[:, None], 0)
