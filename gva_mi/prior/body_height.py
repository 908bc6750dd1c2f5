"""A measured height sets the body's size, and its distance follows.

One camera cannot separate a person's size from their distance. A measured height decides the size.
The rest height of a body is the height of vertex ``a`` above vertex ``b``, which are the highest
and the lowest vertex of the mean person. It is linear in the shape:

1. ``h(β) = h_0 + g · β``,    ``g = (S_a - S_b)_y``.
2. Among the shapes of height ``H``, ``β' = β + g (H - h(β)) / |g|²`` is nearest to ``β``, in
   standard deviations.
3. The image stays the same if the pelvis of every frame moves along its line of sight by the factor
   ``h(β') / h(β)``. This is right for an estimator that derives distance from size. Depth is scaled
   with body size and not fitted, because hair and shoes bias the silhouette: 4 m away they are 2 %
   of the outline, which is 8 cm of distance.
4. An optimisation that changes the shape keeps the height by the penalty ``(h(β) - H)²``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.errors import InputError
from gva_mi.core.options import Within
from gva_mi.splat import Camera

# Heights that are accepted. Chosen: every standing person, children included.
PERSON_HEIGHTS = Within(0.4, 2.6, unit="metres")
HEIGHT_ROUNDING = 0.01  # metres, of a height that is given; chosen: people know theirs so well


@dataclass(frozen=True)
class Stature:
    """The rest height of a body as a function of its shape (1)."""

    mean: float  # h_0, metres
    slope: Tensor  # g (B,), metres per standard deviation of each beta

    @staticmethod
    def of(body: BodyModel) -> Stature:
        """Measure the height of a body model."""
        y = body.v_template[:, 1]
        ends = [int(y.argmax()), int(y.argmin())]
        at_ends = lambda shape: body.rest(shape).vertices[ends, 1].double()
        heights = lambda shape: at_ends(shape)[0] - at_ends(shape)[1]
        unit, mean = torch.eye(body.num_betas, dtype=y.dtype), heights(Shape(y.new_zeros(0)))
        slope = torch.stack([heights(Shape(beta)) - mean for beta in unit])
        return Stature(float(mean), slope.to(y.dtype))

    def height(self, shape: Shape) -> Tensor:
        """Return eq. 1, metres; differentiable in the shape."""
        betas = shape.betas[: len(self.slope)]
        return self.mean + self.slope[: len(betas)] @ betas

    def energy(self, shape: Shape, height: float) -> Tensor:
        """Return eq. 4, square metres."""
        return (self.height(shape) - height).square()

    def nearest(self, shape: Shape, height: float) -> Shape:
        """Return eq. 2: among the shapes of this height, the nearest to the given shape.

        Raises:
            InputError: all shapes of the body have one height, and it is another.
        """
        slope = torch.zeros_like(shape.betas)
        slope[: len(self.slope)] = self.slope[: len(slope)]
        missing = height - self.height(shape)
        if not bool(slope.any()):
            if abs(float(missing)) > HEIGHT_ROUNDING:
                raise InputError(
                    f"the body is {self.mean:.2f} m tall in every shape; expected this height, or "
                    f"a body whose betas change it, got {height:.2f} m"
                )
            return shape
        return Shape(shape.betas + slope * missing / slope.square().sum())


def with_height(
    body: BodyModel, pose: Pose, shape: Shape, cameras: Sequence[Camera], height: float
) -> tuple[Pose, Shape]:
    """Give a person a known height without a change in the images; return T poses and the shape.

    Rotations stay, distances follow eq. 3.
    """
    stature = Stature.of(body)
    taller = stature.nearest(shape, height)
    factor = height / float(stature.height(shape))
    joints = [body.rest(s).joints[0].double() for s in (shape, taller)]  # the pelvis at rest
    eyes = torch.from_numpy(np.stack([camera.position for camera in cameras]))
    pelvis = eyes + factor * (joints[0] + pose.transl.double() - eyes)
    moved = (pelvis - joints[1]).to(pose.transl.dtype)
    return Pose(pose.rotations, moved, pose.expression), taller
