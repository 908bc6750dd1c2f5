"""Validation of an avatar's numbers from any file: finite, and of one body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor

from gva_mi.body.pose import JOINTS
from gva_mi.core.arrays import shape_fault

LARGEST, LARGEST_LOG = 1e6, 20  # of any number; of the logarithm of metres
SUM = 0.01  # tolerance of a vertex's sum of skinning weights, and of a negative one


def require_valid(state: Mapping[str, Tensor], parents: Sequence[int]) -> None:
    """Refuse numbers that would fail later, or draw nothing.

    Args:
        state: the avatar's tensors by name, as in Avatar.record.
        parents: of the joints, -1 for the root.

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
    for name, end in (("rest_faces", V), ("rest_pose_features", 9 * (J - 1))):
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
