"""The three passes of passes.py as torch's autograd, and torch.func, call them.

Torch and Dr.Jit share the memory of the Gaussians, the picture and the gradients: nothing is
copied. With x all that is differentiated and y the images,

    Render    x -> y            forward
    Adjoint   x, dL/dy -> dL/dx    what Render's backward is: linear in dL/dy
    Tangent   x, dx -> dy          what Render's jvp is: linear in dx

The adjoint and the tangent are each other's transpose, so that each is the other's derivative by
what it is linear in. Their derivatives by x would be second ones of the picture, which nobody has
written: ``FirstOrder`` (first_order.py) stands before x and refuses them, whoever asks and however.
"""

from __future__ import annotations

import functools
import inspect
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float, Float64
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.splat.camera import Camera
from gva_mi.splat.first_order import FirstOrder, refuse_batches
from gva_mi.splat.kernels.exclusive import exclusive
from gva_mi.splat.kernels.inputs import Inputs, Wanted
from gva_mi.splat.kernels.passes import Saved, render_adjoint, render_forward, render_tangent
from gva_mi.splat.kernels.planes import Planes
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.screen import Screen, of_rows, tensor_of
from gva_mi.threads import alone_on_the_cores

ALIGNMENT = 64  # bytes; torch's own memory has it
PRECISION = {torch.float32: Float, torch.float64: Float64}
IMAGES = 3  # color, alpha, depth

Images = tuple[Tensor | None, ...]  # color, alpha, depth; their gradients or tangents


class Tensors(NamedTuple):
    """What is differentiated: the tensors of ``Render``, or their gradients or tangents."""

    means: Any
    quats: Any
    scales: Any
    opacities: Any
    colors: Any  # or coefficients
    background: Any
    T_camera_world: Any
    K: Any
    means2d: Any  # of some rows, where they are a node of the graph (means2d.py)
    known: Any  # the same rows, told the same gradient

    @property
    def gaussians(self) -> tuple[Any, ...]:
        """The five of the Gaussians, in the order of the kernels' ``Inputs``."""
        return self[:5]


def not_compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that ``torch.compile`` runs as it is: it would look for tensors in the kernels.

    ``torch.compiler.disable`` imports the compiler, which takes as long as all of torch: so only
    where somebody has imported it before.
    """
    as_it_is = function

    @functools.wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:  # noqa: ANN401
        nonlocal as_it_is
        if as_it_is is function and "torch._dynamo" in sys.modules:
            as_it_is = torch.compiler.disable(function)
        return as_it_is(*arguments, **options)

    return call


def signed(forward: Callable[..., Any]) -> Callable[..., Any]:
    """A function that keeps its signature: torch asks for it at every call of the operation."""
    forward.__signature__ = inspect.signature(forward)
    return forward


@dataclass
class Call:
    """One call of ``render``: its constants, and what the forward pass leaves for the others."""

    camera: Camera
    options: SplatOptions
    harmonics: bool  # whether the colours are coefficients
    screen: Screen | None
    covariances: bool = False  # whether scales and quats hold covariances (covariance.py)
    packed: bool = False  # whether means2d has rows of those in the picture alone
    rows: Tensor | None = None  # these, once they are known
    saved: Saved | None = None
    elements: list[Call] | None = None  # under vmap: of each element of the batch
    copied: Callable[[], None] | None = None  # called when torch has kept means2d's gradient

    def pick(self, numbers: Tensor) -> Tensor:
        """Of numbers of all Gaussians, (N, ...), those of ``means2d``'s rows."""
        return numbers if self.rows is None else numbers.index_select(0, self.rows)

    def wanted(self, by: Tensors) -> Wanted:
        """What the kernels are asked for where gradients ``by`` some tensors are."""
        camera = bool(by.T_camera_world or by.K)
        of_gaussians = any((by.means, by.quats, by.scales, by.opacities, by.means2d, by.known))
        geometry = of_gaussians or camera or self.screen is not None
        absolute = self.screen is not None and self.screen.absolute
        return Wanted(geometry, bool(by.colors) or not geometry, camera, absolute)

    def each(self, count: int) -> list[Call]:
        """A call for each element of a batch, the same ones every time."""
        if self.elements is None:
            self.elements = [replace(self) for _ in range(count)]
        return self.elements


def one_by_one(
    function: type[torch.autograd.Function],
    info: Any,  # noqa: ANN401
    dims: tuple,
    arguments: tuple,
) -> tuple[tuple, tuple]:
    """vmap: a call for each element of the batch, and their results stacked.

    Where the batch is one of gradients or tangents alone, as a Jacobian's rows are, all its
    elements are of the same picture, and so of the same call.
    """
    same_picture = all(dim is None for dim in dims[: len(Tensors._fields)])
    results = []
    for k in range(info.batch_size):
        element = [
            value if dim is None else value.select(dim, k)
            for value, dim in zip(arguments, dims, strict=True)
        ]
        call = next(i for i, value in enumerate(element) if isinstance(value, Call))
        if not same_picture:
            element[call] = element[call].each(info.batch_size)[k]
        results.append(function.apply(*element))
    columns = list(zip(*results, strict=True))
    stacked = tuple(None if c[0] is None else torch.stack(c) for c in columns)
    return stacked, tuple(None if c is None else 0 for c in stacked)


class Render(torch.autograd.Function):
    """The picture: ``Tensors`` and a ``Call`` to color, alpha and, where it is made, depth."""

    @staticmethod
    @signed
    @exclusive
    def forward(*arguments: Any) -> Images:  # noqa: ANN401
        *tensors, call = arguments
        if call.saved is None:
            draw(call, Tensors(*tensors))
        return _images(call.saved.planes, call.saved)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: Images) -> None:
        *tensors, ctx.call = inputs
        ctx.save_for_backward(*tensors, *output)
        ctx.save_for_forward(*tensors)
        ctx.set_materialize_grads(False)

    @staticmethod
    @not_compiled
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        # the kernels hold the same memory: this raises where it was overwritten in the meantime
        tensors = ctx.saved_tensors[: len(Tensors._fields)]
        wanted = ctx.call.wanted(Tensors(*ctx.needs_input_grad[:-1]))
        grads = (*grads, *[None] * (IMAGES - len(grads)))
        if not torch.is_grad_enabled():
            return *_adjoint(Tensors(*tensors), grads, ctx.call, wanted), None
        return *Adjoint.apply(*FirstOrder.apply(*tensors), *grads, ctx.call, wanted), None

    @staticmethod
    @not_compiled
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> Images:
        tensors = FirstOrder.apply(*ctx.saved_tensors)
        return Tangent.apply(*tensors, *tangents[:-1], ctx.call)

    @staticmethod
    def vmap(info: Any, dims: tuple, *arguments: Any) -> tuple[tuple, tuple]:  # noqa: ANN401
        return one_by_one(Render, info, dims, arguments)


class Adjoint(torch.autograd.Function):
    """``Tensors``, the images' gradients, a ``Call``, what is ``Wanted``; to ``Tensors``."""

    @staticmethod
    def forward(*arguments: Any) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        *values, call, wanted = arguments
        tensors, grads = Tensors(*values[:-IMAGES]), tuple(values[-IMAGES:])
        return tuple(_adjoint(tensors, grads, call, wanted))

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        *values, ctx.call, ctx.wanted = inputs
        ctx.given = [grad is not None for grad in values[-IMAGES:]]
        ctx.save_for_backward(*values[:-IMAGES])
        ctx.save_for_forward(*values[:-IMAGES])
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        images = Tangent.apply(*ctx.saved_tensors, *tangents, ctx.call)
        images = (*images, *[None] * (IMAGES - len(images)))
        by_grads = [x if given else None for x, given in zip(images, ctx.given, strict=True)]
        return *[None] * len(tangents), *by_grads, None, None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        *_, color, alpha, depth, _, _ = tangents
        return Adjoint.apply(*ctx.saved_tensors, color, alpha, depth, ctx.call, ctx.wanted)

    @staticmethod
    def vmap(info: Any, dims: tuple, *arguments: Any) -> tuple[tuple, tuple]:  # noqa: ANN401
        return one_by_one(Adjoint, info, dims, arguments)


class Tangent(torch.autograd.Function):
    """``Tensors``, their tangents and a ``Call`` to the tangents of the images."""

    @staticmethod
    def forward(*arguments: Any) -> Images:  # noqa: ANN401
        *values, call = arguments
        return _tangent(Tensors(*values[len(Tensors._fields) :]), call)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: Images) -> None:
        *values, ctx.call = inputs
        tensors, tangents = values[: len(Tensors._fields)], values[len(Tensors._fields) :]
        ctx.given = [tangent is not None for tangent in tangents]
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        grads = (*grads, *[None] * (IMAGES - len(grads)))
        wanted = ctx.call.wanted(Tensors(*ctx.given))
        found = Adjoint.apply(*ctx.saved_tensors, *grads, ctx.call, wanted)
        by_tangents = [x if given else None for x, given in zip(found, ctx.given, strict=True)]
        return *[None] * len(found), *by_tangents, None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> Images:
        return Tangent.apply(*ctx.saved_tensors, *tangents[len(Tensors._fields) : -1], ctx.call)

    @staticmethod
    def vmap(info: Any, dims: tuple, *arguments: Any) -> tuple[tuple, tuple]:  # noqa: ANN401
        return one_by_one(Tangent, info, dims, arguments)


@exclusive
@alone_on_the_cores()
def draw(call: Call, given: Tensors) -> None:
    """The forward pass: fills ``call.saved``, the screen and, packed, ``call.rows``."""
    screen, F = call.screen, PRECISION[given.means.dtype]
    inputs = Inputs(*(to_drjit(part, F) for part in given.gaussians))
    absolute = screen is not None and screen.absolute
    background = given.background.tolist()
    call.saved = render_forward(
        inputs,
        call.harmonics,
        call.camera,
        call.options,
        background,
        absolute,
        covariances=call.covariances,
    )
    dr.sync_thread()  # torch reads the memory next
    if screen is not None:
        screen.fill(call.saved, given.means)
    if call.packed:
        call.rows = screen.rows


@exclusive
@alone_on_the_cores()
def _adjoint(tensors: Tensors, grads: Images, call: Call, wanted: Wanted) -> Tensors:
    """dL/dx from dL/dy; None where it is not wanted."""
    refuse_batches(*grads)
    color, alpha, depth = grads
    saved, screen = call.saved, call.screen
    grad = Planes(
        _padded(color, saved, saved.plan.channels),
        None if alpha is None else _padded(alpha, saved),
        None if depth is None else _padded(depth, saved),
    )
    found = render_adjoint(saved, grad, wanted)
    dr.sync_thread()
    by_means2d = None if found.means2d is None else tensor_of(found.means2d).view(-1, 2)
    if screen is not None:
        screen.grad = by_means2d
        if screen.absolute:
            screen.absgrad = tensor_of(found.absolute).view(-1, 2)
    by_gaussians = (
        None if flat is None else tensor_of(flat).view(part.shape)
        for flat, part in zip(found.inputs, tensors.gaussians, strict=True)
    )
    new = tensors.background.new_tensor
    matrix = lambda given, value: new(value) if wanted.camera and given is not None else None
    node = known = None
    if tensors.means2d is not None:
        known = by_means2d if call.rows is None else of_rows(by_means2d.numpy(), call.rows)
        node = known.view(tensors.means2d.shape)
    return Tensors(
        *by_gaussians,
        background=new(found.background),
        T_camera_world=matrix(tensors.T_camera_world, found.T_camera_world),
        K=matrix(tensors.K, found.K),
        means2d=node,
        known=known,
    )


@exclusive
@alone_on_the_cores()
def _tangent(given: Tensors, call: Call) -> Images:
    """dy from dx; None is zero. What means and camera do to ``means2d`` is part of theirs."""
    refuse_batches(*given)
    saved = call.saved
    F = saved.inputs.float_type
    zero = lambda size: dr.opaque(F, 0, size)
    flat = [
        zero(dr.width(part)) if tangent is None else to_drjit(tangent, F)
        for part, tangent in zip(saved.inputs, given.gaussians, strict=True)
    ]
    matrix = lambda tangent, size: (
        np.zeros((size, size)) if tangent is None else tangent.detach().double().numpy()
    )
    behind = given.background
    planes = render_tangent(
        saved,
        Inputs(*flat),
        matrix(given.T_camera_world, 4),
        matrix(given.K, 3),
        [0.0] * saved.plan.channels if behind is None else behind.tolist(),
    )
    dr.sync_thread()
    return _images(planes, saved)


def to_drjit(tensor: Tensor, F: type) -> Array:
    """The tensor's own memory, flat; a copy where Dr.Jit could not read it in packets."""
    tensor = tensor.detach().contiguous()
    if tensor.data_ptr() % ALIGNMENT:  # from numpy, or a slice
        tensor = tensor.clone()
    return F(tensor.view(-1))


def _images(planes: Planes, saved: Saved) -> Images:
    color = _to_torch(planes.color, saved, saved.plan.channels)
    alpha = _to_torch(planes.alpha, saved)
    return (
        (color, alpha) if planes.depth is None else (color, alpha, _to_torch(planes.depth, saved))
    )


def _to_torch(plane: Array, saved: Saved, *channels: int) -> Tensor:
    """A plane without its padding; in one piece where the width is a multiple of a tile's."""
    layout = saved.layout
    numbers = tensor_of(plane, math.prod((*layout.padded, *channels)))
    return numbers.view(*layout.padded, *channels)[: layout.height, : layout.width]


def _padded(grad: Tensor | None, saved: Saved, *channels: int) -> Array:
    """The gradient of an image as a plane; zero where there is none."""
    layout, F = saved.layout, type(saved.inputs.means)
    if grad is None:
        return dr.opaque(F, 0, math.prod((*layout.padded, *channels)))
    if grad.shape[:2] != layout.padded:
        whole = grad.new_zeros(*layout.padded, *channels)
        whole[: layout.height, : layout.width] = grad
        grad = whole
    return to_drjit(grad, F)
