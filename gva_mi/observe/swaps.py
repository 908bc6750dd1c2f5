"""Fix frames in which left and right were swapped: by an estimator, or by a landmark network.

:func:`fix_swaps` is for the poses of a single-frame estimator, which now and then gives the left
leg the pose of the right one, and vice versa. :func:`fix_front_back` is for landmarks, when a
network takes the back of a person for the front.

Gradient descent hardly recovers from a swap: the wrong leg fills the outline as well when it tilts
the other way in depth. So swaps are searched for before any optimisation. In each frame two limbs
are as given, ``s_k = 0``, or exchanged, ``s_k = 1``: each gets the rotations of the other, mirrored
in the plane that halves the body at rest. The states minimise

1. ``E(s) = w Σ_k (L_k(s_k) / ν + cost(Δ_k(s_k, s_k+1))) + Σ_k (a s_k + b [s_k-1 < s_k])``

with ``L_k`` the data term of Eq. 8 at the stage-1 pose, and the cost of the joints' rotations ``Δ``
from frame to frame (eq. 5 of :mod:`gva_mi.prior.process`) at the speed that stage 1 shows. Dynamic
programming (Viterbi) finds the minimum over the chain of two states per frame.

``w`` is below 1 because the joints of a limb turn together, and so do its pixels. With legs apart,
images and motion decide by tens of nats. ``a`` and ``b`` decide where they do not: for limbs in
equal poses, and for a video in which all frames would be exchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, SIDES, Pose, mirrored_name
from gva_mi.body.so3 import turns_between
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.prior.inference import CORRECTED_JOINTS, prior_from_stage1
from gva_mi.prior.process import step_cost
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.subject.landmarks import FACE_LANDMARKS, Landmarks

# a and b, nats. Chosen: one frame in a hundred begins a run of swapped frames.
SWAP_NATS, SWAP_RUN_NATS = 1.0, 4.6
INDEPENDENT_SHARE = 0.25  # w; chosen below 1, see above
LIMBS: Mapping[str, Sequence[str]] = MappingProxyType(  # the joints whose motion is compared
    {"legs": ("hip", "knee", "ankle", "foot"), "arms": ("collar", "shoulder", "elbow", "wrist")}
)
_MIRRORED = torch.tensor([1.0, -1.0, -1.0])  # mirrors an axis-angle in the plane x = 0
# Of fix_front_back: the landmarks that are compared, and its constants.
LIMB_POINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
LIMB_SPEED = 0.9  # σ, heights of the person a second, of limbs in the picture; chosen by eye
BACK_FRAME_NATS = 0.3  # a, nats; chosen small, because mistakes last and a frame says little
SEEN_FACE_NATS = 5.0  # f, nats, of a frame with a face; chosen: odds of 150 to 1
FRONTAL_WIDTH = 0.12  # of shoulders and hips at which c is 1, heights of the person; by eye
STATE_ROUNDS = 5  # updates of states and p, at most: they end when nothing changes


def fix_swaps(
    stage1: Stage1Poses, losses: Callable[[Pose], Tensor], prior_weight: float
) -> tuple[Pose, dict[str, list[int]]]:
    """Exchange swapped limbs of stage-1 poses (eq. 1).

    Args:
        stage1: poses of n frames.
        losses: returns the data term of Eq. 8 (n,) in poses of the n frames; NaN without evidence.
        prior_weight: ν, the weight of the prior beside the data term.

    Returns:
        The fixed poses, and for "legs" and "arms" the frames in which they were swapped, if any.
    """
    pose, swapped_in = stage1.pose, dict[str, list[int]]()
    if len(pose) < 2:
        return pose, {}
    as_given = losses(pose)
    for name in LIMBS:
        other = exchanged(pose, name)
        after = losses(other)
        data = torch.stack([as_given, after], 1).nan_to_num(0.0) / prior_weight
        motion = _motion_cost(stage1, name, (pose, other))
        swapped = most_probable_states(INDEPENDENT_SHARE * data, INDEPENDENT_SHARE * motion)
        if swapped.any():
            swapped_in[name] = swapped.nonzero()[:, 0].tolist()
            as_given = torch.where(swapped, after, as_given)
            rotations = torch.where(swapped[:, None, None], other.rotations, pose.rotations)
            pose = replace(pose, rotations=rotations)
    return pose, swapped_in


def exchanged(pose: Pose, limbs: str) -> Pose:
    """Return poses whose "legs" or "arms" have changed sides, in every frame."""
    left, right = _joints(limbs)
    if limbs == "arms":  # together with their hands
        left = left + list(range(LEFT_HAND.start, LEFT_HAND.stop))
        right = right + list(range(RIGHT_HAND.start, RIGHT_HAND.stop))
    rotations = pose.rotations.clone()
    rotations[:, left + right] = pose.rotations[:, right + left] * _MIRRORED
    return replace(pose, rotations=rotations)


def fix_front_back(landmarks: Landmarks, fps: float) -> tuple[Landmarks, list[int]]:
    """Exchange left and right of landmarks in frames where a network took the back for the front.

    From behind, a person with long hair or a hood looks much as from the front. A network may then
    give the left arm and leg the names of the right ones, with high confidence, for some frames. In
    the landmarks all limbs jump to the other side of the body from one frame to the next, and jump
    back later. As in eq. 1 of this module, each frame is as given, ``s_k = 0``, or exchanged,
    ``s_k = 1``, and the states minimise

    1. ``Σ_k (w Σ_p t_2(|x_k+1,p - x_k,p| / σ S Δt_k) + f_k s_k + g_k)``
       ``+ Σ_k (a s_k + b [s_k-1 < s_k])``

    with the places ``x`` of shoulders, hips and limbs in the picture, left and right by the states,
    the person's height ``S`` in pixels, the time ``Δt`` between two frames, and the cost ``t`` of
    Student's t distribution. ``f`` is large if the face was found.

    If the network errs from one profile to the next, no limb jumps. But then it shows a person from
    the front without a face:

    2. ``g_k = -log(1 - p c_k)``            in a frame without a face, otherwise 0

    where ``c`` in [0, 1] is how much the trunk faces the camera, by its states, and ``p`` is the
    share of frontal frames in which this video shows a face. ``p`` and the states are updated in
    turn.

    The network's depths of an exchanged frame describe a person who looks at the camera, so they
    are removed.

    Args:
        landmarks: T frames; names without a side, and frames without the person, stay.
        fps: frames a second.

    Returns:
        The fixed landmarks, and the exchanged frames.
    """
    frames = _back_for_front(landmarks, fps)
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


def _back_for_front(landmarks: Landmarks, fps: float) -> list[int]:
    """Return the frames of state 1 (eq. 1 of :func:`fix_front_back`)."""
    wanted = [f"{side}_{part}" for side in SIDES for part in LIMB_POINTS]
    if not set(wanted) <= set(landmarks.names):
        return []
    x = landmarks.pixels[:, landmarks.indices(wanted)].astype(float)
    seen = np.flatnonzero(np.isfinite(x).all((1, 2)))
    if len(seen) < 2:
        return []
    x = x[seen]
    height = np.median(np.ptp(x[..., 1], axis=1))
    crossed = np.roll(x, len(LIMB_POINTS), axis=1)
    usual = LIMB_SPEED * height * np.diff(seen)[:, None] / fps
    apart = (np.linalg.norm(x[1:] - before[:-1], axis=-1) for before in (x, crossed))
    same, changed = (_steps_cost(step / usual) for step in apart)
    motion = np.stack([np.stack([same, changed], -1), np.stack([changed, same], -1)], -2)
    motion = INDEPENDENT_SHARE * torch.from_numpy(motion)
    if not set(FACE_LANDMARKS) <= set(landmarks.names):
        data = torch.zeros(len(seen), 2, dtype=motion.dtype)
        return seen[most_probable_states(data, motion, BACK_FRAME_NATS).numpy()].tolist()
    face = np.isfinite(landmarks.pixels[seen][:, landmarks.indices(FACE_LANDMARKS)]).all((1, 2))
    frontal = _frontal(x, height)
    states = np.zeros(len(seen), bool)
    for _ in range(STATE_ROUNDS):
        data = SEEN_FACE_NATS * np.stack([np.zeros(len(seen)), face], 1)
        data[~face] -= np.log(1 - _share_of_faces(frontal, face, states) * frontal[~face])
        found = most_probable_states(torch.from_numpy(data), motion, BACK_FRAME_NATS).numpy()
        if (found == states).all():
            break
        states = found
    return seen[states].tolist()


def _frontal(x: np.ndarray, height: float) -> np.ndarray:
    """Return ``c`` (n, 2), as given and exchanged, by the landmarks ``x`` (n, P, 2).

    If a person faces the camera, their left side is on the right of the picture.
    """
    left, right = x[:, : len(LIMB_POINTS), 0], x[:, len(LIMB_POINTS) :, 0]
    wide = (left - right)[:, [LIMB_POINTS.index("shoulder"), LIMB_POINTS.index("hip")]].mean(1)
    return np.stack([wide, -wide], 1).clip(0, FRONTAL_WIDTH * height) / (FRONTAL_WIDTH * height)


def _share_of_faces(frontal: np.ndarray, face: np.ndarray, states: np.ndarray) -> float:
    """Return ``p`` with a uniform prior: one more frame with a face, and one more without."""
    c = np.where(states, frontal[:, 1], frontal[:, 0])
    return float((c @ face + 1) / (c.sum() + 2))


def _steps_cost(r: np.ndarray) -> np.ndarray:
    """Return the sum (n,) of ``t_2`` over steps (n, P) in units of σ, nats."""
    return ((STUDENT_DOF + 2) / 2 * np.log1p(r**2 / STUDENT_DOF)).sum(1)


def most_probable_states(data: Tensor, motion: Tensor, each: float = SWAP_NATS) -> Tensor:
    """Return which frames are exchanged (n,): the states of least energy (Viterbi).

    Args:
        data: (n, 2) energy of each frame in each state, nats.
        motion: (n - 1, 2, 2) energy of each step from a state to a state, nats.
        each: ``a``, nats.
    """
    of_frame = data + torch.tensor([0.0, each])
    begins = torch.tensor([[0.0, SWAP_RUN_NATS], [0.0, 0.0]])
    least, before = of_frame[0] + begins[0], []
    for k, step in enumerate(motion + begins, start=1):
        total, best = (least[:, None] + step).min(0)
        least = total + of_frame[k]
        before.append(best)
    states = [int(least.argmin())]
    for best in reversed(before):
        states.append(int(best[states[-1]]))
    return torch.tensor(states[::-1]) == 1


def _motion_cost(stage1: Stage1Poses, limbs: str, poses: Sequence[Pose]) -> Tensor:
    """Return the cost of motion (n - 1, 2, 2), from one of two poses to one of two poses, nats."""
    left, right = _joints(limbs)
    joints, process = left + right, prior_from_stage1(stage1).joints
    # A step contains the white errors of both frames.
    white = torch.tensor([model.white for model in process.error_models]).square()
    square = (process.square_speed + 2 * white)[:, [CORRECTED_JOINTS.index(i) for i in joints]]
    rotations = [pose.rotations[:, joints] for pose in poses]
    steps = [[turns_between(a[:-1], b[1:]) for b in rotations] for a in rotations]
    costs = ([step_cost(step, square).sum(1) for step in row] for row in steps)
    return torch.stack([torch.stack(row, -1) for row in costs], -2)


def _joints(limbs: str) -> tuple[list[int], list[int]]:
    """Return the joints of the left limb and of the right limb."""
    sides = ([JOINTS.index(f"{side}_{x}") for x in LIMBS[limbs]] for side in ("left", "right"))
    left, right = sides
    return left, right
