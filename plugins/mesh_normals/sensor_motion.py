"""Derivative by the sensor's pose: moving the sensor moves the whole scene the opposite way.

With ``T`` the sensor's ``to_world`` and ``y = T^{-1} x̃`` a point in the sensor's frame:

1. moving vertices      ``dx = -dT y``: an image in the sensor's frame changes alike,
2. turning directions   ``dn = dT T^{-1} n``: what an image shows in world axes, such as its
   normals, turns with the sensor besides.

Gradients are those by the entries of ``T``, of which the last row is not used. They hold for any
``dT`` in an orthographic view. A pinhole sensor is rigid: there only the ``dT`` of rotations and
translations have a meaning.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def opposite_motion(
    d_to_world: mi.Matrix4f, to_world: mi.Matrix4f, positions: mi.Vector3f
) -> mi.Vector3f:
    """Eq. 1 forward, (V,)."""
    move = d_to_world @ (dr.rcp(to_world) @ mi.Vector4f(*positions, 1))
    return -mi.Vector3f(move.x, move.y, move.z)


def adjoint_motion(
    grad_positions: mi.Vector3f, to_world: mi.Matrix4f, positions: mi.Vector3f
) -> mi.Matrix4f:
    """Eq. 1 backward: from the gradient by the positions (V,) to that by ``T``."""
    return _outer(-grad_positions, dr.rcp(to_world) @ mi.Vector4f(*positions, 1))


def turn(d_to_world: mi.Matrix4f, to_world: mi.Matrix4f, n: mi.Vector3f) -> mi.Vector3f:
    """Eq. 2 forward, for directions (R,)."""
    dn = d_to_world @ (dr.rcp(to_world) @ mi.Vector4f(*n, 0))
    return mi.Vector3f(dn.x, dn.y, dn.z)


def adjoint_turn(grad_n: mi.Vector3f, to_world: mi.Matrix4f, n: mi.Vector3f) -> mi.Matrix4f:
    """Eq. 2 backward: from the gradient by directions (R,) to that by ``T``."""
    return _outer(grad_n, dr.rcp(to_world) @ mi.Vector4f(*n, 0))


def _outer(grad: mi.Vector3f, y: mi.Vector4f) -> mi.Matrix4f:
    """Σ grad yᵀ, with a last row of zeros."""
    dr.eval(grad, y)
    return mi.Matrix4f([[dr.sum(g * entry) for entry in y] for g in grad] + [[0, 0, 0, 0]])
