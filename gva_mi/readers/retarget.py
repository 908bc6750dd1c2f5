"""Retarget a skeleton with another rest pose and other bones to SMPL-X's joints.

In one reference pose, source and body stand alike. There the body gets rotations A_ref, so that its
limbs point as the source's do; each limb rotates the shortest way from where its parent moved it.
In all other frames a joint of the body rotates with the source's joint, G:

    A(t) = G(t) G_refᵀ A_ref,    R_joint = A_parentᵀ A_joint

so limbs keep their directions and their twist. Trunk, neck and head have no directions of their
own: skeletons place these joints differently, so in the reference pose they follow the pelvis.
Soles stand on the ground.

The reference pose has zero angles, if a person stands in it (a T-pose or an A-pose). Some skeletons
have no such pose. Then G_refᵀ A_ref is the mean over the frames in which the person stands
straightest; in one frame alone they may look or point anywhere.

Lengths are scaled so that the legs are as long as the body's, because the files have no unit.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gva_mi.body.pose import JOINTS, PARENTS, SIDES
from gva_mi.body.rotations import nearest_rotations, shortest, to_matrices, to_rotvecs
from gva_mi.core.errors import InputError
from gva_mi.readers.bvh import FINGER_WORDS, BvhClip, Humanoid, find_humanoid
from gva_mi.readers.target_body import TargetBody
from gva_mi.readers.track import Track
from gva_mi.readers.up_axis import unit

# All chosen.
_STRAIGHT_FACTOR = 1.5  # a frame is a reference pose up to this times the smallest deviation
_REFERENCE_POSES = 40  # at most, evenly spread; the mean of more hardly changes
_STANDING_ANGLE = np.radians(60)  # legs and elbows of somebody who stands bend by less
_AXIS_COSINE = np.cos(np.radians(25))  # a trunk within 25 degrees of an axis: this axis is up
_FEET_BACK_COSINE = -0.3  # a foot whose direction has less of forward points backward
_LIMBS = {
    f"{side}_{joint}": f"{side}_{child}"
    for side in SIDES
    for joint, child in (
        ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"),
        *((f"{finger}{k}", f"{finger}{k + 1}") for finger in FINGER_WORDS for k in (1, 2)),
    )
}  # fmt: skip
Places = dict[str, np.ndarray]  # joint → (..., 3), or (..., 3, 3) rotations


def bvh_track(path: Path, clip: BvhClip, body: TargetBody) -> Track:
    """Return the track of a BVH's person on ``body``."""
    notes = []
    if clip.announced != str(len(clip)):
        notes.append(f"says that it has {clip.announced} frames, and has {len(clip)}")
    # Programs put the pose by which they calibrate before the motion.
    if len(clip) > 2 and not clip.turns_in(0) and clip.turns_in(1):
        clip = replace(clip, rotations=clip.rotations[1:], places=clip.places[1:])
        notes.append("the pose of zero angles before the motion is left out")
    human = find_humanoid(path, clip.names, clip.parents)
    turns, places = clip.in_world()
    ref, ref_turns, more = _stances(path, human, clip, turns, places)
    notes += more
    if _faces_back(_frame_of(ref, 0)):
        notes.append("left and right follow left-handed axes; x is mirrored")
        mirror = np.array([-1.0, 1.0, 1.0])
        turns, ref_turns = (mirror[:, None] * x * mirror for x in (turns, ref_turns))
        places, ref = places * mirror, {name: x * mirror for name, x in ref.items()}
    at, own = _named(human, places), dict(zip(JOINTS, body.joints, strict=True))
    stances = [_reference(_frame_of(ref, k), own) for k in range(len(ref_turns))]
    A: Places = {}
    for name, parent in zip(JOINTS, PARENTS, strict=True):
        if name not in human.joints:
            A[name] = A[JOINTS[parent]]
            continue
        first, second, weight = human.joints[name]
        A_ref = np.stack([stance[name] for stance in stances])
        one, two = (
            turns[:, k] @ nearest_rotations((ref_turns[:, k].swapaxes(1, 2) @ A_ref).mean(0))
            for k in (first, second)
        )
        A[name] = one if not weight else one @ to_matrices(
            weight * to_rotvecs(one.swapaxes(1, 2) @ two)
        )  # fmt: skip
    scale = leg_length(own) / leg_length(ref)
    notes.append(f"its unit is taken as {scale:.4g} m, so that the legs are as long as the body's")
    track = on_body("BVH", np.arange(len(clip)), A, at, own, scale, notes)
    return replace(track, has_hands=human.has_hands)


def on_body(
    form: str, frames: np.ndarray, A: Places, at: Places, own: Places, scale: float, notes: list
) -> Track:
    """Return the track of a skeleton's motion on a body.

    Args:
        form: what kind of source it is.
        frames: (T,) frame numbers.
        A: rotation (T, 3, 3) of each of the body's joints in the world.
        at: (T, 3) of the source's joints; the middle of its hips becomes the body's.
        own: (3,) of the body's joints at rest, metres.
        scale: metres per unit of ``at``.
        notes: of the track.
    """
    relative = [A[name] if parent < 0 else A[JOINTS[parent]].swapaxes(1, 2) @ A[name]
                for name, parent in zip(JOINTS, PARENTS, strict=True)]  # fmt: skip
    hips = (own["left_hip"] + own["right_hip"]) / 2 - own["pelvis"]
    pelvis = scale * (at["left_hip"] + at["right_hip"]) / 2 - A["pelvis"] @ hips
    K = np.tile(np.eye(3), (len(frames), 1, 1))
    rotations = to_rotvecs(np.stack(relative, 1))
    return Track("0", frames, rotations, pelvis, None, K, form, False, notes=tuple(notes))


def _stances(
    where: object, human: Humanoid, clip: BvhClip, turns: np.ndarray, places: np.ndarray
) -> tuple[Places, np.ndarray, list[str]]:
    """Return places (n, 3) and rotations (n, J, 3, 3) of the reference poses, and notes."""
    eye = np.broadcast_to(np.eye(3), (1, len(clip.names), 3, 3))
    zero = replace(clip, rotations=eye, places=clip.offsets[None])
    zero_turns, zero_places = zero.in_world()
    at = _named(human, zero_places)
    if _doubt(at)[0, :2].max() < _STANDING_ANGLE:
        return at, zero_turns, []
    at = _named(human, places)
    doubt = np.nan_to_num(_doubt(at), nan=np.pi)
    stands, total = doubt[:, :2].max(1) < _STANDING_ANGLE, doubt.sum(1)
    if not stands.any():
        raise InputError(
            f"{where}: the person stands neither in the pose of zero angles nor in any frame, so "
            "the joints cannot be compared with a body's; expected a T-pose or an A-pose somewhere"
        )
    best = total[stands].min()
    straight = np.flatnonzero(stands & (total <= _STRAIGHT_FACTOR * best + 1e-6))
    straight = straight[
        np.linspace(0, len(straight) - 1, min(len(straight), _REFERENCE_POSES)).astype(int)
    ]
    note = (
        "nobody could stand in its pose of zero angles; joints are compared where the person "
        f"stands straightest, in {len(straight)} frames from {straight[0]} to {straight[-1]}"
    )
    return {name: x[straight] for name, x in at.items()}, turns[straight], [note]


def _frame_of(at: Places, frame: int) -> Places:
    return {name: x[frame] for name, x in at.items()}


def _named(human: Humanoid, places: np.ndarray) -> Places:
    return {name: places[:, k] for name, k in human.points.items()}


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip((unit(a) * unit(b)).sum(-1), -1, 1))


def _trunk(at: Places) -> tuple[np.ndarray, np.ndarray]:
    """Return the vectors from right hip to left, and from hips to shoulders."""
    hips, shoulders = ((at[f"left_{x}"] + at[f"right_{x}"]) / 2 for x in ("hip", "shoulder"))
    return at["left_hip"] - at["right_hip"], shoulders - hips


def _doubt(at: Places) -> np.ndarray:
    """Return how far a person is from standing (T, 3): by legs, elbows, arms; radians."""
    left, up = _trunk(at)
    legs = [_angle(at[child] - at[joint], -up) for joint, child in _LIMBS.items()
            if joint.endswith(("hip", "knee"))]  # fmt: skip
    bends, aside = [np.zeros(len(up))], []
    for side in SIDES:
        upper = at[f"{side}_elbow"] - at[f"{side}_shoulder"]
        aside.append(abs(np.pi / 2 - _angle(upper, np.cross(left, up))))
        if f"{side}_wrist" in at:
            bends.append(_angle(at[f"{side}_wrist"] - at[f"{side}_elbow"], upper))
    return np.stack([np.max(legs, 0), np.max(bends, 0), np.max(aside, 0)], 1)


def _frame(at: Places) -> np.ndarray:
    """Return a standing person's axes, in columns (3, 3): to the left, up, forward."""
    left, up = _trunk(at)
    axis = np.eye(3)[np.abs(up).argmax()] * np.sign(up[np.abs(up).argmax()])
    up = axis if unit(up) @ axis > _AXIS_COSINE else unit(up)
    left = unit(left - up * (left @ up))
    return np.stack([left, up, np.cross(left, up)], 1)


def _faces_back(at: Places) -> bool:
    """Return whether both feet point backward: then the axes are left-handed."""
    forward = _frame(at)[:, 2]
    feet = [at[f"{side}_toe"] - at[f"{side}_ankle"] for side in SIDES if f"{side}_toe" in at]
    return bool(feet) and all(unit(foot) @ forward < _FEET_BACK_COSINE for foot in feet)


def _reference(ref: Places, body: Places) -> dict[str, np.ndarray]:
    """Return A_ref (3, 3) of each joint of the body."""
    frame = _frame(ref) @ _frame(body).T
    A: dict[str, np.ndarray] = {}
    for name, parent in zip(JOINTS, PARENTS, strict=True):
        A[name] = A[JOINTS[parent]] if parent >= 0 else frame
        side = name.split("_")[0]
        toe = f"{side}_toe"
        if name.endswith("ankle") and toe in ref:
            A[name] = _foot(frame, body[f"{side}_foot"] - body[name], ref[toe] - ref[name])
        elif name.endswith("wrist") and f"{side}_pinky1" in ref:
            A[name] = _palm(ref, side) @ _palm(body, side).T
        elif (child := _LIMBS.get(name)) in ref and name in ref:
            A[name] = _swung(A[name], body[child] - body[name], ref[child] - ref[name])
    return A


def _swung(A: np.ndarray, ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return A turned the shortest way by which ``ours`` points as ``theirs``."""
    return to_matrices(shortest(unit(A @ ours)[None], unit(theirs)[None]))[0] @ A


def _foot(frame: np.ndarray, ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return A of a foot, rotated about the vertical alone, because its slope is the skeleton's.

    A foot that points down does not stand on the ground; it gets the source's direction.
    """
    up = frame[:, 1]
    flat = lambda x: x - up * (x @ up)
    if np.linalg.norm(flat(theirs)) < 0.5 * np.linalg.norm(theirs):
        return _swung(frame, ours, theirs)
    return _swung(frame, frame.T @ flat(frame @ ours), flat(theirs))


def _palm(at: Places, side: str) -> np.ndarray:
    """Return the axes of a hand, in columns (3, 3): along it, across it, out of it."""
    knuckles = [at[f"{side}_{finger}1"] for finger in FINGER_WORDS
                if finger != "thumb" and f"{side}_{finger}1" in at]  # fmt: skip
    along = unit(np.mean(knuckles, 0) - at[f"{side}_wrist"])
    across = knuckles[0] - at[f"{side}_pinky1"]
    across = unit(across - along * (along @ across))
    return np.stack([along, across, np.cross(along, across)], 1)


def leg_length(at: Places) -> float:
    """Return the mean length of the two legs, of joints (3,) or (T, 3)."""
    bones = [np.linalg.norm(at[child] - at[joint], axis=-1).mean()
             for joint, child in _LIMBS.items() if joint.endswith(("hip", "knee"))]  # fmt: skip
    return float(np.sum(bones)) / 2
