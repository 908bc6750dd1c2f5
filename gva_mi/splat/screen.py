"""The Gaussians in the picture: means, sizes and gradients, for densification and gsplat's meta.

The gradient by each Gaussian's mean in the picture::

    screen = Screen()
    image = render(gaussians, camera, screen=screen)
    loss(image).backward()
    moved = screen.grad.norm(dim=1)  # loss per pixel of motion; 0 where not screen.visible
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import drjit as dr
import numpy as np
import torch
from torch import Tensor

from gva_mi.jit import packets
from gva_mi.jit.exclusive import exclusive
from gva_mi.jit.tensors import tensor_of
from gva_mi.splat.kernels.project import ProjectedMemory
from gva_mi.splat.kernels.records import Footprint, RecordFormat, Splat
from gva_mi.splat.kernels.saved import SavedState
from gva_mi.splat.tensors import first_two_columns


@dataclass
class Screen:
    """The Gaussians in one picture; ``render`` fills it, ``backward`` adds the gradients.

    Every property is read from the kernels' memory when it is used; unused ones cost nothing.
    """

    absolute: bool = False  # set to have absgrad filled as well
    grad: Tensor | None = None  # (N, 2) dL/dmeans2d, per px; 0 where not drawn
    absgrad: Tensor | None = None  # (N, 2) like grad, with the absolute value of each pixel's share
    memory: KernelMemory | None = field(default=None, repr=False)

    def fill(self, saved: SavedState, means: Tensor) -> None:
        """Take over the memory of a forward pass of Gaussians with means (N, 3)."""
        self.grad = self.absgrad = None
        size = (saved.layout.width, saved.layout.height)
        empty = means.new_zeros(0)
        self.memory = KernelMemory(saved.projected, saved.plan.formats[0], size, empty)

    @property
    def visible(self) -> Tensor:
        """Whether each Gaussian touches the picture, (N,) bool."""
        return self.radii > 0

    @property
    def means2d(self) -> Tensor:
        """Means in the picture, (N, 2) px; meaningless where not visible."""
        return self.means2d_of(None)

    def means2d_of(self, rows: Tensor | None) -> Tensor:
        """Return ``means2d`` of the rows (M,) int64, (M, 2)."""
        return first_two_columns(self.memory.footprint_rows, rows)

    @property
    def depths(self) -> Tensor:
        """Depths along the camera's z, (N,) m."""
        return self.memory.number("depths")

    @property
    def radii(self) -> Tensor:
        """3 sigma of the longer axis, (N,) px; 0 where not drawn."""
        return self.memory.number("radii")

    @property
    def extents(self) -> Tensor:
        """Half extents in x and y where alpha >= alpha_min, (N, 2) px; 0 where culled."""
        found = Footprint.unpack(torch.from_numpy(self.memory.footprint_rows).unbind(1))
        return torch.where(found.ry >= 0, torch.stack([found.rx, found.ry]), 0).T

    @property
    def boxes(self) -> Tensor:
        """Extents in whole pixels, (N, 2) int32; 0 where they lie outside the picture."""
        radii, means2d = torch.ceil(self.extents), self.means2d
        inside = (means2d + radii > 0) & (means2d - radii < torch.tensor(self.memory.size))
        return torch.where(inside.all(dim=1, keepdim=True), radii, 0).to(torch.int32)

    @property
    def rows(self) -> Tensor:
        """Indices of the Gaussians that have a box, (M,) int64, ascending."""
        # numpy: every picture of rasterization() needs this, and torch takes eight times as long
        return torch.from_numpy(np.flatnonzero(self.memory.boxed))

    @property
    def conics(self) -> Tensor:
        """Inverse covariances in the picture, (N, 3): xx, xy, yy, per px^2."""
        splat = self.memory.splat
        p, q, r = splat.p, splat.q, splat.r
        return 2 * math.log(2) * torch.stack([p * p, p * q, q * q + r * r], dim=1)

    @property
    def opacities(self) -> Tensor:
        """Opacities as drawn, (N,): with ``antialiased`` lower than the Gaussians' own."""
        return torch.exp2(self.memory.splat.lo)


@dataclass(frozen=True)
class KernelMemory:
    """The projected Gaussians in the kernels' memory, read as torch's tensors."""

    projected: ProjectedMemory | None  # None if there is no Gaussian
    format: RecordFormat  # of its splats
    size: tuple[int, int]  # of the picture: width, height, px
    empty: Tensor  # (0,), of the Gaussians' dtype

    @property
    @exclusive
    def splat(self) -> Splat:
        """The splats of all Gaussians, fields (N,); the colours are those of the first chunk."""
        if self.projected is None:
            return Splat.unpack([self.empty] * Splat.columns(self.format), self.format)
        n, columns = dr.width(self.projected.radii), []
        widths = packets.widths(Splat.columns(self.format))
        for part, width in zip(self.projected.splats[0], widths, strict=True):
            columns += tensor_of(part).view(-1, width)[:n].unbind(1)
        return Splat.unpack(columns, self.format)

    @property
    @exclusive
    def footprint_rows(self) -> np.ndarray:
        """The footprints as a table (N, columns)."""
        width = Footprint.columns()
        if self.projected is None:
            return self.empty.detach().view(0, width).numpy()  # under torch.func it is no plain one
        (rows,) = self.projected.footprints
        return rows.numpy().reshape(-1, width)[: dr.width(self.projected.radii)]

    @exclusive
    def number(self, name: str) -> Tensor:
        """Return the field ``name`` of ``ProjectedMemory``, (N,)."""
        return self.empty if self.projected is None else tensor_of(getattr(self.projected, name))

    @property
    @exclusive
    def boxed(self) -> np.ndarray:
        """``ProjectedMemory.boxed``, (N,)."""
        return np.zeros(0, bool) if self.projected is None else self.projected.boxed.numpy()
