"""Fix frames in which left and right were swapped: by stage 1, or by a network of landmarks.

A single-frame estimator now and then gives the left leg the pose of the right one, and vice versa.
Gradient descent hardly recovers: the wrong leg fills the outline as well by tilting the other way
in depth. So swaps are searched for before any optimisation. In each frame two limbs are as given,
``s_k = 0``, or exchanged, ``s_k = 1``: each has the rotations of the other, mirrored in the plane
that halves the body at rest. The states minimise

1. ``E(s) = w Σ_k (L_k(s_k) / ν + cost(Δ_k(s_k, s_k+1))) + Σ_k (a s_k + b [s_k-1 < s_k])``

with ``L_k`` the data term of Eq. 8 at this pose of stage 1, and the cost of how the limbs' joints
turn from frame to frame (:mod:`gva_mi.prior.process`, eq. 5), at the speed that stage 1 shows.
The chain of two states a frame is minimised by dynamic programming (Viterbi).

``w`` is below 1 because joints of a limb turn together, and so do the pixels on it. With legs
apart, images and motion decide by tens of nats. ``a`` and ``b`` decide where they do not: for limbs
in equal poses, and for a video in which all frames would be exchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, SIDES, Pose, mirrored_name
from gva_mi.prior.error_model import FREEDOM
from gva_mi.prior.inference import JOINTS as CORRECTED
from gva_mi.prior.inference import prior_from_stage1
from gva_mi.prior.process import step_cost
from gva_mi.prior.stage1_poses import Stage1, turns_between
from gva_mi.subject.landmarks import FACE_LANDMARKS, Landmarks

# a and b, nats: one frame in a hundred begins a run of exchanged ones.
SWAP_NATS, SWAP_RUN_NATS = 1.0, 4.6
INDEPENDENCE = 0.25  # w
LIMBS: Mapping[str, Sequence[str]] = MappingProxyType(  # the joints whose motion is compared
    {
        "legs": ("hip", "knee", "ankle", "foot"),
        "arms": ("collar", "shoulder", "elbow", "wrist"),
    }
)
_MIRRORED = torch.tensor([1.0, -1.0, -1.0])  # mirrors an axis-angle in the plane x = 0
PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
LIMB_SPEED = 0.9  # σ: of limbs in the picture, heights of the person a second
BACK_NATS = 0.3  # a, nats: mistakes last, so a frame says little
SEEN_FACE_NATS = 5.0  # f, nats, of a frame with a face
FRONTAL_WIDTH = 0.12  # width of shoulders and hips, heights of the person, at which c is 1
ROUNDS = 5  # of states and p


def fix_swaps(
    stage1: Stage1, losses: Callable[[Pose], Tensor], prior_weight: float
) -> tuple[Pose, dict[str, list[int]]]:
    """Return stage-1 poses with swapped limbs exchanged (eq. 1), and where, for each pair of limbs.

    ``losses`` returns the data term of Eq. 8 (n,) in poses of the n frames, NaN without evidence;
    ``prior_weight`` is ν, the weight of the prior beside it.
    """
    pose, found = stage1.pose, dict[str, list[int]]()
    if len(pose) < 2:
        return pose, {}
    as_given = losses(pose)
    for name in LIMBS:
        other = exchanged(pose, name)
        after = losses(other)
        data = torch.stack([as_given, after], 1).nan_to_num(0.0) / prior_weight
        motion = _motion(stage1, name, (pose, other))
        swapped = least_states(INDEPENDENCE * data, INDEPENDENCE * motion)
        if swapped.any():
            found[name] = swapped.nonzero()[:, 0].tolist()
            as_given = torch.where(swapped, after, as_given)
            rotations = torch.where(swapped[:, None, None], other.rotations, pose.rotations)
            pose = replace(pose, rotations=rotations)
    return pose, found


def exchanged(pose: Pose, name: str) -> Pose:
    """Return poses whose two limbs of that name have changed sides, in every frame."""
    left, right = _limbs(name)
    if name == "arms":  # together with their hands
        left = left + list(range(LEFT_HAND.start, LEFT_HAND.stop))
        right = right + list(range(RIGHT_HAND.start, RIGHT_HAND.stop))
    rotations = pose.rotations.clone()
    rotations[:, left + right] = pose.rotations[:, right + left] * _MIRRORED
    return replace(pose, rotations=rotations)


def with_backs(landmarks: Landmarks, fps: float) -> tuple[Landmarks, list[int]]:
    """Return landmarks whose left and right are exchanged where needed, and in which frames.

    From behind, a person with long hair or a hood looks much as from the front. A network may then
    give the left arm and leg the names of the right ones, with high confidence, for some frames. In
    the landmarks all limbs jump to the other side of the body from one frame to the next, and jump
    back later. As in eq. 1, each frame is as given, ``s_k = 0``, or exchanged,
    ``s_k = 1``, and the states minimise

    1. ``Σ_k (w Σ_p t_2(|x_k+1,p - x_k,p| / σ S Δt_k) + f_k s_k + g_k)``
       ``+ Σ_k (a s_k + b [s_k-1 < s_k])``

    with the places ``x`` of shoulders, hips and limbs in the picture, left and right by the states,
    the person's height ``S`` in pixels, the time ``Δt`` between two frames, and the cost ``t`` of
    Student's t distribution. ``f`` is large where the face was found. If the network errs from one
    profile to the next, no limb jumps. But then it shows a person from the front, of whom no face
    was found:

    2. ``g_k = -log(1 - p c_k)``            of a frame without a face, otherwise 0

    where ``c`` in [0, 1] is how much the trunk faces the camera, by its states, and ``p`` the share
    of frontal frames in which this video shows a face. ``p`` follows from the states, and they from
    it.

    The network's depths of such a frame are those of a person who looks at the camera. They are
    removed.

    Args:
        landmarks: T frames; names without a side, and frames without the person, stay.
        fps: frames a second.
    """
    frames = _mistaken(landmarks, fps)
    if not frames:
        return landmarks, []
    names = list(landmarks.names)
    other = [mirrored_name(name) for name in names]
    order = [names.index(b if b in names else a) for a, b in zip(names, other, strict=True)]
    found = {}
    for field in ("pixels", "confidence", "spread", "metric"):
        found[field] = getattr(landmarks, field).copy()
        found[field][frames] = found[field][frames][:, order]
    found["metric"][frames] = np.nan
    return replace(landmarks, **found), frames


def _mistaken(landmarks: Landmarks, fps: float) -> list[int]:
    """Return the frames whose states are exchanged (eq. 1)."""
    wanted = [f"{side}_{part}" for side in SIDES for part in PARTS]
    if not set(wanted) <= set(landmarks.names):
        return []
    x = landmarks.pixels[:, landmarks.indices(wanted)].astype(float)
    seen = np.flatnonzero(np.isfinite(x).all((1, 2)))
    if len(seen) < 2:
        return []
    x = x[seen]
    height = np.median(np.ptp(x[..., 1], axis=1))
    crossed = np.roll(x, len(PARTS), axis=1)
    usual = LIMB_SPEED * height * np.diff(seen)[:, None] / fps
    same, changed = (
        _steps_cost(np.linalg.norm(x[1:] - before[:-1], axis=-1) / usual) for before in (x, crossed)
    )
    motion = np.stack([np.stack([same, changed], -1), np.stack([changed, same], -1)], -2)
    motion = INDEPENDENCE * torch.from_numpy(motion)
    if not set(FACE_LANDMARKS) <= set(landmarks.names):
        data = torch.zeros(len(seen), 2, dtype=motion.dtype)
        return seen[least_states(data, motion, BACK_NATS).numpy()].tolist()
    face = np.isfinite(landmarks.pixels[seen][:, landmarks.indices(FACE_LANDMARKS)]).all((1, 2))
    frontal = _frontal(x, height)
    states = np.zeros(len(seen), bool)
    for _ in range(ROUNDS):
        data = SEEN_FACE_NATS * np.stack([np.zeros(len(seen)), face], 1)
        data[~face] -= np.log(1 - _share_of_faces(frontal, face, states) * frontal[~face])
        found = least_states(torch.from_numpy(data), motion, BACK_NATS).numpy()
        if (found == states).all():
            break
        states = found
    return seen[states].tolist()


def _frontal(x: np.ndarray, height: float) -> np.ndarray:
    """Return c (n, 2), as given and exchanged, of shoulders, hips and limbs ``x`` (n, P, 2).

    Of a person who faces the camera, the left side is on the right of the picture.
    """
    left, right = x[:, : len(PARTS), 0], x[:, len(PARTS) :, 0]
    wide = (left - right)[:, [PARTS.index("shoulder"), PARTS.index("hip")]].mean(1)
    return np.stack([wide, -wide], 1).clip(0, FRONTAL_WIDTH * height) / (FRONTAL_WIDTH * height)


def _share_of_faces(frontal: np.ndarray, face: np.ndarray, states: np.ndarray) -> float:
    """Return p: of frontal frames with a face, as if one more had it and one more had it not."""
    c = np.where(states, frontal[:, 1], frontal[:, 0])
    return float((c @ face + 1) / (c.sum() + 2))


def _steps_cost(r: np.ndarray) -> np.ndarray:
    """Return the energy (n,) of steps (n, P), nats."""
    return ((FREEDOM + 2) / 2 * np.log1p(r**2 / FREEDOM)).sum(1)


def least_states(data: Tensor, motion: Tensor, each: float = SWAP_NATS) -> Tensor:
    """Return which frames are exchanged (n,): the states of least energy, eq. 1.

    ``data`` (n, 2) is the energy of each frame in each state, ``motion`` (n - 1, 2, 2) that of each
    step from one state to another, nats; ``each`` is ``a``.
    """
    own = data + torch.tensor([0.0, each])
    begins = torch.tensor([[0.0, SWAP_RUN_NATS], [0.0, 0.0]])
    least, before = own[0] + begins[0], []
    for k, step in enumerate(motion + begins, start=1):
        total, best = (least[:, None] + step).min(0)
        least = total + own[k]
        before.append(best)
    states = [int(least.argmin())]
    for best in reversed(before):
        states.append(int(best[states[-1]]))
    return torch.tensor(states[::-1]) == 1


def _motion(stage1: Stage1, name: str, poses: Sequence[Pose]) -> Tensor:
    """Return the motion's cost (n - 1, 2, 2), from one of two poses to one of two poses."""
    left, right = _limbs(name)
    joints, process = left + right, prior_from_stage1(stage1).joints
    # A step contains the white errors of both frames.
    white = torch.tensor([noise.white for noise in process.error_models]).square()
    square = (process.square_speed + 2 * white)[:, [CORRECTED.index(i) for i in joints]]
    rotations = [pose.rotations[:, joints] for pose in poses]
    steps = [[turns_between(a[:-1], b[1:]) for b in rotations] for a in rotations]
    return torch.stack(
        [torch.stack([step_cost(step, square).sum(1) for step in row], -1) for row in steps], -2
    )


def _limbs(name: str) -> tuple[list[int], list[int]]:
    """Return the joints of the left limb, and those of the right one."""
    sides = ([JOINTS.index(f"{side}_{x}") for x in LIMBS[name]] for side in ("left", "right"))
    left, right = sides
    return left, right
