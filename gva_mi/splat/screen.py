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


@dataclass
class Screen:
    """The Gaussians in one picture; ``render`` fills it, ``backward`` adds the gradients.

    Every property is read from the kernels' memory when it is used; unused ones cost nothing.
    """

    absolute: bool = False  # set to have absgrad filled as well
    grad: Tensor | None = None  # (N, 2) dL/dmeans2d, per px; 0 where not drawn
    absgrad: Tensor | None = None  # (N, 2) like grad, with the absolute value of each pixel's share
    _projected: ProjectedMemory | None = field(default=None, repr=False)  # None: no Gaussian
    _format: RecordFormat | None = field(default=None, repr=False)  # of its splats
    _size: tuple[int, int] = field(default=(0, 0), repr=False)  # of the picture, px
    _empty: Tensor | None = field(default=None, repr=False)  # (0,), of the Gaussians' dtype

    def fill(self, saved: SavedState, means: Tensor) -> None:
        """Take over the memory of a forward pass of Gaussians with means (N, 3)."""
        self.grad = self.absgrad = None
        self._projected, self._format = saved.projected, saved.plan.formats[0]
        self._size = (saved.layout.width, saved.layout.height)
        self._empty = means.new_zeros(0)

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
        return first_two_columns(self._footprint_rows(), rows)

    @property
    def depths(self) -> Tensor:
        """Depths along the camera's z, (N,) m."""
        return self._number("depths")

    @property
    def radii(self) -> Tensor:
        """3 sigma of the longer axis, (N,) px; 0 where not drawn."""
        return self._number("radii")

    @property
    def extents(self) -> Tensor:
        """Half extents in x and y where alpha >= alpha_min, (N, 2) px; 0 where culled."""
        found = Footprint.unpack(torch.from_numpy(self._footprint_rows()).unbind(1))
        return torch.where(found.ry >= 0, torch.stack([found.rx, found.ry]), 0).T

    @property
    def boxes(self) -> Tensor:
        """Extents in whole pixels, (N, 2) int32; 0 where they lie outside the picture."""
        radii, means2d = torch.ceil(self.extents), self.means2d
        inside = (means2d + radii > 0) & (means2d - radii < torch.tensor(self._size))
        return torch.where(inside.all(dim=1, keepdim=True), radii, 0).to(torch.int32)

    @property
    def rows(self) -> Tensor:
        """Indices of the Gaussians that have a box, (M,) int64, ascending."""
        # numpy: every picture of rasterization() needs this, and torch takes eight times as long
        if self._projected is None:
            return torch.zeros(0, dtype=torch.int64)
        with exclusive:
            return torch.from_numpy(np.flatnonzero(self._projected.boxed.numpy()))

    @property
    def conics(self) -> Tensor:
        """Inverse covariances in the picture, (N, 3): xx, xy, yy, per px^2."""
        splat = self._splat()
        p, q, r = splat.p, splat.q, splat.r
        return 2 * math.log(2) * torch.stack([p * p, p * q, q * q + r * r], dim=1)

    @property
    def opacities(self) -> Tensor:
        """Opacities as drawn, (N,): with ``antialiased`` lower than the Gaussians' own."""
        return torch.exp2(self._splat().lo)

    @exclusive
    def _splat(self) -> Splat:
        """Return the splats of all Gaussians, fields (N,); colours are those of the first chunk."""
        if self._projected is None:
            return Splat.unpack([self._empty] * Splat.columns(self._format), self._format)
        n, columns = dr.width(self._projected.radii), []
        widths = packets.widths(Splat.columns(self._format))
        for part, width in zip(self._projected.splats[0], widths, strict=True):
            columns += tensor_of(part).view(-1, width)[:n].unbind(1)
        return Splat.unpack(columns, self._format)

    @exclusive
    def _footprint_rows(self) -> np.ndarray:
        """Return the footprints as a table (N, columns)."""
        width = Footprint.columns()
        if self._projected is None:  # detached: under torch.func it is no plain tensor
            return self._empty.detach().view(0, width).numpy()
        (rows,) = self._projected.footprints
        return rows.numpy().reshape(-1, width)[: dr.width(self._projected.radii)]

    @exclusive
    def _number(self, name: str) -> Tensor:
        """Return the field ``name`` of ``ProjectedMemory``, (N,)."""
        return self._empty if self._projected is None else tensor_of(getattr(self._projected, name))


def first_two_columns(table: np.ndarray, rows: Tensor | None = None) -> Tensor:
    """Copy the first two columns of a table (N, 2 k), contiguous, of rows (M,) int64 or all, to a
    tensor.

    A pair is copied as one complex number, by numpy: torch copies rows of two numbers as slowly as
    long ones, and takes longer to be called.
    """
    number = np.complex64 if table.dtype == np.float32 else np.complex128
    pairs = table.view(number)[:, 0]
    if rows is None:
        found = pairs.copy()
    else:  # take() would copy the whole column first if it is not contiguous
        index = rows.numpy()
        found = pairs.take(index) if pairs.flags.contiguous else pairs[index]
    return torch.from_numpy(found.view(table.dtype).reshape(-1, 2))
