"""Where the landmarks of the face lie on a body, and how jaw and expression move them.

SMPL-X's files mark them. On another body they are found by the shape of its head: the eyes' joints
give the middle, the width and the height of the face, and the mouth is where the skin of the jaw
begins. A landmark is the vertex of the front that is nearest to its place in an average face.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS
from gva_mi.body.smplx import BodyModel, columns_of

EXPRESSIONS = 10  # coefficients that are fitted, at most
_HEAD, _JAW, _LEFT, _RIGHT = (
    JOINTS.index(n) for n in ("head", "jaw", "left_eye_smplhf", "right_eye_smplhf")
)
# Places in an average face, x to the person's left and y upward, in distances between the eyes. Of
# symmetric points the right one, which has the lower number, is given.
_FROM_EYES = {  # from the middle of the eyes
    17: (-0.83, 0.32), 18: (-0.74, 0.37), 19: (-0.60, 0.40), 20: (-0.45, 0.41), 21: (-0.23, 0.37),
    27: (0, 0.12), 28: (0, -0.02), 29: (0, -0.23), 30: (0, -0.42), 31: (-0.26, -0.58),
    32: (-0.13, -0.60), 33: (0, -0.62), 36: (-0.69, 0.03), 37: (-0.60, 0.10), 38: (-0.43, 0.12),
    39: (-0.29, 0.0), 40: (-0.41, -0.08), 41: (-0.56, -0.08),
}  # fmt: skip
_FROM_MOUTH = {  # from the middle of the mouth
    48: (-0.37, 0.02), 49: (-0.23, 0.17), 50: (-0.09, 0.20), 51: (0, 0.19), 57: (0, -0.22),
    58: (-0.09, -0.22), 59: (-0.22, -0.16), 60: (-0.30, 0.02), 61: (-0.09, 0.03), 62: (0, 0.03),
    66: (0, -0.03), 67: (-0.09, -0.03),
}  # fmt: skip
_MIRROR = {
    17: 26, 18: 25, 19: 24, 20: 23, 21: 22, 31: 35, 32: 34, 36: 45, 37: 44, 38: 43, 39: 42, 40: 47,
    41: 46, 48: 54, 49: 53, 50: 52, 58: 56, 59: 55, 60: 64, 61: 63, 67: 65,
}  # fmt: skip
_LOWER = {55, 56, 57, 58, 59, 65, 66, 67}  # that hang on the jaw


@dataclass(frozen=True)
class FacePoints:
    """The 51 landmarks of :data:`gva_mi.data.landmarks.FACE` on a body; float64.

    Attributes:
        rest: (51, 3) metres, in the T-pose of the mean person.
        betas: (B, 51, 3) metres, what one standard deviation of each beta adds.
        expressions: (E, 51, 3) metres, likewise of the expression.
        jaw: (51,) share of the jaw in their skinning; the rest is the head's.
    """

    rest: Tensor
    betas: Tensor
    expressions: Tensor
    jaw: Tensor

    @staticmethod
    def of(body: BodyModel) -> FacePoints | None:
        """Find them; None on a body whose file has no eyes, no jaw or no expression."""
        corners, shares = body.mark_corners, body.mark_shares
        if corners is None:
            at = _vertices(body)
            if at is None:
                return None
            corners, shares = at[:, None], body.v_template.new_ones(len(at), 1)
        if not body.num_expressions:
            return None

        def moves(rows: Tensor) -> Tensor:
            some = columns_of(rows, corners.flatten(), len(body.v_template))
            some = some[:, : 3 * corners.numel()].unflatten(1, (3, *corners.shape))
            return (some * shares).sum(-1).mT.double()

        return FacePoints(
            (body.v_template[corners] * shares[..., None]).sum(1).double(),
            moves(body.shape_directions),
            moves(body.expression_directions[:EXPRESSIONS]),
            (body.weights[corners, _JAW] * shares).sum(1).double(),
        )

    def at_rest(self, betas: Tensor) -> Tensor:
        """Return the landmarks (51, 3) of a shape (B,), metres; missing coefficients are zero."""
        betas = betas[: len(self.betas)]
        return self.rest + torch.einsum("b,bpc->pc", betas, self.betas[: len(betas)])


def _vertices(body: BodyModel) -> Tensor | None:
    """Return the vertex (51,) of each landmark; None without eyes or jaw."""
    v, eyes = body.v_template, body.j_template[[_LEFT, _RIGHT]]
    middle, wide = eyes.mean(0), (eyes[0] - eyes[1]).norm()
    jaw = body.weights[:, _JAW]
    front = (body.weights[:, _HEAD] + jaw > 0.5) & (v[:, 2] > middle[2] - 0.3 * wide)
    hangs = front & (jaw > 0.5)
    across = hangs & ((v[:, 0] - middle[0]).abs() < 0.15 * wide)
    if float(wide) < 0.02 or not bool(across.any()):
        return None
    mouth = torch.stack([middle[0], v[across, 1].max()])

    def nearest(number: int, goal: Tensor) -> int:
        among = front & (jaw > 0.5 if number in _LOWER else jaw < 0.5 if number > 47 else jaw < 2)
        apart = (v[:, :2] - goal).norm(dim=1) - 0.2 * v[:, 2]  # of equally near ones, the foremost
        return int(torch.where(among, apart, torch.inf).argmin())

    found = {}
    for places, origin in ((_FROM_EYES, middle[:2]), (_FROM_MOUTH, mouth)):
        for number, (x, y) in places.items():
            found[number] = nearest(number, origin + wide * v.new_tensor([x, y]))
            if number in _MIRROR:
                other = _MIRROR[number]
                found[other] = nearest(other, origin + wide * v.new_tensor([-x, y]))
    return torch.tensor([found[number] for number in sorted(found)])
