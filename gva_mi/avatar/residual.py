"""The pose-conditioned residual of Sec. 4.1, mu' = mu + MLP(theta): clothes crease and slide.

The network is a function of *where* on the rest body and *which pose*, not of which Gaussian:
density control and re-initialisation may change the Gaussians, and what was learned stays.

1. z_j = tanh(A_j vec(R_j - I))                              a joint's code; none for the root
2. c   = sum_p W_p(x) (z_p + sum of z_q over children q of p)      what bends around x: fingers, too
3. e   = (x, sin(2^k pi x), cos(2^k pi x)), k < L     x: the rest mean scaled to [-1, 1]
4. f(c) = O relu(H relu(E e + C c + b) + h)
5. MLP(theta) = (f(c) - f(0)) · 1 cm                         O = 0 at the start: no residual

The root is left out because turning around or walking does not change an avatar. The tanh bounds
the residual in unseen poses. Where no joint bends it is zero: what all poses share belongs to the
canonical Gaussians. Eq. 9 keeps |MLP(theta)| small.

Off by default. It fits the video but makes pictures of unseen poses worse, even under ground-truth
poses. The smaller its weight in Eq. 9, the worse they are: a short video does not determine how
cloth depends on a pose. One code of all joints together instead of (1, 2) spoils test frames and
novel views, too. ``gva-mi study avatar --rows full "with residual"`` measures it.

Sources: the residual is Sec. 4.1 of the paper, which leaves the network open; eq. 3 is the encoding
of NeRF (Mildenhall et al., 2020); the codes of eq. 1 and 2 are ours.
"""

from __future__ import annotations

import math
from typing import Annotated

import torch
from torch import Tensor, nn

from gva_mi.body.pose import PARENTS
from gva_mi.body.so3 import to_matrix
from gva_mi.core.options import PythonOnly, Within, options_of

# Metres per unit of the last layer. Chosen: Adam's steps are parts of a millimetre.
OUTPUT_UNIT = 0.01


@options_of("fit")
class ResidualOptions:
    """The size of the network.

    Example:
        >>> ResidualOptions(enabled=True).width
        32
    """

    enabled: PythonOnly[bool] = False  # mu' = mu
    # Numbers that describe what bends around a point.
    code: PythonOnly[Annotated[int, Within(1, 4096)]] = 8
    # L; the finest wavelength is 2^(1 - L) of the body's height.
    frequencies: PythonOnly[Annotated[int, Within(1, 24)]] = 4
    width: PythonOnly[Annotated[int, Within(1, 4096)]] = 32  # of both hidden layers


class PoseResidual(nn.Module):
    """The network MLP(theta): an offset in metres for every rest mean, zero at the start.

    ``center`` (3,) and ``extent``, half of the largest side, describe the box of the rest body,
    metres; the generator draws the initial weights.

    Example:
        >>> residual = PoseResidual(ResidualOptions(), torch.zeros(3), extent=0.9)
        >>> means, weights = torch.rand(10, 3), torch.full((10, 55), 1 / 55)
        >>> offsets = residual(means, weights, torch.zeros(55, 3))  # no joint bends
        >>> offsets.shape, bool(offsets.any())
        (torch.Size([10, 3]), False)
    """

    def __init__(
        self,
        options: ResidualOptions,
        center: Tensor,
        extent: float,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        self.options = options
        self.register_buffer("center", center.detach().clone().float())
        self.register_buffer("extent", torch.tensor(float(extent)))
        self.register_buffer("near", near_joints(), persistent=False)
        features = 3 + 6 * options.frequencies
        self.codes = nn.Parameter(torch.empty(len(PARENTS), options.code, 9))  # A
        self.place = nn.Linear(features, options.width)
        self.condition = nn.Linear(options.code, options.width, bias=False)
        self.hidden = nn.Linear(options.width, options.width)
        self.offset = nn.Linear(options.width, 3, bias=False)
        with torch.no_grad():
            self.codes.uniform_(-(3**0.5), 3**0.5, generator=generator)  # a radian's code is 1
            for layer in (self.place, self.condition, self.hidden):
                bound = math.sqrt(3 / layer.in_features)  # unit variance in, unit variance out
                layer.weight.uniform_(-bound, bound, generator=generator)
                if layer.bias is not None:
                    layer.bias.zero_()
            self.offset.weight.zero_()

    def forward(self, means: Tensor, weights: Tensor, rotations: Tensor) -> Tensor:
        """Return offsets (N, 3) of means (N, 3) in the rest pose, metres.

        ``weights`` (N, 55) are skinning weights, ``rotations`` (55, 3) axis-angle of all joints.
        Not differentiable in ``means``: the pictures decide where a Gaussian lies, not the slope of
        the network.
        """
        turned = to_matrix(rotations)
        bent = (turned - torch.eye(3, dtype=turned.dtype, device=turned.device)).flatten(1)
        code = torch.tanh((self.codes @ bent[..., None])[..., 0])  # z
        at = self.place(self._encode(means.detach()))
        around = weights @ (self.near @ code)
        moved = self._last_hidden(at + self.condition(around)) - self._last_hidden(at)
        return self.offset(moved) * OUTPUT_UNIT

    def _last_hidden(self, x: Tensor) -> Tensor:
        """Return the input of O in eq. 4, given the input of the first relu."""
        return torch.relu(self.hidden(torch.relu(x)))

    def _encode(self, means: Tensor) -> Tensor:
        """Return e of eq. 3, (N, 3 + 6 L)."""
        x = (means - self.center) / self.extent
        sines, cosines = [torch.sin(math.pi * x)], [torch.cos(math.pi * x)]
        for _ in range(1, self.options.frequencies):  # double angles: cheaper than sines
            s, c = sines[-1], cosines[-1]
            sines.append(2 * s * c)
            cosines.append(1 - 2 * s * s)
        return torch.cat([x, *sines, *cosines], dim=1)


def near_joints() -> Tensor:
    """Return a matrix (55, 55): the joints that bend a joint's skin, itself and its children.

    Example:
        >>> from gva_mi.body.pose import JOINTS
        >>> [JOINTS[j] for j in near_joints()[JOINTS.index("left_elbow")].nonzero()]
        ['left_elbow', 'left_wrist']
    """
    near = torch.eye(len(PARENTS))
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            near[parent, joint] = 1
    near[:, 0] = 0  # the root bends nothing
    return near
