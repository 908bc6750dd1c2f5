"""The forward, adjoint and tangent passes on torch tensors.

torch and Dr.Jit share the memory of the Gaussians, the picture and the gradients: nothing is
copied. autograd.py joins the passes to torch's autograd.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from torch import Tensor

from gva_mi.core.cpu import quiet_openmp
from gva_mi.jit.exclusive import exclusive
from gva_mi.jit.tensors import PRECISION, tensor_of, to_drjit
from gva_mi.splat.camera import Camera
from gva_mi.splat.kernels.inputs import Inputs, RequestedGradients
from gva_mi.splat.kernels.passes import render_adjoint, render_forward, render_tangent
from gva_mi.splat.kernels.planes import Planes
from gva_mi.splat.kernels.saved import SavedState
from gva_mi.splat.kernels.tiles import Layout
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.screen import Screen, first_two_columns

IMAGE_COUNT = 3  # color, alpha, depth
NO_BATCHES = (
    "render(): it takes no gradients or tangents in batches, as is_grads_batched and "
    "functional.jacobian's vectorize make them; torch.func's jacrev, jacfwd and vmap work"
)

Images = tuple[Tensor | None, ...]  # color, alpha, depth; their gradients or tangents


class Tensors(NamedTuple):
    """Differentiable tensors of ``Render``, or their gradients or tangents."""

    means: Any
    quats: Any  # None, with scales, where covars are given
    scales: Any
    covars: Any
    opacities: Any
    colors: Any  # or coefficients
    background: Any
    T_camera_world: Any
    K: Any
    means2d: Any  # of some rows, where they are a node of the graph (gsplat/means2d.py)
    echo: Any  # the same rows, which receive the same gradient

    def gaussians(self) -> dict[str, Any]:
        """Return the Gaussians' six tensors, by name."""
        return dict(zip(self._fields[:6], self, strict=False))


@dataclass(frozen=True)
class RenderCall:
    """The constants of one call of ``render``."""

    camera: Camera
    options: SplatOptions
    harmonics: bool  # whether the colours are coefficients
    screen: Screen | None
    packed: bool = False  # whether means2d has rows only for the Gaussians in the picture

    def requested(self, by: Tensors) -> RequestedGradients:
        """Return the gradients to compute; ``by`` flags the tensors that need one."""
        camera = bool(by.T_camera_world or by.K)
        gaussians = (by.means, by.quats, by.scales, by.covars, by.opacities, by.means2d, by.echo)
        geometry = any(gaussians) or camera or self.screen is not None
        absolute = self.screen is not None and self.screen.absolute
        return RequestedGradients(geometry, bool(by.colors) or not geometry, camera, absolute)


@dataclass(frozen=True)
class Drawn:
    """State of a finished forward pass, for its adjoint and tangent."""

    call: RenderCall
    saved: SavedState | None = None  # None for a batch
    rows: Tensor | None = None  # the Gaussians in means2d's rows; None: all
    elements: tuple[Drawn, ...] = ()  # of a batch, under vmap

    def pick(self, numbers: Tensor) -> Tensor:
        """Select means2d's rows from numbers (N, ...) of all Gaussians."""
        return numbers if self.rows is None else numbers.index_select(0, self.rows)


@exclusive
@quiet_openmp()
def draw(call: RenderCall, given: Tensors) -> Drawn:
    """Run the forward pass, and fill the call's screen."""
    screen, F = call.screen, PRECISION[given.means.dtype]
    arrays = {k: to_drjit(x, F) for k, x in given.gaussians().items() if x is not None}
    saved = render_forward(
        Inputs.of_named(arrays),
        call.harmonics,
        call.camera,
        call.options,
        given.background.tolist(),
        absolute=screen is not None and screen.absolute,
    )
    dr.sync_thread()  # torch reads the memory next
    if screen is not None:
        screen.fill(saved, given.means)
    return Drawn(call, saved, screen.rows if call.packed else None)


@exclusive
@quiet_openmp()
def adjoint(
    tensors: Tensors, grads: Images, drawn: Drawn, requested: RequestedGradients
) -> Tensors:
    """Compute dL/dx from dL/dy; None for a gradient that is not requested."""
    _refuse_batches(*grads)
    color, alpha, depth = grads
    saved, screen = drawn.saved, drawn.call.screen
    layout, F = saved.layout, saved.inputs.float_type
    grad = Planes(
        _plane_of(color, layout, F, saved.plan.channels),
        None if alpha is None else _plane_of(alpha, layout, F),
        None if depth is None else _plane_of(depth, layout, F),
    )
    found = render_adjoint(saved, grad, requested)
    dr.sync_thread()
    by_u, by_absolute = found.gaussians.u, found.gaussians.absolute
    rows = lambda flat: tensor_of(flat, 2 * len(saved.inputs)).view(-1, 2)
    by_means2d = None if by_u is None else rows(by_u)
    if screen is not None:
        screen.grad = by_means2d
        if screen.absolute:
            screen.absgrad = rows(by_absolute)
    by_gaussians = {
        name: tensor_of(flat, given.numel()).view(given.shape)
        for name, flat in found.named()
        if (given := getattr(tensors, name)) is not None
    }
    new = tensors.background.new_tensor
    by_camera = {
        name: new(getattr(found, name)) if requested.camera and given is not None else None
        for name, given in (("T_camera_world", tensors.T_camera_world), ("K", tensors.K))
    }
    node = echo = None
    if tensors.means2d is not None:
        rows = drawn.rows
        echo = by_means2d if rows is None else first_two_columns(by_means2d.numpy(), rows)
        node = echo.view(tensors.means2d.shape)
    rest = {"background": new(found.background), "means2d": node, "echo": echo}
    return Tensors(**dict.fromkeys(Tensors._fields) | by_gaussians | by_camera | rest)


@exclusive
@quiet_openmp()
def tangent(given: Tensors, drawn: Drawn) -> Images:
    """Compute dy from dx; None is zero. The tangent of ``means2d`` is part of the means'."""
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
    """Return the images that are made, without their padding."""
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
