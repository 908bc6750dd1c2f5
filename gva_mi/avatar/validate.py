"""Validation of an avatar's arrays from any file: of the right form, finite, and of one body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS
from gva_mi.core.arrays import shape_fault
from gva_mi.core.files import require_array

TEXTS = {"format", "description"}  # arrays of an avatar's file
WHOLE = {"rest_faces", "rest_pose_features", "skin_beneath", "beneath"}
LARGEST, LARGEST_LOG = 1e6, 20  # of any number; of the logarithm of metres
SUM = 0.01  # tolerance of a vertex's sum of skinning weights, and of a negative one


def tensors_of(path: Path, arrays: Mapping[str, np.ndarray]) -> dict[str, Tensor]:
    """Return the arrays of a file as float32, or as whole numbers, without its texts."""
    tensors = {}
    for name, array in arrays.items():
        if name not in TEXTS:
            kind, dtype = ("iu", np.int64) if name in WHOLE else ("f", np.float32)
            array = require_array(path, name, array, kind=kind).astype(dtype, copy=False)
            tensors[name] = torch.from_numpy(array)
    return tensors


def require_same_form(state: Mapping[str, Tensor], own: Mapping[str, Tensor]) -> None:
    """Raise a ValueError unless a state has the names and shapes of an avatar's ``own``."""
    for name in sorted(state.keys() ^ own.keys()):
        raise ValueError(f"'{name}' is {'missing' if name in own else 'unknown'}")
    for name, x in own.items():
        if fault := shape_fault(state[name].shape, tuple(x.shape)):
            raise ValueError(f"'{name}' {fault}")


def require_valid(state: Mapping[str, Tensor], parents: Sequence[int]) -> None:
    """Refuse tensors of an avatar's record with numbers that would fail later, or draw nothing.

    Raises:
        ValueError: names the first thing that is wrong.
    """
    for name, x in state.items():
        largest = LARGEST_LOG if name == "canonical.log_scales" else LARGEST
        if x.is_complex() or x.is_floating_point() and not (x.abs() <= largest).all():
            raise ValueError(f"'{name}' must hold finite numbers of at most {largest:,}")
    J, V, N = len(JOINTS), len(state["rest_vertices"]), len(state["canonical.means"])
    shapes = {  # None: any number
        "rest_joints": (J, 3), "rest_vertices": (V, 3), "rest_weights": (V, J),
        "rest_faces": (None, 3), "rest_looseness": (V,), "rest_directions": (V, 3, None),
        "rest_pose_features": (None,), "rest_expression_joints": (J, 3, None),
        "rest_betas": (None,), "canonical.means": (N, 3), "canonical.quats": (N, 4),
        "canonical.weights": (N, J), "light": (3,),
    }  # fmt: skip
    for name, shape in shapes.items():
        if fault := shape_fault(state[name].shape, shape):
            raise ValueError(f"'{name}' {fault}")
    ends = {"rest_faces": V, "skin_beneath": V, "rest_pose_features": 9 * (J - 1)}
    for name, end in ends.items():
        numbers = state[name]
        outside = numbers.numel() and not 0 <= int(numbers.min()) <= int(numbers.max()) < end
        if numbers.is_floating_point() or outside:
            raise ValueError(f"'{name}' must be whole numbers from 0 to {end - 1}")
    weights = state["rest_weights"]
    if weights.min() < -SUM or ((weights.sum(1) - 1).abs() > SUM).any():
        raise ValueError("'rest_weights' must be shares that sum to 1 for each vertex")
    before = all(type(p) is int and 0 <= p < k for k, p in enumerate(parents[1:], 1))
    if len(parents) != J or parents[0] != -1 or not before:
        raise ValueError("'parents' must be -1 for the root, and an earlier joint for the others")
