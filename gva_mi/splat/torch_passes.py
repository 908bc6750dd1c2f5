"""The forward, adjoint and tangent passes on torch tensors, and what they leave on the screen.

torch and Dr.Jit share the memory of the Gaussians, the picture and the gradients: nothing is
copied. torch_render.py joins the passes to torch's autograd.

A :class:`Screen` has the means, sizes and gradients of the Gaussians in the picture::

    screen = Screen()
    image = render(gaussians, camera, screen=screen)
    loss(image).backward()
    moved = screen.grad.norm(dim=1)  # loss per pixel of motion; 0 where not screen.visible
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from torch import Tensor

from gva_mi.core.cpu import quiet_openmp
from gva_mi.jit import packets
from gva_mi.jit.frozen import exclusive
from gva_mi.jit.tensors import PRECISION, tensor_of, to_drjit
from gva_mi.splat.camera import Camera
from gva_mi.splat.kernels.inputs import Inputs, RequestedGradients
from gva_mi.splat.kernels.passes import SavedState, render_adjoint, render_forward, render_tangent
from gva_mi.splat.kernels.project import ProjectedMemory
from gva_mi.splat.kernels.records import Footprint, RecordFormat, Splat
from gva_mi.splat.kernels.tile_memory import Planes
from gva_mi.splat.kernels.tiles import Layout
from gva_mi.splat.options import SplatOptions

IMAGE_COUNT = 3  # images: color, alpha, depth
NO_BATCHES = (
    "render(): it takes no gradients or tangents in batches, as is_grads_batched and "
    "functional.jacobian's vectorize make them; torch.func's jacrev, jacfwd and vmap work"
)

Images = tuple[Tensor | None, ...]  # color, alpha, depth; their gradients or tangents


class Tensors(NamedTuple):
    """Differentiable tensors of ``render``, or their gradients or tangents.

    Example:
        >>> names = Tensors(*Tensors._fields)
        >>> names[6:], list(names.gaussians())
        (('background', 'T_camera_world', 'K'),
         ['means', 'quats', 'scales', 'covars', 'opacities', 'colors'])
    """

    means: Any
    quats: Any  # None, with scales, where covars are given
    scales: Any
    covars: Any
    opacities: Any
    colors: Any  # or coefficients
    background: Any
    T_camera_world: Any
    K: Any

    def gaussians(self) -> dict[str, Any]:
        """Return the Gaussians' six tensors, by name."""
        return dict(zip(self._fields[:6], self, strict=False))


@dataclass(frozen=True)
class Drawn:
    """What a forward pass keeps for its adjoint and tangent.

    Example:
        If only colours need gradients, the adjoint leaves out the geometry.

        >>> needs = dict.fromkeys(Tensors._fields, False) | {"colors": True}
        >>> Drawn(saved=None, screen=None).requested(Tensors(**needs))
        RequestedGradients(geometry=False, colors=True, camera=False, absolute=False)
    """

    saved: SavedState | None  # None for a batch
    screen: Screen | None
    elements: tuple[Drawn, ...] = ()  # of a batch, under vmap

    def requested(self, by: Tensors) -> RequestedGradients:
        """Return the gradients to compute; ``by`` flags the tensors that need one."""
        camera, screen = bool(by.T_camera_world or by.K), self.screen
        gaussians = (by.means, by.quats, by.scales, by.covars, by.opacities)
        geometry = any(gaussians) or camera or screen is not None
        absolute = screen is not None and screen.absolute
        return RequestedGradients(geometry, bool(by.colors) or not geometry, camera, absolute)


@exclusive
@quiet_openmp()
def draw(
    given: Tensors, camera: Camera, options: SplatOptions, harmonics: bool, screen: Screen | None
) -> Drawn:
    """Run the forward pass, and fill the screen; ``harmonics``: the colours are coefficients.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> from gva_mi.splat.torch_render import tensors_of
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5, width=8, height=6)
        >>> given = tensors_of(scene.gaussians, scene.background, scene.camera)
        >>> screen = Screen()
        >>> drawn = draw(given, scene.camera, scene.options, harmonics=False, screen=screen)
        >>> drawn.saved.layout.padded, screen.visible.tolist()  # whole tiles of 8 x 4 pixels
        ((8, 8), [True, True, True, True, True])
    """
    F = PRECISION[given.means.dtype]
    arrays = {k: to_drjit(x, F) for k, x in given.gaussians().items() if x is not None}
    saved = render_forward(
        Inputs.of_named(arrays),
        harmonics,
        camera,
        options,
        given.background.tolist(),
        absolute=screen is not None and screen.absolute,
    )
    dr.sync_thread()  # torch reads the memory next
    if screen is not None:
        screen.fill(saved, given.means)
    return Drawn(saved, screen)


@exclusive
@quiet_openmp()
def adjoint(
    tensors: Tensors, grads: Images, drawn: Drawn, requested: RequestedGradients
) -> Tensors:
    """Compute dL/dx from dL/dy; None for a gradient that is not requested.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> from gva_mi.splat.torch_render import tensors_of
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5, width=8, height=6)
        >>> given = tensors_of(scene.gaussians, scene.background, scene.camera)
        >>> drawn = draw(given, scene.camera, scene.options, harmonics=False, screen=None)
        >>> requested = drawn.requested(Tensors(*(x is not None for x in given)))
        >>> grad = adjoint(given, (torch.ones(6, 8, 3), None, None), drawn, requested)
        >>> tuple(grad.means.shape), grad.covars  # not given: quats and scales are
        ((5, 3), None)
    """
    _refuse_batches(*grads)
    color, alpha, depth = grads
    saved, screen = drawn.saved, drawn.screen
    layout, F = saved.layout, saved.inputs.float_type
    grad = Planes(
        _plane_of(color, layout, F, saved.plan.channels),
        None if alpha is None else _plane_of(alpha, layout, F),
        None if depth is None else _plane_of(depth, layout, F),
    )
    gradients = render_adjoint(saved, grad, requested)
    dr.sync_thread()
    if screen is not None:
        rows = lambda flat: tensor_of(flat, 2 * len(saved.inputs)).view(-1, 2)
        screen.grad = rows(gradients.gaussians.u)
        if screen.absolute:
            screen.absgrad = rows(gradients.gaussians.absolute)
    by_gaussians = {
        name: tensor_of(flat, given.numel()).view(given.shape)
        for name, flat in gradients.named()
        if (given := getattr(tensors, name)) is not None
    }
    new = tensors.background.new_tensor
    by_camera = {
        name: new(getattr(gradients, name)) if requested.camera and given is not None else None
        for name, given in (("T_camera_world", tensors.T_camera_world), ("K", tensors.K))
    }
    rest = by_camera | {"background": new(gradients.background)}
    return Tensors(**dict.fromkeys(Tensors._fields) | by_gaussians | rest)


@exclusive
@quiet_openmp()
def tangent(given: Tensors, drawn: Drawn) -> Images:
    """Compute dy from dx; None is zero.

    Example:
        <w, J v> = <Jᵀ w, v>: the sum of all pixels as all means move along (1, 1, 1).

        >>> from gva_mi.splat.scene import random_scene
        >>> from gva_mi.splat.torch_render import tensors_of
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5, width=8, height=6)
        >>> given = tensors_of(scene.gaussians, scene.background, scene.camera)
        >>> drawn = draw(given, scene.camera, scene.options, harmonics=False, screen=None)
        >>> v = Tensors(**dict.fromkeys(Tensors._fields) | {"means": torch.ones(5, 3)})
        >>> color, alpha, depth = tangent(v, drawn)
        >>> requested = drawn.requested(Tensors(*(x is not None for x in given)))
        >>> grad = adjoint(given, (torch.ones(6, 8, 3), None, None), drawn, requested)
        >>> torch.allclose(color.sum(), grad.means.sum())
        True
    """
    _refuse_batches(*given)
    saved = drawn.saved
    F = saved.inputs.float_type
    flat = {}
    for name, array in saved.inputs.named():
        moved = getattr(given, name)
        flat[name] = dr.opaque(F, 0, dr.width(array)) if moved is None else to_drjit(moved, F)
    matrix = lambda moved, size: (
        np.zeros((size, size)) if moved is None else moved.detach().double().numpy()
    )
    behind = given.background
    planes = render_tangent(
        saved,
        Inputs.of_named(flat),
        matrix(given.T_camera_world, 4),
        matrix(given.K, 3),
        [0.0] * saved.plan.channels if behind is None else behind.tolist(),
    )
    dr.sync_thread()
    return images(planes, saved)


def images(planes: Planes, saved: SavedState) -> Images:
    """Return the images that are made, without their padding.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> from gva_mi.splat.torch_render import tensors_of
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5, width=8, height=6)
        >>> given = tensors_of(scene.gaussians, scene.background, scene.camera)
        >>> options = SplatOptions(depth=False)
        >>> saved = draw(given, scene.camera, options, harmonics=False, screen=None).saved
        >>> [tuple(image.shape) for image in images(saved.planes, saved)]
        [(6, 8, 3), (6, 8)]
    """
    layout = saved.layout
    color = _image_of(planes.color, layout, saved.plan.channels)
    rest = [_image_of(plane, layout) for plane in (planes.alpha, planes.depth) if plane is not None]
    return color, *rest


def _image_of(plane: Array, layout: Layout, *channels: int) -> Tensor:
    """Return a plane's own memory as an image (H, W, *channels), without its padding.

    The slice is taken by numpy: torch then sees no view, and lets a caller write into the image.
    """
    numbers = plane.numpy()[: math.prod((*layout.padded, *channels))]
    padded = numbers.reshape(*layout.padded, *channels)
    return torch.from_numpy(padded[: layout.height, : layout.width])


def _plane_of(image: Tensor | None, layout: Layout, F: type, *channels: int) -> Array:
    """Return an image as a plane, padded with zeros; zeros if there is no image."""
    if image is None:
        return dr.opaque(F, 0, math.prod((*layout.padded, *channels)))
    if image.shape[:2] != layout.padded:
        padded = image.new_zeros(*layout.padded, *channels)
        padded[: layout.height, : layout.width] = image
        image = padded
    return to_drjit(image, F)


def _refuse_batches(*tensors: Tensor | None) -> None:
    """Raise for batches of torch's older vmap, which bypasses ``Function.vmap``.

    Such a tensor hides its batch, and torch refuses to tell where its numbers are.
    """
    for tensor in tensors:
        try:
            if tensor is not None:
                tensor.data_ptr()
        except RuntimeError:
            raise RuntimeError(NO_BATCHES) from None


@dataclass
class Screen:
    """The Gaussians in one picture; ``render`` fills it, ``backward`` adds the gradients.

    Every property is read from the kernels' memory when it is used; unused ones cost nothing.
    ``grad`` is what density control of 3DGS reads, ``absgrad`` what AbsGS (Ye et al. 2024) reads.

    Example:
        >>> from gva_mi.splat import render
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5, width=8, height=6)
        >>> scene, screen = scene.to(torch.float64), Screen()
        >>> render(scene.gaussians, scene.camera, screen=screen).color.sum().backward()
        >>> tuple(screen.means2d.shape), tuple(screen.grad.shape)
        ((5, 2), (5, 2))
        >>> screen.visible.tolist()
        [True, True, True, True, True]
    """

    absolute: bool = False  # set to have absgrad filled as well
    grad: Tensor | None = None  # (N, 2) dL/dmeans2d, per px; 0 where not drawn
    absgrad: Tensor | None = None  # (N, 2) like grad, with the absolute value of each pixel's share
    _projected: ProjectedMemory | None = field(default=None, repr=False)  # None: no Gaussian
    _rows: Tensor | None = field(default=None, repr=False)  # once they are known
    _format: RecordFormat | None = field(default=None, repr=False)  # of its splats
    _size: tuple[int, int] = field(default=(0, 0), repr=False)  # of the picture, px
    _empty: Tensor | None = field(default=None, repr=False)  # (0,), of the Gaussians' dtype

    def fill(self, saved: SavedState, means: Tensor) -> None:
        """Take over the memory of a forward pass of Gaussians with means (N, 3)."""
        self.grad = self.absgrad = self._rows = None
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
    def boxes(self) -> Tensor:
        """Half extents where alpha >= alpha_min in whole pixels, (N, 2) int32; 0 if not drawn."""
        found = Footprint.unpack(torch.from_numpy(self._footprint_rows()).unbind(1))
        extents = torch.where(found.ry >= 0, torch.stack([found.rx, found.ry]), 0).T
        radii, means2d = torch.ceil(extents), self.means2d
        inside = (means2d + radii > 0) & (means2d - radii < torch.tensor(self._size))
        return torch.where(inside.all(dim=1, keepdim=True), radii, 0).to(torch.int32)

    @property
    def rows(self) -> Tensor:
        """Indices of the Gaussians that have a box, (M,) int64, ascending."""
        if self._projected is None:
            return torch.zeros(0, dtype=torch.int64)
        if self._rows is None:  # by numpy: torch takes eight times as long
            with exclusive:
                self._rows = torch.from_numpy(np.flatnonzero(self._projected.boxed.numpy()))
        return self._rows

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

    Example:
        >>> table = np.arange(8, dtype=np.float32).reshape(2, 4)
        >>> first_two_columns(table).tolist(), first_two_columns(table, torch.tensor([1])).tolist()
        ([[0.0, 1.0], [4.0, 5.0]], [[4.0, 5.0]])
    """
    number = np.complex64 if table.dtype == np.float32 else np.complex128
    pairs = table.view(number)[:, 0]
    if rows is None:
        found = pairs.copy()
    else:  # take() would copy the whole column first if it is not contiguous
        index = rows.numpy()
        found = pairs.take(index) if pairs.flags.contiguous else pairs[index]
    return torch.from_numpy(found.view(table.dtype).reshape(-1, 2))
