"""The Gaussians as one picture saw them: what densification, and gsplat's ``meta``, need to know.

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
from drjit import ArrayBase as Array
from torch import Tensor

from gva_mi.splat.kernels.exclusive import exclusive
from gva_mi.splat.kernels.packets import Packets
from gva_mi.splat.kernels.passes import Saved
from gva_mi.splat.kernels.project import Projected
from gva_mi.splat.kernels.records import Footprint, Format, Splat


def tensor_of(array: Array, count: int | None = None) -> Tensor:
    """An array's own memory, (width,), or its first numbers; by way of numpy, for ``.torch()``
    takes thrice as long."""
    return torch.from_numpy(array.numpy()[:count])


def of_rows(columns: np.ndarray, rows: Tensor | None = None) -> Tensor:
    """The first two of some columns, (N, 2 k), in memory of their own, as torch's tensor.

    Args:
        columns: of float32 or float64, row by row in memory.
        rows: (M,) int64, those to return; None returns all.

    A pair is copied as one complex number, by numpy: torch copies rows of two numbers as slowly as
    long ones, and takes longer to be called.
    """
    number = np.complex64 if columns.dtype == np.float32 else np.complex128
    pairs = columns.view(number)[:, 0]
    if rows is None:
        found = pairs.copy()
    else:  # take() would copy the whole first, did its numbers not lie side by side
        rows = rows.numpy()
        found = pairs.take(rows) if pairs.flags.contiguous else pairs[rows]
    return torch.from_numpy(found.view(columns.dtype).reshape(-1, 2))


@dataclass
class Screen:
    """The Gaussians as one picture saw them: filled by ``render``, gradients by ``backward``.

    What is asked of it is read out of the kernels' memory then; what is not costs nothing.
    """

    absolute: bool = False  # set to have absgrad filled as well
    grad: Tensor | None = None  # (N, 2) dL/dmeans2d, per px; 0 where not drawn
    absgrad: Tensor | None = None  # (N, 2) grad with the share of every pixel taken absolutely
    seen: Seen | None = field(default=None, repr=False)

    def fill(self, saved: Saved, means: Tensor) -> None:
        """Take what the kernels saved.

        Args:
            saved: what ``render_forward`` returned.
            means: (N, 3) of the Gaussians.
        """
        self.grad = self.absgrad = None
        size = (saved.layout.width, saved.layout.height)
        self.seen = Seen(saved.projected, saved.plan.formats[0], size, means.new_zeros(0))

    @property
    def visible(self) -> Tensor:
        """Whether each Gaussian touches the picture, (N,) bool."""
        return self.radii > 0

    @property
    def means2d(self) -> Tensor:
        """(N, 2) px; meaningless where not visible."""
        return self.means2d_of(None)

    def means2d_of(self, rows: Tensor | None) -> Tensor:
        """The same of some rows (M,) int64, (M, 2)."""
        return of_rows(self.seen.footprint_rows, rows)

    @property
    def depths(self) -> Tensor:
        """Along the camera's z, (N,) m."""
        return self.seen.number("depths")

    @property
    def radii(self) -> Tensor:
        """3 sigma of the longer axis, (N,) px; 0 where not drawn."""
        return self.seen.number("radii")

    @property
    def extents(self) -> Tensor:
        """How far each reaches in x and y, alpha >= alpha_min, (N, 2) px; 0 where culled."""
        found = self.seen.footprint
        return torch.where(found.ry >= 0, torch.stack([found.rx, found.ry]), 0).T

    @property
    def boxes(self) -> Tensor:
        """Extents in whole pixels, (N, 2) int32; 0 where they are outside the picture."""
        radii, means2d = torch.ceil(self.extents), self.means2d
        reaches = (means2d + radii > 0) & (means2d - radii < torch.tensor(self.seen.size))
        return torch.where(reaches.all(dim=1, keepdim=True), radii, 0).to(torch.int32)

    @property
    def rows(self) -> Tensor:
        """The Gaussians that have a box, (M,) int64, ascending."""
        # numpy: every picture of gsplat's call comes here, and torch takes eight times as long
        return torch.from_numpy(np.flatnonzero(self.seen.boxed))

    @property
    def conics(self) -> Tensor:
        """Inverse covariances in the picture, (N, 3): xx, xy, yy, per px^2."""
        p, q, r = self.seen.splat.p, self.seen.splat.q, self.seen.splat.r
        return 2 * math.log(2) * torch.stack([p * p, p * q, q * q + r * r], dim=1)

    @property
    def opacities(self) -> Tensor:
        """Opacities as drawn: less than the Gaussians' own with ``antialiased``, (N,)."""
        return torch.exp2(self.seen.splat.lo)


@dataclass(frozen=True)
class Seen:
    """The kernels' memory, read as torch's tensors."""

    projected: Projected | None  # None where there is no Gaussian
    format: Format  # of its splats
    size: tuple[int, int]  # of the picture: width, height, px
    nothing: Tensor  # (0,), of the Gaussians' dtype

    @property
    def splat(self) -> Splat:
        """The record of all Gaussians, its fields as tensors (N,); colours of the first chunk."""
        if self.projected is None:
            return Splat.unpack([self.nothing] * Splat.columns(self.format), self.format)
        return Splat.unpack(self._columns(self.projected.splats[0]), self.format)

    @property
    def footprint(self) -> Footprint:
        """The same of the ellipses."""
        return Footprint.unpack(torch.from_numpy(self.footprint_rows).unbind(1))

    @property
    @exclusive
    def footprint_rows(self) -> np.ndarray:
        """The rows of these records, (N, columns)."""
        width = Footprint.columns()
        if self.projected is None:
            return self.nothing.detach().view(0, width).numpy()  # torch's graph may have it
        (rows,) = self.projected.footprints
        return rows.numpy().reshape(-1, width)

    @exclusive
    def number(self, name: str) -> Tensor:
        """One of the numbers that ``Projected`` has of each Gaussian, (N,)."""
        return self.nothing if self.projected is None else tensor_of(getattr(self.projected, name))

    @property
    @exclusive
    def boxed(self) -> np.ndarray:
        """``Projected.boxed``, (N,)."""
        return np.zeros(0, bool) if self.projected is None else self.projected.boxed.numpy()

    @exclusive
    def _columns(self, record: Packets) -> list[Tensor]:
        n = dr.width(self.projected.radii)
        return [column for part in record for column in tensor_of(part).view(n, -1).unbind(1)]
