"""Read motions of joints without rotations: HumanML3D's, and those of networks trained on it.

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

The rotations are not SMPL's: HumanML3D makes them of places, so they hold no twist, and are not
used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gva_mi.body.pose import LARGEST
from gva_mi.body.rotations import to_matrices
from gva_mi.core.errors import InputError
from gva_mi.data.importers.joint_fit import COUNT

RATE = 20.0  # frames a second of HumanML3D
FEATURES = 263
_COUNTS = (22, 24, 52, 55)  # joints of bodies that share the first 22
_EVEN = 0.2  # of a leg's length, by which it varies at most


def joints_in(where: object, found: Any, sample: str | None) -> np.ndarray | None:  # noqa: ANN401
    """Return places (T, 22, 3) of a person's joints in a file's content, or None if it has none.

    ``sample`` is the number of one of several motions.
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
    packed = len(found) == 1 and found.shape[2:] in ((FEATURES,), (COUNT, 3))
    array = found[0] if packed else found
    if not len(array):
        return None
    if array.ndim == 2 and array.shape[1] == FEATURES:
        places = _of_features(array.astype(np.float64))
    elif array.ndim == 3 and array.shape[1] in _COUNTS and array.shape[2] == 3:
        places = array[:, :COUNT].astype(np.float64)
    else:
        return None
    if array.ndim == 3 and array.shape[1] != COUNT and not _is_person(places):
        return None  # rotations
    if not _is_person(places):
        raise InputError(
            f"{where}: {array.shape} as of HumanML3D, but legs change their lengths or differ, so "
            "these are no joints of a person; features that a network was given must be "
            "multiplied by its Std.npy, and its Mean.npy added"
        )
    return places


def _of_features(features: np.ndarray) -> np.ndarray:
    """Return places (T, 22, 3) of HumanML3D's features (T, 263), by the module's formula."""
    before = np.concatenate([np.zeros((1, 3)), features[:-1, :3]])
    angles = -2 * np.cumsum(before[:, 0])
    R = to_matrices(angles[:, None] * [0.0, 1.0, 0.0])
    steps = np.stack([before[:, 1], np.zeros(len(before)), before[:, 2]], 1)
    root = np.cumsum(np.einsum("tab,tb->ta", R, steps), 0)
    places = np.einsum("tab,tjb->tja", R, features[:, 4:67].reshape(-1, COUNT - 1, 3))
    root[:, 1] = features[:, 3]
    return np.concatenate([root[:, None], places + root[:, None] * [1.0, 0.0, 1.0]], 1)


def _is_person(places: np.ndarray) -> bool:
    """Whether numbers (T, 22, 3) may be places of joints: legs keep their lengths and are alike.

    Rotations of somebody who stands still keep theirs, too, so a thigh, a shin and the way from
    pelvis to head are also compared.
    """
    places = places[(np.abs(places) < LARGEST["transl"]).all((1, 2))]  # finite, too
    length = lambda a, b: np.linalg.norm(places[:, a] - places[:, b], axis=1)
    legs = [length(a, b) for a, b in ((1, 4), (2, 5), (4, 7), (5, 8))]
    if not len(places) or not all(leg.std() < _EVEN * leg.mean() for leg in legs):
        return False
    left, right, *lower, trunk = map(np.median, (*legs, length(0, 15)))
    alike = abs(left - right) < _EVEN * left and abs(lower[0] - lower[1]) < _EVEN * lower[0]
    return alike and 0.6 < lower[0] / left < 1.7 and 0.7 < trunk / left < 2.5
