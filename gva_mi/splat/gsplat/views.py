"""All pictures of one call of ``rasterization``, their common ``means2d``, and their ``meta``.

gsplat's users call ``meta["means2d"].retain_grad()`` before backward, register hooks on it, and put
losses on it. Therefore it is a node of torch's graph between the means and the images:

    means, T_camera_world, K            -> _ProjectMeans -> means2d, depths, echo, drawn
    the tensors, means2d, echo          -> _ImagesOf     -> images

The kernels run once, in _ProjectMeans. In backward they propagate the images' gradient to the means
and the camera themselves, and the screen receives the gradient with respect to ``means2d``. To
count it only once, ``echo`` receives it too: _ProjectMeans propagates only the difference between
the two, which hooks and other losses caused. :mod:`gva_mi.splat.torch_render` is unaware of this.
"""

from __future__ import annotations

import weakref
from collections import UserDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, overload

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.func import vjp

from gva_mi.core.cpu import quiet_openmp, sqrt
from gva_mi.jit.frozen import exclusive
from gva_mi.jit.tensors import not_compiled
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.torch_passes import Drawn, Screen, Tensors, draw, first_two_columns, images
from gva_mi.splat.torch_render import keep, one_by_one, pull, push, tensors_of

# (r / z)^2 below which a fisheye's s is two terms of its series. Chosen: the third is 2e-13 of s.
SERIES_MAX_Q = 1e-6

Values = tuple[Tensor | None, ...]
OfPictures = Literal["means2d", "depths", "radii", "conics", "opacities"]  # entries of meta
Count = Literal[
    "width", "height", "n_batches", "n_cameras", "tile_size", "tile_width", "tile_height"
]


@dataclass(frozen=True)
class GsplatView:
    """The constants of one picture.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> camera = random_scene(torch.Generator().manual_seed(0)).camera
        >>> view = GsplatView(camera, SplatOptions(), False, Screen(), packed=False)
        >>> view.pick(torch.tensor([7, 8, 9]))  # not packed: all rows
        tensor([7, 8, 9])
    """

    camera: Camera
    options: SplatOptions
    harmonics: bool  # whether the colours are coefficients
    screen: Screen
    packed: bool  # whether means2d has rows only for the Gaussians in the picture

    def pick(self, numbers: Tensor) -> Tensor:
        """Select means2d's rows from numbers (N, ...) of all Gaussians."""
        return numbers.index_select(0, self.screen.rows) if self.packed else numbers


@one_by_one
class _ProjectMeans(torch.autograd.Function):
    """Autograd node from means and camera to means2d, depths, echo and the ``Drawn`` picture.

    Its inputs are means, T_camera_world, K, an anchor, six other tensors and a ``GsplatView``.

    The others, quats to background, are detached: they get their gradients from ``_ImagesOf``. The
    anchor is one of them that needs a gradient, so that ``means2d`` has a gradient where means and
    camera are frozen; None if there is none.
    """

    @staticmethod
    @exclusive
    def forward(*arguments: Any) -> tuple:  # noqa: ANN401
        means, T_camera_world, K, _, *others, view = arguments
        tensors, screen = Tensors(means, *others, T_camera_world, K), view.screen
        drawn = draw(tensors, view.camera, view.options, view.harmonics, screen)
        means2d = screen.means2d_of(screen.rows if view.packed else None)
        return means2d, view.pick(screen.depths), _zeros(means2d), drawn

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        ctx.view, ctx.others = inputs[-1], len(inputs) - 3
        ctx.save_for_backward(*inputs[:3])
        ctx.save_for_forward(*inputs[:3])
        ctx.set_materialize_grads(False)

    @staticmethod
    @not_compiled
    @exclusive
    @quiet_openmp()  # retain_grad has just copied a gradient, on all threads
    def backward(
        ctx: FunctionCtx,
        grad: Tensor | None,
        by_depths: Tensor | None,
        echo: Tensor | None,
        _: None,
    ) -> Values:
        if echo is not None:
            grad = None if _equal(grad, echo) else grad - echo
        found: Values = (None, None, None)
        if grad is not None or by_depths is not None:
            images, pull = vjp(_projection(ctx.view), *ctx.saved_tensors)
            found = pull(_filled((grad, by_depths), images))
        return *found, *[None] * ctx.others

    @staticmethod
    @not_compiled
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple:
        images, pull = vjp(_projection(ctx.view), *ctx.saved_tensors)
        zeros = _filled((None, None), images)
        _, push = vjp(pull, zeros)  # pull is linear: its own transpose is the tangent
        (found,) = push(_filled(tangents[:3], ctx.saved_tensors))
        return *found, _zeros(found[0]), None


@one_by_one
class _ImagesOf(torch.autograd.Function):
    """Autograd node from ``Tensors``, means2d and echo to the images of a ``Drawn`` picture.

    Its last two inputs are that picture and its ``GsplatView``.
    """

    @staticmethod
    @exclusive
    def forward(*arguments: Any) -> tuple:  # noqa: ANN401
        saved = arguments[-2].saved
        return images(saved.planes, saved)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        *tensors, means2d, _, drawn, ctx.view = inputs
        ctx.shape = means2d.shape
        keep(ctx, tensors, drawn)

    @staticmethod
    @not_compiled
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> Values:
        found = pull(ctx, grads)
        if ctx.drawn.elements:  # each has its own rows; without means2d's share nothing is missing
            return *found, None, None, None, None
        by_means2d = ctx.view.screen.grad
        if torch.is_grad_enabled():  # perhaps under torch.func, whose tensors have no memory
            by_means2d = ctx.view.pick(by_means2d)
        elif ctx.view.packed:
            by_means2d = first_two_columns(by_means2d.numpy(), ctx.view.screen.rows)
        return *found, by_means2d.view(ctx.shape), by_means2d, None, None

    @staticmethod
    @not_compiled
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple:
        return push(ctx, tangents[:-4])


def _equal(grad: Tensor, echo: Tensor) -> bool:
    """Whether two gradients are equal; mostly they are the same memory.

    torch.func's wrapped tensors have no memory of their own and raise. They count as unlike: their
    difference is zero anyway.
    """
    try:
        same = grad.data_ptr() == echo.data_ptr() and grad.stride() == echo.stride()
        return same or torch.equal(grad, echo)
    except RuntimeError:
        return False


def _zeros(like: Tensor) -> Tensor:
    """Return zeros of the same shape, a single number in memory: only their gradient is used."""
    return like.new_zeros(()).expand_as(like)


def _filled(given: Values, like: Values) -> tuple[Tensor, ...]:
    """Replace None by zeros."""
    pairs = zip(given, like, strict=True)
    return tuple(torch.zeros_like(model) if x is None else x for x, model in pairs)


def _projection(view: GsplatView) -> Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Eq. 1 and 2 (lens.py) in torch: means, T_camera_world, K to means2d, depths.

    The result is meaningless where a Gaussian is not drawn. Products are written as sums, because
    the last bits of a matrix product depend on the number of threads.
    """
    model, near = view.camera.model, view.options.near

    def project(means: Tensor, T_camera_world: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        means = view.pick(means)
        x = (means[:, None, :] * T_camera_world[:3, :3]).sum(dim=-1) + T_camera_world[:3, 3]
        depths, f, c = x[:, 2], torch.diagonal(K)[:2], K[:2, 2]
        # One on the near plane is drawn, whatever the last digit of its depth.
        z = torch.where(depths > 0.5 * near, depths, 1)[:, None]
        if model == "pinhole":
            return f * x[:, :2] / z + c, depths
        if model == "ortho":
            return f * x[:, :2] + c, depths
        if model != "fisheye":
            raise ValueError(f"rasterization: unknown camera model {model!r}")
        squared = x[:, :2].square().sum(dim=-1, keepdim=True)
        on_axis = squared < SERIES_MAX_Q * z * z
        r = sqrt(torch.where(on_axis, 1, squared))
        s = torch.where(on_axis, (1 - squared / (3 * z * z)) / z, torch.atan2(r, z) / r)
        return f * x[:, :2] * s + c, depths

    return project


class Meta(UserDict[str, Tensor | int | None]):
    """A dictionary whose functions are called, and replaced by their result, when they are read.

    Most programs read a few entries of gsplat's ``meta``, and only in some steps.

    Example:
        >>> meta = Meta({"width": 8, "radii": lambda: print("computed") or 3})
        >>> meta["width"], meta["radii"], meta["radii"]
        computed
        (8, 3, 3)
    """

    @overload
    def __getitem__(self, name: OfPictures) -> Tensor: ...
    @overload
    def __getitem__(self, name: Count) -> int: ...
    @overload
    def __getitem__(self, name: str) -> Tensor | int | None: ...
    def __getitem__(self, name: str) -> Tensor | int | None:
        if callable(self.data[name]):
            self.data[name] = self.data[name]()
        return self.data[name]


@dataclass(frozen=True)
class RenderedView:
    """One picture whose kernels have run; torch's graph reaches up to ``means2d``.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5).to(torch.float64)
        >>> view = GsplatView(scene.camera, scene.options, False, Screen(), packed=False)
        >>> seen = RenderedView.of(scene.gaussians, None, view)
        >>> (grad,) = torch.autograd.grad(seen.image(seen.means2d).color.sum(), seen.means2d)
        >>> torch.equal(grad, view.screen.grad)  # as the kernels computed it
        True
    """

    view: GsplatView
    drawn: Drawn
    tensors: Tensors
    means2d: Tensor  # (M, 2) px, of all Gaussians, or packed of those in the picture
    depths: Tensor  # (M,) m
    echo: Tensor  # (M, 2)

    @staticmethod
    def of(gaussians: Gaussians, background: Tensor | None, view: GsplatView) -> RenderedView:
        """Draw one picture."""
        tensors = tensors_of(gaussians, background, view.camera)
        means, *others = *tensors.gaussians().values(), tensors.background
        anchor = next((x for x in others if x is not None and x.requires_grad), None)
        detached = [None if x is None else x.detach() for x in others]
        found = _ProjectMeans.apply(means, *view.camera.tensors, anchor, *detached, view)
        means2d, depths, echo, drawn = found
        return RenderedView(view, drawn, tensors, means2d, depths, echo)

    def image(self, means2d: Tensor) -> Image:
        """Return the picture as a function of its part (..., M, 2) of the common ``means2d``."""
        return Image(*_ImagesOf.apply(*self.tensors, means2d, self.echo, self.drawn, self.view))


def joined(parts: list[Tensor], shape: tuple[int, ...]) -> Tensor:
    """Stack to (*shape, ...); a single part is not copied, nor is its gradient.

    Example:
        >>> joined([torch.zeros(4, 2)] * 6, shape=(2, 3)).shape
        torch.Size([2, 3, 4, 2])
    """
    if len(parts) == 1:
        return parts[0].view(*shape, *parts[0].shape)
    return torch.stack(parts).unflatten(0, shape)


def _joined_rows(parts: list[Tensor], shape: tuple[int, ...], packed: bool) -> Tensor:
    """Join rows of Gaussians: (..., C, N, ...), or packed (nnz, ...)."""
    if packed:
        return parts[0] if len(parts) == 1 else torch.cat(parts)
    return joined(parts, shape)


class RenderedViews:
    """The pictures (..., C) of one call, all of one size.

    Example:
        Two cameras at one place.

        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5)
        >>> view = GsplatView(scene.camera, scene.options, False, Screen(), packed=False)
        >>> seen = RenderedViews([RenderedView.of(scene.gaussians, None, view)] * 2, (2,), False)
        >>> len(seen.images()), seen.means2d.shape, seen.meta(torch.ones(5), 16)["n_cameras"]
        (2, torch.Size([2, 5, 2]), 2)
    """

    def __init__(self, views: Sequence[RenderedView], shape: tuple[int, ...], packed: bool) -> None:
        self.views, self.shape, self.packed = views, shape, packed
        self.means2d = self.join(view.means2d for view in views)
        self.camera = views[0].view.camera

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
        return self.join(v.view.pick(number(v.view.screen)) for v in self.views)

    def attach_absgrad(self) -> None:
        """Make backward set ``means2d.absgrad``."""
        # the tensor holds the hook: the hook must hold neither the tensor nor self
        node, shape, packed = weakref.ref(self.means2d), self.shape, self.packed
        zero, of_views = self.means2d.new_zeros(1, 2), [view.view for view in self.views]
        sizes = [len(view.means2d) for view in self.views]

        def attach(grad: Tensor) -> None:
            target = node()
            if target is None:
                return
            parts = []
            for view, size in zip(of_views, sizes, strict=True):
                absgrad = view.screen.absgrad  # None: no loss depends on this picture
                parts.append(zero.expand(size, 2) if absgrad is None else view.pick(absgrad))
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
        return self.join(v.view.screen.rows for v in self.views) if self.packed else None

    def _opacities(self, given: Tensor) -> Tensor:
        if self.views[0].view.options.antialiased:
            return self.of_screens(lambda screen: screen.opacities)
        N = given.shape[-1]
        of_views = given[..., None, :].expand(*self.shape, N).reshape(len(self.views), N)
        pairs = zip(self.views, of_views, strict=True)
        return self.join(v.view.pick(o) for v, o in pairs)
