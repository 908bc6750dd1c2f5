"""A person whose height is known: the body gets it, and its distance follows.

One camera tells neither how large a person is nor how far away: a larger person farther away makes
the same picture. A height that somebody measured decides the first. The rest height of a body, from
the top of the head to the soles, is that of its two vertices ``a`` and ``b`` highest and lowest in
the mean person, and linear in the shape:

1. ``h(β) = h_0 + g · β``,    ``g = (S_a - S_b)_y``.
2. The shape of height ``H`` nearest to stage 1's, in standard deviations, is
   ``β + g (H - h(β)) / |g|²``.
3. The picture stays as it was where the person's distance grows as the person does: every frame's
   pelvis moves along its line of sight, by the factor ``h(β') / h(β)``. That is right for an
   estimator that finds the distance by the size. Pictures are not asked where the person stands
   then: of somebody 4 m away, hair and soles are 2 % of the outline, which is 8 cm of distance.
4. A descent that moves the shape holds the height with ``(h(β) - H)²``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.ranges import Within
from gva_mi.splat import Camera

PEOPLE = Within(0.4, 2.6, unit="metres")  # their heights


@dataclass(frozen=True)
class Stature:
    """The rest height of a body by its shape (1)."""

    mean: float  # h_0, metres
    slope: Tensor  # g (B,), metres for one standard deviation

    @staticmethod
    def of(body: BodyModel) -> Stature:
        """Measure a body."""
        y = body.v_template[:, 1]
        ends = [int(y.argmax()), int(y.argmin())]
        at_ends = lambda shape: body.rest(shape).vertices[ends, 1].double()
        heights = lambda shape: at_ends(shape)[0] - at_ends(shape)[1]
        unit, mean = torch.eye(body.num_betas, dtype=y.dtype), heights(Shape(y.new_zeros(0)))
        slope = torch.stack([heights(Shape(beta)) - mean for beta in unit])
        return Stature(float(mean), slope.to(y.dtype))

    def height(self, shape: Shape) -> Tensor:
        """Eq. 1, metres; differentiable in the shape."""
        betas = shape.betas[: len(self.slope)]
        return self.mean + self.slope[: len(betas)] @ betas

    def energy(self, shape: Shape, height: float) -> Tensor:
        """Eq. 4, square metres."""
        return (self.height(shape) - height).square()

    def nearest(self, shape: Shape, height: float) -> Shape:
        """Eq. 2: the shape that has a height, nearest to another one."""
        slope = torch.zeros_like(shape.betas)
        slope[: len(self.slope)] = self.slope[: len(slope)]
        missing = height - self.height(shape)
        return Shape(shape.betas + slope * missing / slope.square().sum())


def with_height(
    body: BodyModel, pose: Pose, shape: Shape, cameras: Sequence[Camera], height: float
) -> tuple[Pose, Shape]:
    """Poses and shape of a person of known height who fills the picture as before (2, 3).

    Args:
        body: that the poses move.
        pose: T frames; rotations stay as they are.
        shape: the person's, of stage 1.
        cameras: of the T frames.
        height: of the person, metres.

    Raises:
        InputError: no person is so tall.
    """
    PEOPLE.require("with_height()", "height", height)
    stature = Stature.of(body)
    taller = stature.nearest(shape, height)
    factor = height / float(stature.height(shape))
    joints = [body.rest(s).joints[0].double() for s in (shape, taller)]  # the pelvis at rest
    eyes = torch.from_numpy(np.stack([camera.position for camera in cameras]))
    pelvis = eyes + factor * (joints[0] + pose.transl.double() - eyes)
    moved = (pelvis - joints[1]).to(pose.transl.dtype)
    return Pose(pose.rotations, moved, pose.expression), taller
