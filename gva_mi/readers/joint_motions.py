"""Read motions that are joint positions without rotations: HumanML3D, and networks trained on it.

=====================  ===========================================================================
Shape                  What it is
=====================  ===========================================================================
(T, 22, 3)             places of SMPL's first 22 joints, metres, y up; also (1, T, 22, 3)
(T, 24, 3), (T, 55, 3) the same with hands, where legs keep their lengths; else it is rotations
(T, 263)               HumanML3D's features; also (1, T, 263)
``motion``             (N, 22, 3, T) in a dictionary with ``lengths``: MDM's ``results.npy``
=====================  ===========================================================================

The features of a frame are the root's turn about y (half of it, to the next frame) and its step in
its own axes (2), its height, the other joints' places in the root's axes (63), 21 rotations of six
numbers, 22 velocities, and four contacts of feet. With the turns added up to α,

    root = Σ R_y(−2 α) step,    joint = R_y(−2 α) place + root.

The features' rotations are not used: HumanML3D derives them from positions, so they hold no twist.

Each limb of the body points as the source's does, and the chest has the same position. The rotation
about a bone (twist) follows from other joints, or is unknown:

1. pelvis and chest: from the directions to three joints that are fixed to them;
2. upper arms: an elbow bends about one axis, so the plane of upper arm and forearm shows the twist;
3. thighs: from the knee in the same way, and a little from the direction of the foot;
4. head, hands, feet: unknown. They follow the bone before them.

The straighter a limb, the less its plane says, so (2) and (3) are averaged over a quarter of a
second, weighted by the sine of the bend, with the shortest rotation from the parent as a prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gva_mi.body.pose import JOINTS, LARGEST_IN_FILES, PARENTS, ROOT_AND_BODY, SIDES
from gva_mi.body.rotations import nearest_rotations, shortest, to_matrices, to_rotvecs
from gva_mi.core.errors import InputError
from gva_mi.readers.retarget import Places, leg_length, on_body
from gva_mi.readers.track import Track
from gva_mi.readers.up_axis import unit

HUMANML3D_FPS = 20.0  # frames a second
HUMANML3D_FEATURES = 263  # numbers a frame
JOINT_COUNT = ROOT_AND_BODY.stop  # SMPL's joints without hands and face: its first 22
_JOINT_COUNTS = (JOINT_COUNT, 24, 52, 55)  # of bodies that start with these joints
# All chosen.
_LEG_VARIATION = 0.2  # share of a leg's length by which it may vary; rotations vary by more
_PARENT_WEIGHT = 0.08  # of the shortest rotation; a limb that is bent by 90 degrees has weight 1
_FOOT_WEIGHT = 0.2  # of the foot's direction, likewise
_SMOOTHING_SECONDS = 0.12  # standard deviation of the average over time
# Joints that are fixed to these two, as seen from them.
_FIXED_NEIGHBOURS = {"pelvis": ("left_hip", "right_hip", "spine1"),
          "spine3": ("neck", "left_collar", "right_collar")}  # fmt: skip
_BONES = {
    "neck": "head",
    **{f"{side}_{joint}": f"{side}_{child}" for side in SIDES for joint, child in (
        ("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"), ("collar", "shoulder"),
        ("shoulder", "elbow"), ("elbow", "wrist"))},
}  # fmt: skip
_HINGES = {  # limb: its lower part, and the axis about which that bends, in the T-pose
    "left_shoulder": ("left_elbow", (0.0, -1.0, 0.0)),
    "right_shoulder": ("right_elbow", (0.0, 1.0, 0.0)),
    "left_hip": ("left_knee", (1.0, 0.0, 0.0)), "right_hip": ("right_knee", (1.0, 0.0, 0.0)),
}  # fmt: skip


def joints_in(where: object, found: Any, sample: str | None) -> np.ndarray | None:  # noqa: ANN401
    """Return the joint positions (T, 22, 3) in a file's content, or None if it holds none.

    ``sample`` is the number of the motion in a file of several.
    """
    if isinstance(found, Mapping) and np.ndim(found.get("motion")) == 4:
        motions = np.moveaxis(np.asarray(found["motion"], np.float64), 3, 1)
        k = int(sample or 0) if (sample or "0").isdecimal() else -1
        if not 0 <= k < len(motions):
            raise InputError(
                f"{where}: has no motion '{sample}'; --person is one of 0 to {len(motions) - 1}"
            )
        lengths = np.ravel(found.get("lengths", ()))
        found = motions[k, : int(lengths[k]) if len(lengths) == len(motions) else None]
    if not isinstance(found, np.ndarray) or found.dtype.kind != "f":
        return None
    packed = len(found) == 1 and found.shape[2:] in ((HUMANML3D_FEATURES,), (JOINT_COUNT, 3))
    array = found[0] if packed else found
    if not len(array):
        return None
    if array.ndim == 2 and array.shape[1] == HUMANML3D_FEATURES:
        places = _of_features(array.astype(np.float64))
    elif array.ndim == 3 and array.shape[1] in _JOINT_COUNTS and array.shape[2] == 3:
        places = array[:, :JOINT_COUNT].astype(np.float64)
    else:
        return None
    if array.ndim == 3 and array.shape[1] != JOINT_COUNT and not _is_person(places):
        return None  # rotations
    if not _is_person(places):
        raise InputError(
            f"{where}: an array {array.shape} as in HumanML3D, but its legs change their lengths "
            "or differ; expected joints of a person, in metres: multiply a network's normalised "
            "features by its Std.npy and add its Mean.npy"
        )
    return places


def _of_features(features: np.ndarray) -> np.ndarray:
    """Return places (T, 22, 3) of HumanML3D's features (T, 263), by the module's formula."""
    before = np.concatenate([np.zeros((1, 3)), features[:-1, :3]])
    angles = -2 * np.cumsum(before[:, 0])
    R = to_matrices(angles[:, None] * [0.0, 1.0, 0.0])
    steps = np.stack([before[:, 1], np.zeros(len(before)), before[:, 2]], 1)
    root = np.cumsum(np.einsum("tab,tb->ta", R, steps), 0)
    places = np.einsum("tab,tjb->tja", R, features[:, 4:67].reshape(-1, JOINT_COUNT - 1, 3))
    root[:, 1] = features[:, 3]
    return np.concatenate([root[:, None], places + root[:, None] * [1.0, 0.0, 1.0]], 1)


def _is_person(places: np.ndarray) -> bool:
    """Whether numbers (T, 22, 3) may be joint positions: legs keep their lengths and are alike.

    Rotations of a person who stands still are constant, too. So thigh, shin, and the distance from
    pelvis to head are also compared.
    """
    places = places[(np.abs(places) < LARGEST_IN_FILES["transl"]).all((1, 2))]  # finite, too
    length = lambda a, b: np.linalg.norm(places[:, a] - places[:, b], axis=1)
    legs = [length(a, b) for a, b in ((1, 4), (2, 5), (4, 7), (5, 8))]
    if not len(places) or not all(leg.std() < _LEG_VARIATION * leg.mean() for leg in legs):
        return False
    left, right, *lower, trunk = map(np.median, (*legs, length(0, 15)))
    alike = (
        abs(left - right) < _LEG_VARIATION * left
        and abs(lower[0] - lower[1]) < _LEG_VARIATION * lower[0]
    )
    return alike and 0.6 < lower[0] / left < 1.7 and 0.7 < trunk / left < 2.5


def joints_track(places: np.ndarray, fps: float, body: np.ndarray) -> Track:
    """Return the track of a body that takes the pose of joint positions; NaN frames are left out.

    Args:
        places: (T, 22, 3) of SMPL-X's first joints, in any unit.
        fps: frames a second.
        body: (55, 3) joints at rest, metres.
    """
    known = np.flatnonzero((np.abs(places) < LARGEST_IN_FILES["transl"]).all((1, 2)))
    places = places[known]
    at = {name: places[:, k] for k, name in enumerate(JOINTS[:JOINT_COUNT])}
    own = dict(zip(JOINTS, body, strict=True))
    A = {}
    for name, around in _FIXED_NEIGHBOURS.items():
        ours = np.stack([unit(own[other] - own[name]) for other in around])
        theirs = np.stack([unit(at[other] - at[name]) for other in around], 1)
        A[name] = nearest_rotations(np.einsum("tka,kb->tab", theirs, ours))
    A |= _spine(A["pelvis"], A["spine3"], own, at)
    for name, parent in zip(JOINTS, PARENTS, strict=True):
        if name in A:
            continue
        A[name] = A[JOINTS[parent]]
        if name in _BONES:  # the shortest way by which the bone points as seen
            child = _BONES[name]
            ours, theirs = unit(A[name] @ (own[child] - own[name])), unit(at[child] - at[name])
            A[name] = to_matrices(shortest(ours, theirs)) @ A[name]
        if name in _HINGES:
            A[name] = _turned_by_hinge(A[name], at, name, fps)
    scale = leg_length(own) / leg_length(at)
    notes = [
        "rotations about bones are inferred; head, hands and feet follow the bone before them",
        f"positions are scaled by {scale:.3g}, so that the legs are as long as the body's",
    ]
    return on_body("joints without rotations", known, A, at, own, scale, notes)


def _spine(pelvis: np.ndarray, chest: np.ndarray, own: Places, at: Places) -> Places:
    """Return the rotations of the two joints between pelvis and chest.

    They lie between both, turned alike so that the chest is where it is seen from the first. Each
    on its own would not do: its bone is short, and programs place it differently.
    """
    between = to_rotvecs(pelvis.swapaxes(1, 2) @ chest)
    first, second = (pelvis @ to_matrices(share * between) for share in (1 / 3, 2 / 3))
    ours = first @ (own["spine2"] - own["spine1"]) + second @ (own["spine3"] - own["spine2"])
    turn = to_matrices(shortest(unit(ours), unit(at["spine3"] - at["spine1"])))
    return {"spine1": turn @ first, "spine2": turn @ second}


def _turned_by_hinge(A: np.ndarray, at: Places, name: str, fps: float) -> np.ndarray:
    """Return A (T, 3, 3) turned about its bone so that the next joint bends about its hinge."""
    joint, axis = _HINGES[name]
    bone, lower = unit(at[joint] - at[name]), unit(at[_BONES[joint]] - at[joint])
    seen = np.cross(bone, lower)  # as long as the sine of the bend
    if "knee" in joint:
        ankle, foot = at[_BONES[joint]], at[_BONES[_BONES[joint]]]
        seen = seen + _FOOT_WEIGHT * np.cross(unit(foot - ankle), bone)
    hinge = unit(np.cross(np.cross(bone, A @ np.array(axis)), bone))
    phase = (seen * hinge).sum(1) + 1j * (seen * np.cross(bone, hinge)).sum(1)
    angle = np.angle(_smoothed(phase, fps) + _PARENT_WEIGHT)
    return to_matrices(angle[:, None] * bone) @ A


def _smoothed(values: np.ndarray, fps: float) -> np.ndarray:
    """Return values (T,) averaged over time by a Gaussian, without those beyond the ends."""
    reach = max(1, round(3 * _SMOOTHING_SECONDS * fps))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (_SMOOTHING_SECONDS * fps)) ** 2)
    mean = lambda x: np.convolve(x, kernel)[reach : reach + len(values)]
    return mean(values) / mean(np.ones(len(values)))
