"""``render`` on torch tensors; its passes as operations of torch's autograd and torch.func.

The precision is that of the tensors: float64 Gaussians run the same kernels in float64. All three
images are differentiable by every tensor of the Gaussians, by the background, and by the camera's
matrices where these are tensors. A :class:`Screen` receives what densification needs.

With x everything that is differentiated and y the images,

    _Forward    x -> y               forward
    _Adjoint    x, dL/dy -> dL/dx    backward of _Forward: linear in dL/dy
    _Tangent    x, dx -> dy          jvp of _Forward: linear in dx

_Adjoint and _Tangent are each other's transpose, so each is the other's derivative with respect to
the argument in which it is linear. Their derivatives with respect to x would be second derivatives
of the picture, which are not implemented: ``_FirstOrder`` stands before x and refuses them.
"""

from __future__ import annotations

from typing import Any, NoReturn

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.jit.frozen import exclusive
from gva_mi.jit.tensors import PRECISION, not_compiled
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.torch_passes import (
    IMAGE_COUNT,
    Drawn,
    Images,
    Screen,
    Tensors,
    adjoint,
    draw,
    images,
    tangent,
)

COUNT = len(Tensors._fields)
SMALLEST_ALPHA = 1e-10  # by which a depth is divided, as in gsplat
NO_SECOND_DERIVATIVES = (
    "render(): its gradients and tangents cannot be differentiated again with respect to the "
    "Gaussians, the background or the camera; second derivatives, which a Hessian or a penalty on "
    "a gradient needs, are not available"
)


def one_by_one(function: type[torch.autograd.Function]) -> type[torch.autograd.Function]:
    """Give an operation its vmap: call it for each element of a batch and stack the results.

    Where only gradients or tangents are batched, as a Jacobian's rows are, all elements belong to
    the same picture.

    Example:
        >>> @one_by_one
        ... class Double(torch.autograd.Function):
        ...     forward = staticmethod(lambda x: (2 * x,))
        ...     setup_context = staticmethod(lambda ctx, inputs, output: None)
        >>> torch.vmap(Double.apply)(torch.tensor([1.0, 2.0]))
        (tensor([2., 4.]),)
    """

    def vmap(info: Any, dims: tuple, *arguments: Any) -> tuple[tuple, tuple]:  # noqa: ANN401
        same_picture = all(dim is None for dim in dims[:COUNT])

        def element(value: Any, dim: int | None, k: int) -> Any:  # noqa: ANN401
            if isinstance(value, Drawn) and not same_picture:
                return value.elements[k]
            return value if dim is None else value.select(dim, k)

        results = [
            function.apply(*(element(v, dim, k) for v, dim in zip(arguments, dims, strict=True)))
            for k in range(info.batch_size)
        ]
        stacked = tuple(_stacked(column) for column in zip(*results, strict=True))
        return stacked, tuple(0 if isinstance(x, Tensor) else None for x in stacked)

    function.vmap = staticmethod(vmap)
    return function


def _stacked(column: tuple) -> Any:  # noqa: ANN401
    first = column[0]
    if isinstance(first, Drawn):
        return Drawn(None, first.screen, elements=column)
    return None if first is None else torch.stack(column)


@one_by_one
class _Forward(torch.autograd.Function):
    """Forward pass: from ``Tensors`` and constants to color, alpha, depth and ``Drawn``.

    The constants are those of :func:`draw`: camera, options, harmonics and screen.
    """

    @staticmethod
    @exclusive
    def forward(*arguments: Any) -> tuple:  # noqa: ANN401
        drawn = draw(Tensors(*arguments[:COUNT]), *arguments[COUNT:])
        return *images(drawn.saved.planes, drawn.saved), drawn

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        keep(ctx, inputs[:COUNT], output[-1])

    @staticmethod
    @not_compiled
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        return *pull(ctx, grads[:-1]), None, None, None, None

    @staticmethod
    @not_compiled
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple:
        return *push(ctx, tangents[:COUNT]), None


def keep(ctx: FunctionCtx, tensors: tuple, drawn: Drawn) -> None:
    """Keep what :func:`pull` and :func:`push` need, in an operation that returns images.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5).to(torch.float64)
        >>> ctx = render(scene.gaussians, scene.camera).color.grad_fn  # the operation
        >>> type(ctx.drawn).__name__, torch.equal(ctx.saved_tensors[0], scene.gaussians.means)
        ('Drawn', True)
    """
    ctx.drawn = drawn
    # the kernels read the tensors' memory again: torch raises if it was overwritten
    ctx.save_for_backward(*tensors)
    ctx.save_for_forward(*tensors)
    ctx.set_materialize_grads(False)


def pull(ctx: FunctionCtx, grads: tuple[Tensor | None, ...]) -> tuple[Tensor | None, ...]:
    """Return the gradients with respect to ``Tensors``, given those of the images.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5).to(torch.float64)
        >>> color = render(scene.gaussians, scene.camera).color
        >>> grads = Tensors(*pull(color.grad_fn, (torch.ones_like(color), None)))
        >>> color.sum().backward()  # calls it, too
        >>> torch.equal(grads.means, scene.gaussians.means.grad)
        True
    """
    tensors, drawn, by_images = ctx.saved_tensors, ctx.drawn, _three(grads)
    requested = drawn.requested(Tensors(*ctx.needs_input_grad[:COUNT]))
    if not torch.is_grad_enabled():
        return adjoint(Tensors(*tensors), by_images, drawn, requested)
    return _Adjoint.apply(*_FirstOrder.apply(*tensors), *by_images, drawn, requested)


def push(ctx: FunctionCtx, tangents: tuple[Tensor | None, ...]) -> Images:
    """Return the tangents of the images along tangents of ``Tensors``.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5).to(torch.float64)
        >>> image = render(scene.gaussians, scene.camera)
        >>> brighter = dict(background=torch.ones(3).double())
        >>> tangents = Tensors(**dict.fromkeys(Tensors._fields) | brighter)
        >>> color, *_ = push(image.color.grad_fn, tangents)
        >>> torch.allclose(color[..., 0], 1 - image.alpha)  # it shines through
        True
    """
    return _Tangent.apply(*_FirstOrder.apply(*ctx.saved_tensors), *tangents, ctx.drawn)


@one_by_one
class _Adjoint(torch.autograd.Function):
    """Backward pass: from ``Tensors``, image gradients, ``Drawn`` and a request to gradients."""

    @staticmethod
    def forward(*arguments: Any) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        *values, drawn, requested = arguments
        tensors, grads = Tensors(*values[:-IMAGE_COUNT]), tuple(values[-IMAGE_COUNT:])
        return tuple(adjoint(tensors, grads, drawn, requested))

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        *values, ctx.drawn, ctx.requested = inputs
        ctx.given = [grad is not None for grad in values[-IMAGE_COUNT:]]
        ctx.save_for_backward(*values[:-IMAGE_COUNT])
        ctx.save_for_forward(*values[:-IMAGE_COUNT])
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        images = _three(_Tangent.apply(*ctx.saved_tensors, *tangents, ctx.drawn))
        by_grads = [x if given else None for x, given in zip(images, ctx.given, strict=True)]
        return *[None] * len(tangents), *by_grads, None, None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        *_, color, alpha, depth, _, _ = tangents
        return _Adjoint.apply(*ctx.saved_tensors, color, alpha, depth, ctx.drawn, ctx.requested)


@one_by_one
class _Tangent(torch.autograd.Function):
    """Tangent pass: from ``Tensors``, their tangents and ``Drawn`` to the images' tangents."""

    @staticmethod
    def forward(*arguments: Any) -> Images:  # noqa: ANN401
        *values, drawn = arguments
        return tangent(Tensors(*values[COUNT:]), drawn)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: Images) -> None:
        *values, ctx.drawn = inputs
        tensors, tangents = values[:COUNT], values[COUNT:]
        ctx.given = [tangent is not None for tangent in tangents]
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        requested = ctx.drawn.requested(Tensors(*ctx.given))
        found = _Adjoint.apply(*ctx.saved_tensors, *_three(grads), ctx.drawn, requested)
        by_tangents = [x if given else None for x, given in zip(found, ctx.given, strict=True)]
        return *[None] * len(found), *by_tangents, None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> Images:
        return _Tangent.apply(*ctx.saved_tensors, *tangents[COUNT:-1], ctx.drawn)


class _FirstOrder(torch.autograd.Function):
    """Pass tensors on, and refuse to be differentiated.

    Without it torch would take second derivatives for zero wherever dL/dy is a constant.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(*tensors: Tensor | None) -> tuple[Tensor | None, ...]:
        return tuple(None if tensor is None else tensor.view_as(tensor) for tensor in tensors)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> NoReturn:
        raise RuntimeError(NO_SECOND_DERIVATIVES)

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> NoReturn:
        raise RuntimeError(NO_SECOND_DERIVATIVES)


def _three(images: tuple) -> Images:
    """Append None for a depth that is not made."""
    return *images, *[None] * (IMAGE_COUNT - len(images))


_DEFAULTS = SplatOptions()


@not_compiled
def render(
    gaussians: Gaussians[Tensor],
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Tensor | None = None,
    screen: Screen | None = None,
) -> Image[Tensor]:
    """Draw ``gaussians`` as seen from ``camera`` (paper, Eq. 1-3).

    Args:
        gaussians: CPU tensors of one dtype, float32 or float64; contiguous ones are not copied.
            Shapes and units: :class:`Gaussians`.
        camera: the view; any size of picture. Made from tensors of the same dtype, it is
            differentiable: :meth:`Camera.from_matrices`.
        options: cut-offs.
        background: (D,) colour behind the Gaussians; None is black, as in gsplat.
        screen: filled with means, radii and gradients in the picture, for densification.

    Returns:
        color (H, W, D), alpha (H, W) and depth (H, W), in the precision of the Gaussians; no depth
        where ``options.depth`` is off.

    Raises:
        ValueError: a shape, dtype or device is wrong, or a number is NaN or infinite.

    Note:
        The order by depth and the set of pixels a Gaussian reaches are not differentiated: the
        image is smooth except for steps of ``options.alpha_min`` and ``transmittance_min``.
        Second derivatives raise. ``torch.func``'s transforms work, ``vmap`` one element after the
        other; ``torch.compile`` runs it between graphs, uncompiled.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5, width=8, height=6)
        >>> scene = scene.to(torch.float64)  # as leaves that need gradients
        >>> image = render(scene.gaussians, scene.camera, background=scene.background)
        >>> tuple(image.color.shape), tuple(image.alpha.shape)
        ((6, 8, 3), (6, 8))
        >>> image.color.sum().backward()  # a background's channel counts where nothing covers it
        >>> round(float(scene.background.grad[0] - (1 - image.alpha.detach()).sum()), 9)
        0.0
    """
    _check(gaussians, background, camera)
    constants = (camera, options, gaussians.sh is not None, screen)
    images = _Forward.apply(*tensors_of(gaussians, background, camera), *constants)
    return Image(*images[:-1])


def tensors_of(gaussians: Gaussians, background: Tensor | None, camera: Camera) -> Tensors:
    """Collect everything that is differentiated; black where there is no background.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5)
        >>> tensors = tensors_of(scene.gaussians, None, scene.camera)
        >>> tensors.background.tolist(), tensors.K  # K: only if the camera is made from tensors
        ([0.0, 0.0, 0.0], None)
    """
    g = gaussians
    if background is None:
        background = g.means.new_zeros(g.channels)
    colors = g.colors if g.sh is None else g.sh
    shape = (g.quats, g.scales, g.covars)
    return Tensors(g.means, *shape, g.opacities, colors, background, *camera.tensors)


def expected_depth(image: Image[Tensor]) -> Tensor:
    """Depth per alpha, (H, W) m: the mean z of what a pixel shows; 0 where it shows nothing.

    It is gsplat's render mode ED, with gsplat's bound of alpha.

    Example:
        >>> image = Image(None, alpha=torch.tensor([[0.5, 0.0]]), depth=torch.tensor([[1.0, 0.0]]))
        >>> expected_depth(image).tolist()
        [[2.0, 0.0]]
    """
    return image.depth / image.alpha.clamp(min=SMALLEST_ALPHA)


def _check(gaussians: Gaussians, background: Tensor | None, camera: Camera) -> None:
    """Check everything that the kernels rely on.

    Raises:
        ValueError: a kind, dtype, device or shape is wrong.
    """
    dtype = getattr(gaussians.means, "dtype", None)
    for name, tensor in gaussians.arrays().items():
        if problem := problem_of(tensor):
            raise ValueError(f"render(): {name} {problem}")
        if tensor.dtype != dtype:
            found = f"means {dtype}, {name} {tensor.dtype}"
            raise ValueError(f"render(): all tensors must have one dtype, got {found}")
    gaussians.check_shapes()
    D = gaussians.channels
    if background is not None and tuple(background.shape) != (D,):
        raise ValueError(f"render(): background must be ({D},), got {tuple(background.shape)}")
    shapes = {
        "the camera's T_camera_world": (camera.tensors.T_camera_world, (4, 4)),
        "the camera's K": (camera.tensors.K, (3, 3)),
    }
    for name, (tensor, shape) in shapes.items():
        if tensor is None:
            continue
        if not isinstance(tensor, Tensor) or tuple(tensor.shape) != shape:
            found = tuple(tensor.shape) if isinstance(tensor, Tensor) else type(tensor).__name__
            raise ValueError(f"render(): {name} must be a tensor of shape {shape}, got {found}")
        if tensor.dtype != dtype or tensor.device.type != "cpu":
            found = f"{tensor.dtype} on {tensor.device}"
            raise ValueError(f"render(): {name} must be {dtype} on the CPU, got {found}")


def problem_of(tensor: Tensor) -> str | None:
    """Return what keeps the kernels from reading a tensor, if anything does.

    Example:
        >>> problem_of(torch.zeros(3)), problem_of(torch.arange(3))
        (None, 'must be float32 or float64 on the CPU, got torch.int64 on cpu')
    """
    if not isinstance(tensor, Tensor):
        return f"must be a torch tensor, got {type(tensor).__name__}"
    if not tensor.is_cpu or tensor.dtype not in PRECISION:
        return f"must be float32 or float64 on the CPU, got {tensor.dtype} on {tensor.device}"
    return None
