"""All pictures of one call of ``rasterization``, their common ``means2d``, and their ``meta``."""

from __future__ import annotations

import weakref
from collections import UserDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gva_mi.splat.autograd import Render
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.gsplat.means2d import ProjectMeans
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.screen import Screen
from gva_mi.splat.torch_passes import Drawn, RenderCall, Tensors
from gva_mi.splat.torch_render import tensors_of


class Meta(UserDict):
    """A dictionary whose functions are called, and replaced by their result, when they are read.

    Most programs read a few entries of gsplat's ``meta``, and only in some steps.
    """

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401
        if callable(self.data[name]):
            self.data[name] = self.data[name]()
        return self.data[name]


@dataclass(frozen=True)
class RenderedView:
    """One picture whose kernels have run; torch's graph reaches up to ``means2d``."""

    drawn: Drawn
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
    ) -> RenderedView:
        """Draw one picture."""
        call = RenderCall(
            camera, options, gaussians.sh is not None, Screen(absolute=absgrad), packed
        )
        tensors = tensors_of(gaussians, background, camera)
        means, *others = *tensors.gaussians().values(), tensors.background
        anchor = next((x for x in others if x is not None and x.requires_grad), None)
        detached = [None if x is None else x.detach() for x in others]
        means2d, depths, echo, drawn = ProjectMeans.apply(
            means, *camera.tensors, anchor, *detached, call
        )
        return RenderedView(drawn, tensors._replace(echo=echo), means2d, depths)

    def image(self, means2d: Tensor) -> Image:
        """Return the picture as a function of its part (..., M, 2) of the common ``means2d``."""
        return Image(*Render.apply(*self.tensors._replace(means2d=means2d), self.drawn)[:-1])


def joined(parts: list[Tensor], shape: tuple[int, ...]) -> Tensor:
    """Stack to (*shape, ...); a single part is not copied, nor is its gradient."""
    if len(parts) == 1:
        return parts[0].view(*shape, *parts[0].shape)
    return torch.stack(parts).unflatten(0, shape)


def _joined_rows(parts: list[Tensor], shape: tuple[int, ...], packed: bool) -> Tensor:
    """Join rows of Gaussians: (..., C, N, ...), or packed (nnz, ...)."""
    if packed:
        return parts[0] if len(parts) == 1 else torch.cat(parts)
    return joined(parts, shape)


class RenderedViews:
    """The pictures (..., C) of one call, all of one size."""

    def __init__(self, views: Sequence[RenderedView], shape: tuple[int, ...], packed: bool) -> None:
        self.views, self.shape, self.packed = views, shape, packed
        self.means2d = self.join(view.means2d for view in views)
        self.camera = views[0].drawn.call.camera

    def images(self) -> list[Image]:
        """Return the pictures, each a function of ``means2d``, as gsplat's are."""
        if len(self.views) == 1:  # its gradient is not copied
            parts = [self.means2d]
        elif self.packed:
            parts = self.means2d.split([len(view.means2d) for view in self.views])
        else:
            parts = self.means2d.flatten(0, -3).unbind()
        return [view.image(part) for view, part in zip(self.views, parts, strict=True)]

    def join(self, parts: Iterable[Tensor]) -> Tensor:
        """Join rows of every picture: (..., C, N, ...), or packed (nnz, ...)."""
        return _joined_rows(list(parts), self.shape, self.packed)

    def of_screens(self, number: Callable[[Screen], Tensor]) -> Tensor:
        """Join a property of every picture's screen, in the rows of ``means2d``."""
        return self.join(view.drawn.pick(number(view.drawn.call.screen)) for view in self.views)

    def attach_absgrad(self) -> None:
        """Make backward set ``means2d.absgrad``."""
        # the tensor holds the hook: the hook must hold neither the tensor nor self
        node, shape, packed = weakref.ref(self.means2d), self.shape, self.packed
        zero, drawn = self.means2d.new_zeros(1, 2), [view.drawn for view in self.views]
        sizes = [len(view.means2d) for view in self.views]

        def attach(grad: Tensor) -> None:
            target = node()
            if target is None:
                return
            parts = []
            for picture, size in zip(drawn, sizes, strict=True):
                absgrad = picture.call.screen.absgrad  # None: no loss depends on this picture
                parts.append(zero.expand(size, 2) if absgrad is None else picture.pick(absgrad))
            target.absgrad = _joined_rows(parts, shape, packed)

        self.means2d.register_hook(attach)

    def meta(self, opacities: Tensor, tile_size: int) -> Meta:
        """Return gsplat's ``meta``; the Gaussians' opacities are (..., N)."""
        camera, C = self.camera, self.shape[-1]
        entries = {
            "means2d": self.means2d,
            "depths": self.join(view.depths for view in self.views),
            "width": camera.width,
            "height": camera.height,
            "tile_size": tile_size,
            "n_batches": len(self.views) // C,
            "n_cameras": C,
            "tile_width": -(-camera.width // tile_size),
            "tile_height": -(-camera.height // tile_size),
            "batch_ids": lambda: self._ids(lambda v: v // C),
            "camera_ids": lambda: self._ids(lambda v: v % C),
            "gaussian_ids": self._gaussian_ids,
            "radii": lambda: self.of_screens(lambda screen: screen.boxes),
            "conics": lambda: self.of_screens(lambda screen: screen.conics),
            "opacities": lambda: self._opacities(opacities),
        }
        return Meta(entries)

    def _ids(self, of_view: Callable[[int], int]) -> Tensor | None:
        """A number of each row's picture; None where rows are not packed."""
        if not self.packed:
            return None
        rows = [len(view.means2d) for view in self.views]
        return torch.cat([torch.full((n,), of_view(v)) for v, n in enumerate(rows)])

    def _gaussian_ids(self) -> Tensor | None:
        return self.join(view.drawn.rows for view in self.views) if self.packed else None

    def _opacities(self, given: Tensor) -> Tensor:
        if self.views[0].drawn.call.options.antialiased:
            return self.of_screens(lambda screen: screen.opacities)
        N = given.shape[-1]
        of_views = given[..., None, :].expand(*self.shape, N).reshape(len(self.views), N)
        pairs = zip(self.views, of_views, strict=True)
        return self.join(view.drawn.pick(o) for view, o in pairs)
