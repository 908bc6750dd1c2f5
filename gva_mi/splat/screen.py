"""The Gaussians as one picture saw them: what densification, and gsplat's ``meta``, need to know.

The gradient by each Gaussian's mean in the picture::

    screen = Screen()
    image = render(gaussians, camera, screen=screen)
    loss(image).backward()
    moved = screen.grad.norm(dim=1)  # loss per pixel of motion; 0 where not screen.visible
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import torch
from torch import Tensor

from gva_mi.splat.kernels.packets import Packets
from gva_mi.splat.kernels.passes import Saved
from gva_mi.splat.kernels.project import Projected
from gva_mi.splat.kernels.records import Footprint, Format, Splat


@dataclass
class Screen:
    """The Gaussians as one picture saw them: filled by ``render``, gradients by ``backward``."""

    means2d: Tensor | None = None  # (N, 2) px; meaningless where not visible
    radii: Tensor | None = None  # (N,) px, 3 sigma of the longer axis; 0 where not drawn
    grad: Tensor | None = None  # (N, 2) dL/dmeans2d, per px; 0 where not drawn
    absolute: bool = False  # set to have absgrad filled as well
    absgrad: Tensor | None = None  # (N, 2) grad with the share of every pixel taken absolutely
    projected: Projected | None = None  # of the kernels; None where there is no Gaussian
    format: Format | None = None  # of its splats

    @property
    def visible(self) -> Tensor:
        """Whether each Gaussian touches the picture, (N,) bool."""
        return self.radii > 0

    def fill(self, saved: Saved, means: Tensor) -> None:
        """Read the Gaussians out of what the kernels saved.

        Args:
            saved: what ``render_forward`` returned.
            means: (N, 3) of the Gaussians.
        """
        self.grad = self.absgrad = None
        self.projected, self.format = saved.projected, saved.plan.formats[0]
        if self.projected is None:
            self.means2d, self.radii = means.new_zeros(len(means), 2), means.new_zeros(len(means))
            return
        self.means2d = torch.stack(self._splat.u, dim=1)
        self.radii = self.projected.radii.torch()

    @property
    def extents(self) -> Tensor:
        """How far each reaches in x and y, alpha >= alpha_min, (N, 2) px; 0 where culled."""
        if self.projected is None:
            return self.means2d
        found = Footprint.unpack(self._columns(self.projected.footprints))
        return torch.where(found.ry >= 0, torch.stack([found.rx, found.ry]), 0).T

    @property
    def conics(self) -> Tensor:
        """Inverse covariances in the picture, (N, 3): xx, xy, yy, per px^2."""
        if self.projected is None:
            return self.means2d.new_zeros(0, 3)
        p, q, r = self._splat.p, self._splat.q, self._splat.r
        return 2 * math.log(2) * torch.stack([p * p, p * q, q * q + r * r], dim=1)

    @property
    def opacities(self) -> Tensor:
        """Opacities as drawn: less than the Gaussians' own with ``antialiased``, (N,)."""
        if self.projected is None:
            return self.means2d.new_zeros(0)
        return torch.exp2(self._splat.lo)

    @property
    def _splat(self) -> Splat:
        """The record of all Gaussians, its fields as tensors (N,); colours of the first chunk."""
        return Splat.unpack(self._columns(self.projected.splats[0]), self.format)

    def _columns(self, record: Packets) -> list[Tensor]:
        n = dr.width(self.projected.radii)
        return [column for part in record for column in part.torch().view(n, -1).unbind(1)]
