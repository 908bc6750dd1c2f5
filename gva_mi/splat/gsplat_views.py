"""All pictures of one call of ``rasterization``: their common ``means2d``, and their ``meta``."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.splat.autograd import Call, Render, Tensors
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.gsplat_meta import Meta, Tiles
from gva_mi.splat.means2d import ProjectMeans, keep_on_one_thread
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.screen import Screen


@dataclass(frozen=True)
class View:
    """One picture: the kernels have run, and torch's graph has got as far as ``means2d``."""

    call: Call
    tensors: Tensors  # without means2d
    means2d: Tensor  # (M, 2) px, of all Gaussians, or packed of those in the picture
    depths: Tensor  # (M,) m

    @staticmethod
    def of(
        gaussians: Gaussians,
        camera: Camera,
        options: SplatOptions,
        background: Tensor | None,
        packed: bool,
        absgrad: bool,
        covariances: bool = False,
    ) -> View:
        """Draw one picture; ``covariances`` says what quats and scales hold (covariance.py)."""
        if background is None:
            background = gaussians.means.new_zeros(gaussians.channels)
        harmonics = gaussians.sh is not None
        call = Call(camera, options, harmonics, Screen(absolute=absgrad), covariances, packed)
        means, *others = *gaussians.arrays().values(), background
        anchor = next((x for x in others if x.requires_grad), None)
        detached = [x.detach() for x in others]
        means2d, depths, known = ProjectMeans.apply(means, *camera.tensors, anchor, *detached, call)
        tensors = Tensors(means, *others, *camera.tensors, None, known)
        return View(call, tensors, means2d, depths)

    def image(self, means2d: Tensor) -> Image:
        """The picture, as a function of its part (..., M, 2) of the common ``means2d`` too."""
        images = Render.apply(*self.tensors._replace(means2d=means2d), self.call)
        return Image(*images)


def joined(parts: list[Tensor], shape: tuple[int, ...]) -> Tensor:
    """Stacked, (*shape, ...); a single one is not copied, nor is its gradient."""
    if len(parts) == 1:
        return parts[0].view(*shape, *parts[0].shape)
    return torch.stack(parts).unflatten(0, shape)


def _join(parts: list[Tensor], shape: tuple[int, ...], packed: bool) -> Tensor:
    if packed:
        return parts[0] if len(parts) == 1 else torch.cat(parts)
    return joined(parts, shape)


class Views:
    """Pictures (..., C) of one size."""

    def __init__(self, views: Sequence[View], shape: tuple[int, ...], packed: bool) -> None:
        self.views, self.shape, self.packed = views, shape, packed
        self.means2d = self.join([view.means2d for view in views])
        keep_on_one_thread(self.means2d, [view.call for view in views])

    def images(self) -> list[Image]:
        """Each picture: a function of ``means2d``, as gsplat's are."""
        if len(self.views) == 1:  # its gradient is not copied
            parts = [self.means2d]
        elif self.packed:
            parts = self.means2d.split([len(view.means2d) for view in self.views])
        else:
            parts = self.means2d.flatten(0, -3).unbind()
        return [view.image(part) for view, part in zip(self.views, parts, strict=True)]

    def join(self, parts: list[Tensor]) -> Tensor:
        """Something of each picture's rows: (..., C, N, ...), or packed (nnz, ...)."""
        return _join(parts, self.shape, self.packed)

    def of_screens(self, number: Callable[[Screen], Tensor]) -> Tensor:
        """The same of what the kernels' memory tells."""
        return self.join([view.call.pick(number(view.call.screen)) for view in self.views])

    def attach_absgrad(self) -> None:
        """Have backward set ``means2d.absgrad``, when it has found the gradient."""
        # the tensor holds the hook: the hook must hold neither it nor who holds it
        node, shape, packed = weakref.ref(self.means2d), self.shape, self.packed
        sources = [(v.call.screen, v.call.rows, v.means2d.new_zeros(1, 2)) for v in self.views]
        sizes = [len(view.means2d) for view in self.views]

        def attach(grad: Tensor) -> None:
            target = node()
            if target is None:
                return
            parts = []
            for (screen, rows, zero), size in zip(sources, sizes, strict=True):
                if screen.absgrad is None:  # no loss looks at this picture
                    parts.append(zero.expand(size, 2))
                else:
                    parts.append(screen.absgrad if rows is None else screen.absgrad[rows])
            target.absgrad = _join(parts, shape, packed)

        self.means2d.register_hook(attach)

    def meta(self, opacities: Tensor, tile_size: int) -> Meta:
        """gsplat's ``meta``.

        Args:
            opacities: (..., N), of the Gaussians.
            tile_size: px.
        """
        camera, C = self.views[0].call.camera, self.shape[-1]
        batches = len(self.views) // C
        values = {
            "means2d": self.means2d,
            "depths": self.join([view.depths for view in self.views]),
            "width": camera.width,
            "height": camera.height,
            "tile_size": tile_size,
            "n_batches": batches,
            "n_cameras": C,
        }
        tiles = lambda read: lambda: read(self._tiles(tile_size))
        recipes = {
            "batch_ids": lambda: self._numbers(lambda v: v // C),
            "camera_ids": lambda: self._numbers(lambda v: v % C),
            "gaussian_ids": self._gaussian_ids,
            "radii": lambda: self.of_screens(lambda screen: screen.boxes),
            "conics": lambda: self.of_screens(lambda screen: screen.conics),
            "opacities": lambda: self._opacities(opacities),
            "tile_width": lambda: -(-camera.width // tile_size),
            "tile_height": lambda: -(-camera.height // tile_size),
            "tiles_per_gauss": tiles(lambda t: self._unflat(t.counts)),
            "isect_ids": tiles(lambda t: t.keys),
            "flatten_ids": tiles(lambda t: t.rows),
            "isect_offsets": tiles(lambda t: t.offsets.unflatten(0, self.shape)),
        }
        return Meta(values, recipes)

    def _numbers(self, of_view: Callable[[int], int]) -> Tensor | None:
        """A number of each row's picture; None where rows are not packed."""
        if not self.packed:
            return None
        rows = [len(view.means2d) for view in self.views]
        return torch.cat([torch.full((n,), of_view(v)) for v, n in enumerate(rows)])

    def _gaussian_ids(self) -> Tensor | None:
        return self.join([view.call.rows for view in self.views]) if self.packed else None

    def _opacities(self, given: Tensor) -> Tensor:
        if self.views[0].call.options.antialiased:
            return self.of_screens(lambda screen: screen.opacities)
        N = given.shape[-1]
        of_views = given[..., None, :].expand(*self.shape, N).reshape(len(self.views), N)
        return self.join([view.call.pick(o) for view, o in zip(self.views, of_views, strict=True)])

    def _unflat(self, rows: Tensor) -> Tensor:
        return rows if self.packed else rows.unflatten(0, (*self.shape, len(self.views[0].means2d)))

    def _tiles(self, size: int) -> Tiles:
        means2d, depths = self.means2d.detach().reshape(-1, 2), [v.depths for v in self.views]
        boxes = self.of_screens(lambda screen: screen.boxes).reshape(-1, 2)
        rows = [len(view.means2d) for view in self.views]
        images = torch.arange(len(rows)).repeat_interleave(torch.tensor(rows))
        camera = self.views[0].call.camera
        picture = (camera.width, camera.height)
        depths = torch.cat(depths).detach()
        return Tiles.of(means2d, boxes, depths, images, len(rows), picture, size)
