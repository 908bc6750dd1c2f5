"""The face of a body at rest, which wears neither clothes nor hair.

The joints of the eyes give its place and its size. Here places are relative to the middle between
the eyes, x to the person's left, y upward and z forward, in distances between the eyes.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gva_mi.body.pose import EYES, JAW_AND_EYES, JOINTS
from gva_mi.body.smplx import Rest

# The largest coordinate that still belongs to the face, of -x, x, -y, y and -z. Chosen: from chin
# to brows and from cheek to cheek. A fringe hangs to the brows, and long hair before the ears.
BORDERS = (1.0, 1.0, 1.6, 0.3, 0.6)
EDGE = 0.4  # beyond the borders, where the face ends; chosen: half the width of an ear
_HEAD = [JOINTS.index("head"), *range(*JAW_AND_EYES.indices(len(JOINTS)))]


def from_eyes(rest: Rest) -> Tensor:
    """Return the vertices of a body at rest (V, 3) as seen from the middle between the eyes.

    Example:
        The mouth of a face is about as far below the eyes as these are apart.

        >>> joints = torch.zeros(55, 3)
        >>> joints[EYES] = torch.tensor([[0.03, 1.6, 0.1], [-0.03, 1.6, 0.1]])
        >>> from_eyes(Rest(torch.tensor([[0.0, 1.54, 0.1]]), joints)).round(decimals=3)
        tensor([[ 0., -1.,  0.]])
    """
    left, right = rest.joints[EYES]
    return (rest.vertices - (left + right) / 2) / (left - right).norm()


def face_shares(rest: Rest, weights: Tensor) -> Tensor:
    """Return how far each vertex belongs to the face, (V,) in [0, 1]; 0 where a body has no eyes.

    Args:
        rest: V vertices and the joints.
        weights: (V, 55) skinning weights; only what the head moves is face.

    Example:
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> body = load_body()
        >>> rest = body.rest(Shape(torch.zeros(10)))
        >>> face = face_shares(rest, body.weights) == 1
        >>> top, bottom = rest.vertices[:, 1].max(), rest.vertices[face, 1].min()
        >>> bool(0.2 < top - bottom < 0.25)  # metres from the crown to the chin
        True
    """
    x, y, z = from_eyes(rest).T
    beyond = torch.stack([-x, x, -y, y, -z], dim=1) - x.new_tensor(BORDERS)
    shares = (1 - beyond.amax(1) / EDGE).clamp(0, 1)
    of_head = weights[:, _HEAD].sum(1) > 0.5
    return torch.where(of_head & shares.isfinite(), shares, 0)
