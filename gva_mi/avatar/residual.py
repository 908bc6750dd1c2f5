"""The pose-conditioned residual of Sec. 4.1, mu' = mu + MLP(theta): clothes crease and slide.

The network is a function of *where* on the rest body and *which pose*, not of which Gaussian:
densification and re-initialisation may change the Gaussians, and what was learned stays.

1. c = tanh(A vec(R_1 - I, ..., R_21 - I) + a)       pose code, without the root
2. e = (x, sin(2^k pi x), cos(2^k pi x)), k < L      x: the rest mean scaled to [-1, 1]
3. h = relu(E e + C c + b),  h' = relu(H h + h0)
4. MLP(theta) = (O h' + o) · 1 cm                    O = o = 0 at the start: no residual

The root is left out, for an avatar that turns around or walks away is the same avatar. The tanh
bounds the residual of poses that no frame has shown. Eq. 9 keeps |MLP(theta)| small.

Not used by default. With the paper's weight of 0.5 in Eq. 9, per metre, it does not move. With a
weight that lets it, it moves Gaussians in all poses alike, which the canonical ones could do as
well; pictures of poses that no frame has shown are no better, and a step takes longer.
``gva-mi study avatar --rows full "with residual"`` measures it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import roma
import torch
from torch import Tensor, nn

from gva_mi.body.pose import BODY
from gva_mi.ranges import Within, require_ranges

OUTPUT_UNIT = 0.01  # metres per unit of the last layer: Adam's steps are parts of a millimetre


@dataclass(frozen=True)
class ResidualOptions:
    """The size of the network."""

    enabled: bool = False  # mu' = mu
    code: Annotated[int, Within(1, 4096)] = 8  # numbers that describe a pose
    # L; the finest wavelength is 2^(1 - L) of the body's height.
    frequencies: Annotated[int, Within(1, 24)] = 4
    width: Annotated[int, Within(1, 4096)] = 32  # of both hidden layers

    def __post_init__(self) -> None:
        require_ranges("ResidualOptions", self)


class PoseResidual(nn.Module):
    """MLP(theta): an offset in metres for every rest mean, zero at the start.

    Args:
        options: the size of the network.
        center: (3,) metres, middle of the rest body.
        extent: half of the rest body's largest side, metres.
        generator: draws the initial weights.
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
        joints = BODY.stop - BODY.start
        features = 3 + 6 * options.frequencies
        self.pose_code = nn.Linear(9 * joints, options.code)
        self.place = nn.Linear(features, options.width)
        self.condition = nn.Linear(options.code, options.width, bias=False)
        self.hidden = nn.Linear(options.width, options.width)
        self.offset = nn.Linear(options.width, 3)
        with torch.no_grad():
            for layer in (self.pose_code, self.place, self.condition, self.hidden):
                bound = math.sqrt(3 / layer.in_features)  # unit variance in, unit variance out
                layer.weight.uniform_(-bound, bound, generator=generator)
                if layer.bias is not None:
                    layer.bias.zero_()
            self.offset.weight.zero_()
            self.offset.bias.zero_()

    def forward(self, means: Tensor, rotations: Tensor) -> Tensor:
        """Offsets in the rest pose.

        Args:
            means: (N, 3) metres, rest pose.
            rotations: (55, 3) axis-angle of all joints, in the order of JOINTS.

        Returns:
            (N, 3) metres.

        Note:
            Not differentiable in ``means``: the pictures decide where a Gaussian lies, and not the
            slope of the network.
        """
        turned = roma.rotvec_to_rotmat(rotations[BODY])
        identity = torch.eye(3, dtype=turned.dtype, device=turned.device)
        code = torch.tanh(self.pose_code((turned - identity).flatten()))
        # All points share one pose: its code is a bias, and not a feature of each point.
        bias = self.place.bias + self.condition(code)
        h = torch.relu(torch.addmm(bias, self._encode(means.detach()), self.place.weight.T))
        return self.offset(torch.relu(self.hidden(h))) * OUTPUT_UNIT

    def _encode(self, means: Tensor) -> Tensor:
        """e of eq. 2, (N, 3 + 6 L)."""
        x = (means - self.center) / self.extent
        sines, cosines = [torch.sin(math.pi * x)], [torch.cos(math.pi * x)]
        for _ in range(1, self.options.frequencies):  # double angles: cheaper than sines
            s, c = sines[-1], cosines[-1]
            sines.append(2 * s * c)
            cosines.append(1 - 2 * s * s)
        return torch.cat([x, *sines, *cosines], dim=1)
