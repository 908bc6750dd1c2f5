"""gsplat's ``rasterize_to_pixels``: ellipses in the pictures, and lists of who is in which tile.

The kernels composite them (composite.py), in tiles of their own that are parts of gsplat's: a
Gaussian of a tile's list is in the lists of those parts that it reaches. What they need of an
ellipse is the factor L of eq. 6, what they give back the sums of eq. 16, both in float64 here:

    L^T L = A / (2 ln2)    A = [[a, b], [b, c]], the conic
    dL/du = 2 ln2 L^T m1    dL/do = m0 / o    dL/dA = -S / 2    S = sum v d d^T = L^-1 m2 L^-T
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from gva_mi.splat.autograd import PRECISION, not_compiled, to_drjit
from gva_mi.splat.gsplat_lists import NAME, TileLists
from gva_mi.splat.kernels import chunks, packets
from gva_mi.splat.kernels.blend import UNSEEN
from gva_mi.splat.kernels.composite import composite, composite_adjoint, sums_of_slots
from gva_mi.splat.kernels.exclusive import exclusive
from gva_mi.splat.kernels.packets import Packets
from gva_mi.splat.kernels.planes import Planes, Trail
from gva_mi.splat.kernels.records import Format, Slot, Splat
from gva_mi.splat.kernels.tiles import SLACK, Layout, Lists
from gva_mi.splat.options import SplatOptions
from gva_mi.threads import alone_on_the_cores

OPTIONS = SplatOptions(depth=False).of_code()


@not_compiled
@exclusive
@alone_on_the_cores()
def rasterize_to_pixels(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    image_width: int,
    image_height: int,
    tile_size: int,
    isect_offsets: Tensor,
    flatten_ids: Tensor,
    backgrounds: Tensor | None = None,
    masks: Tensor | None = None,
    packed: bool = False,
    absgrad: bool = False,
) -> tuple[Tensor, Tensor]:
    """The pictures of Gaussians that are ellipses already.

    Args:
        means2d: (..., N, 2) px, "..." the pictures; packed (nnz, 2).
        conics: (..., N, 3) px^-2: xx, xy, yy of the inverse covariance. One that is not positive
            definite is not drawn.
        colors: (..., N, D).
        opacities: (..., N) in [0, 1].
        image_width, image_height: px.
        tile_size: px, a multiple of 8.
        isect_offsets: (..., tile_height, tile_width) of ``isect_offset_encode``.
        flatten_ids: (n_isects,) of ``isect_tiles``.
        backgrounds: (..., D); black where None.
        masks: (..., tile_height, tile_width) bool; a tile that is False shows the background.
        packed: whether there are rows of some Gaussians alone.
        absgrad: whether backward sets ``means2d.absgrad``.

    Returns:
        Colours (..., image_height, image_width, D) and alphas (..., image_height, image_width, 1).

    Raises:
        ValueError: for wrong shapes, kinds and numbers.

    Note:
        Differentiable once, in reverse mode, by means2d, conics, colors, opacities, backgrounds.
    """
    bodies = {"means2d": means2d, "conics": conics, "colors": colors, "opacities": opacities}
    _check_bodies(bodies, packed)
    images, D = tuple(isect_offsets.shape[:-2]), colors.shape[-1]
    forms = {
        "masks": (masks, tuple(isect_offsets.shape)),
        "backgrounds": (backgrounds, (*images, D)),
    }
    for name, (tensor, form) in forms.items():
        if tensor is not None and tuple(tensor.shape) != form:
            raise ValueError(f"{NAME}: {name} must be {form}, got {tuple(tensor.shape)}")
    if not packed and images != tuple(means2d.shape[:-2]):
        found = f"(..., tile_height, tile_width) of {tuple(means2d.shape[:-2])} pictures"
        raise ValueError(f"{NAME}: isect_offsets must be {found}, got {tuple(isect_offsets.shape)}")
    if backgrounds is None:
        backgrounds = means2d.new_zeros(*images, D)
    flat = (means2d.reshape(-1, 2), conics.reshape(-1, 3), colors.reshape(-1, D))
    given = Given(*flat, opacities.reshape(-1), backgrounds.reshape(-1, D))
    layout = Layout(int(image_width), int(image_height))
    tiles = TileLists.of(isect_offsets, flatten_ids, masks, tile_size, layout, len(given.means2d))
    whole = weakref.ref(means2d) if absgrad else None
    color, alpha = Pixels.apply(*given, Job(layout, tiles, whole))
    return color.unflatten(0, images), alpha.unflatten(0, images)


class Given(NamedTuple):
    """What is differentiated: rows of all pictures."""

    means2d: Tensor  # (R, 2)
    conics: Tensor  # (R, 3)
    colors: Tensor  # (R, D)
    opacities: Tensor  # (R,)
    backgrounds: Tensor  # (I, D)


@dataclass(frozen=True)
class Ellipses:
    """The rows of one picture as the kernels know them, float64."""

    p: Tensor  # (n,) of eq. 6; 1, 0, 1 where not drawn
    q: Tensor
    r: Tensor
    lo: Tensor  # (n,) of eq. 7; UNSEEN where not drawn
    boxes: np.ndarray  # (n, 4) px, left, top, right, bottom; of those not drawn, nowhere

    @staticmethod
    def of(means2d: Tensor, conics: Tensor, opacities: Tensor) -> Ellipses:
        """From what gsplat's user has."""
        a, b, c = conics.double().unbind(dim=1)
        u, o = means2d.double(), opacities.double()
        det = a * c - b * b
        drawn = (a > 0) & (det > 0) & (o >= OPTIONS.alpha_min)
        a, b, c, det = (
            torch.where(drawn, x, y) for x, y in ((a, 1.0), (b, 0.0), (c, 1.0), (det, 1.0))
        )
        k, tau = 1 / (2 * math.log(2)), 2 * torch.log(torch.where(drawn, o, 1) / OPTIONS.alpha_min)
        p = (k * a).sqrt()
        reach = (tau[:, None] * torch.stack([c, a], dim=1) / det[:, None]).sqrt() + SLACK
        reach = torch.where(drawn[:, None], reach, -math.inf)
        boxes = torch.cat([u - reach, u + reach], dim=1).numpy()
        lo = torch.where(drawn, torch.log2(torch.where(drawn, o, 1)), UNSEEN)
        return Ellipses(p, k * b / p, (k * det / a).sqrt(), lo, boxes)

    def pack(self, means2d: Tensor, colors: Tensor, formats: Sequence[Format]) -> list[Packets]:
        """The splats, chunk by chunk."""
        F = PRECISION[means2d.dtype]
        shape = torch.stack([self.p, self.q, self.r, self.lo], dim=1).to(means2d.dtype)
        room = sum(format.channels for format in formats) - colors.shape[1]
        colors = torch.nn.functional.pad(colors, (0, room))
        out, first = [], 0
        for format in formats:
            channels = colors[:, first : first + format.channels]
            record = torch.cat([means2d, shape, channels], dim=1)
            parts = record.split(packets.widths(Splat.columns(format)), dim=1)
            out.append([to_drjit(part, F) for part in parts])
            first += format.channels
        return out

    def adjoint(self, slot: Slot, opacities: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Gradients by means2d, conics and opacities from the sums over the pixels, (n,) each."""
        k, p, q, r = 2 * math.log(2), self.p, self.q, self.r
        (mx, my), (xx, xy, yy) = slot.m1, slot.m2
        by_means = k * torch.stack([p * mx, q * mx + r * my], dim=1)
        # S = L^-1 m2 L^-T with L^-1 = [[1/p, -q/(p r)], [0, 1/r]]
        i, j, l = 1 / p, -q / (p * r), 1 / r
        across = i * i * xx + 2 * i * j * xy + j * j * yy
        mixed, down = l * (i * xy + j * yy), l * l * yy
        by_conics = -torch.stack([0.5 * across, mixed, 0.5 * down], dim=1)
        drawn = self.lo > UNSEEN
        by_opacities = torch.where(drawn, slot.m0 / torch.where(drawn, opacities.double(), 1), 0)
        return by_means, by_conics, by_opacities

    def absolute(self, slot: Slot) -> Tensor:
        """The absolute gradient by means2d, (n, 2)."""
        ax, ay = slot.absolute
        return 2 * math.log(2) * torch.stack([self.p * ax, ay], dim=1)


@dataclass(frozen=True)
class Drawn:
    """One picture, and what its adjoint needs."""

    rows: slice
    ellipses: Ellipses
    splats: list[Packets]
    lists: Lists | None
    background: list[Array]
    planes: Planes
    trail: Trail | None
    stop: Array | None


@dataclass
class Job:
    """One call: its constants, and what the forward pass leaves."""

    layout: Layout
    tiles: TileLists
    node: weakref.ref[Tensor] | None  # whose absgrad is wanted
    drawn: list[Drawn] = field(default_factory=list)

    def formats(self, channels: int) -> tuple[Format, ...]:
        """Of the chunks; one where the absolute gradient is wanted, which cannot be split."""
        return chunks.formats(channels, depth=False, whole=self.node is not None)

    def draw(self, image: int, given: Given) -> Drawn:
        """One picture."""
        F, layout = PRECISION[given.means2d.dtype], self.layout
        rows = self.tiles.rows(image)
        means2d, conics, colors, opacities = (x.detach()[rows] for x in given[:4])
        ellipses = Ellipses.of(means2d, conics, opacities)
        lists = self.tiles.lists(image, ellipses.boxes, layout, dr.uint32_array_t(F))
        behind = [dr.opaque(F, b) for b in given.backgrounds[image].tolist()]
        if lists is None:
            planes = Planes.of_background(behind, layout.pixels, depth=False)
            return Drawn(rows, ellipses, [], None, behind, planes, None, None)
        formats, grid = self.formats(len(behind)), layout.grid(dr.int32_array_t(F))
        splats = ellipses.pack(means2d, colors, formats)
        seen = composite(splats, lists, grid, behind, None, layout.pixels, formats, OPTIONS)
        return Drawn(rows, ellipses, splats, lists, behind, *seen)

    def image(self, plane: Array, *channels: int) -> Tensor:
        """A plane without its padding."""
        shape = (*self.layout.padded, *channels)
        whole = plane.torch()[: math.prod(shape)].view(shape)
        return whole[: self.layout.height, : self.layout.width]

    def plane(self, grad: Tensor | None, like: Tensor, *channels: int) -> Array:
        """The reverse of :meth:`image`; zeros where there is no gradient."""
        whole = like.new_zeros(*self.layout.padded, *channels)
        if grad is not None:
            whole[: self.layout.height, : self.layout.width] = grad.view(*grad.shape[:2], *channels)
        return to_drjit(whole, PRECISION[like.dtype])


class Pixels(torch.autograd.Function):
    """``Given`` and a ``Job`` to colours (I, H, W, D) and alphas (I, H, W, 1)."""

    @staticmethod
    def forward(ctx: FunctionCtx, *arguments: Tensor | Job) -> tuple[Tensor, Tensor]:
        *tensors, job = arguments
        given = Given(*tensors)
        D = given.colors.shape[1]
        job.drawn = [job.draw(image, given) for image in range(len(given.backgrounds))]
        dr.sync_thread()  # torch reads the memory next
        ctx.save_for_backward(*given)
        ctx.set_materialize_grads(False)
        ctx.job = job
        color = torch.stack([job.image(d.planes.color, D) for d in job.drawn])
        return color, torch.stack([job.image(d.planes.alpha, 1) for d in job.drawn])

    @staticmethod
    @not_compiled
    @once_differentiable
    @exclusive
    @alone_on_the_cores()
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        given, job = Given(*ctx.saved_tensors), ctx.job
        found = Given(*(torch.zeros_like(x) for x in given))
        absolute = torch.zeros_like(given.means2d)
        for image, drawn in enumerate(job.drawn):
            by_image = [None if grad is None else grad[image] for grad in grads]
            _add_adjoint(job, drawn, by_image, given, found, absolute, image)
        node = None if job.node is None else job.node()
        if node is not None:
            node.absgrad = absolute.view(node.shape)
        return *found, None


def _add_adjoint(
    job: Job,
    drawn: Drawn,
    grads: list[Tensor | None],
    given: Given,
    found: Given,
    absolute: Tensor,
    image: int,
) -> None:
    """Write one picture's share into ``found`` and ``absolute``."""
    D, like = given.colors.shape[1], given.means2d
    color, alpha = job.plane(grads[0], like, D), job.plane(grads[1], like)
    if drawn.lists is None:
        found.backgrounds[image] = 0 if grads[0] is None else grads[0].sum(dim=(0, 1))
        return
    formats = job.formats(D)
    grid = job.layout.grid(dr.int32_array_t(PRECISION[like.dtype]))
    picture = (drawn.splats, drawn.lists, grid, drawn.background, drawn.trail, drawn.stop)
    wanted = job.node is not None
    slots, slot_formats, by_background = composite_adjoint(
        *picture, Planes(color, alpha, None), formats, OPTIONS, wanted
    )
    sums = sums_of_slots(drawn.lists, slots, formats=slot_formats, channels=D)
    dr.sync_thread()
    columns = [column.torch().double() for column in sums]
    slot = Slot.unpack(columns, Format(D, depth=False, absolute=wanted))
    rows = drawn.rows
    found.means2d[rows], found.conics[rows], found.opacities[rows] = (
        x.to(like.dtype) for x in drawn.ellipses.adjoint(slot, given.opacities[rows])
    )
    found.colors[rows] = torch.stack(slot.color, dim=1).to(like.dtype)
    found.backgrounds[image] = like.new_tensor(by_background)
    if wanted:
        absolute[rows] = drawn.ellipses.absolute(slot).to(like.dtype)


def _check_bodies(given: dict[str, Tensor], packed: bool) -> None:
    """Shapes, kinds and numbers of what is drawn."""
    means2d, colors = given["means2d"], given["colors"]
    for name, tensor in given.items():
        if tensor.device.type != "cpu" or tensor.dtype not in PRECISION:
            found = f"{tensor.dtype} on {tensor.device}"
            raise ValueError(f"{NAME}: {name} must be float32 or float64 on the CPU, got {found}")
        if tensor.dtype != means2d.dtype:
            found = f"means2d {means2d.dtype}, {name} {tensor.dtype}"
            raise ValueError(f"{NAME}: all tensors must have one dtype, got {found}")
    rows = "(nnz, 2)" if packed else "(..., N, 2)"
    if means2d.dim() < 2 or (packed and means2d.dim() > 2):
        raise ValueError(f"{NAME}: means2d must be {rows}, got {tuple(means2d.shape)}")
    shape, D = tuple(means2d.shape[:-1]), colors.shape[-1] if colors.dim() else 0
    forms = {"means2d": (2,), "conics": (3,), "colors": (max(D, 1),), "opacities": ()}
    for name, form in forms.items():
        if tuple(given[name].shape) != shape + form:
            found = f"must be {shape + form}, got {tuple(given[name].shape)}"
            raise ValueError(f"{NAME}: {name} {found}")
        if not torch.isfinite(given[name]).all():
            raise ValueError(f"{NAME}: {name} must be finite")
