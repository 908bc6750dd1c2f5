"""``render`` on Dr.Jit tensors, for programs without torch.

It supports both modes of Dr.Jit's autodiff: ``dr.backward`` runs the adjoint kernels and
``dr.forward`` the tangent kernels. A program with several threads must hold
``gva_mi.splat.exclusive`` while it uses Dr.Jit, including ``dr.backward``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.jit.frozen import exclusive
from gva_mi.splat.camera import Camera, CameraTensors
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.kernels.inputs import Inputs, RequestedGradients
from gva_mi.splat.kernels.passes import render_adjoint, render_forward, render_tangent
from gva_mi.splat.kernels.tile_memory import Planes
from gva_mi.splat.kernels.tiles import Layout
from gva_mi.splat.options import SplatOptions

Tensor = TypeVar("Tensor", bound=Array)
_DEFAULTS = SplatOptions()
# Of what is differentiated. Of quats with scales, and covars, one form is None; sh is in colors.
NAMES = ("means", "quats", "scales", "covars", "opacities", "colors")


@exclusive
def render(
    gaussians: Gaussians[Tensor],
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Tensor | None = None,
    *,
    depth_limit: Tensor | None = None,
) -> Image[Tensor]:
    """Draw ``gaussians`` as seen from ``camera`` (paper, Eq. 1-3).

    Args:
        gaussians: Dr.Jit tensors of one kind: ``TensorXf`` or ``TensorXf64`` from ``drjit.llvm`` or
            ``drjit.llvm.ad``. Shapes and units: :class:`Gaussians`. The precision is theirs.
        camera: the view; any size of picture. Made from tensors of the same kind, it is
            differentiable: :meth:`Camera.from_matrices`.
        options: cut-offs.
        background: (D,) tensor of the same kind, the colour behind the Gaussians; None is black, as
            in gsplat.
        depth_limit: (H, W) tensor of the same kind, m along the camera's z: a pixel shows only the
            Gaussians whose means are nearer, as in front of an opaque surface; infinity shows all.

    Returns:
        color (H, W, D), alpha (H, W) and depth (H, W), tensors of the same kind; no depth where
        ``options.depth`` is off.

    Raises:
        ValueError: a shape or kind is wrong, or a number is NaN or infinite.

    Note:
        The order by depth, the set of pixels a Gaussian reaches and ``depth_limit`` are not
        differentiated.

    Example:
        >>> from drjit.llvm.ad import TensorXf
        >>> from gva_mi.splat.camera import look_at
        >>> numbers = ([[0.0, 0, 0]], [[1.0, 0, 0, 0]], [[0.2, 0.2, 0.2]], [0.8], [[1.0, 0.5, 0]])
        >>> tensors = [TensorXf(np.float32(x)) for x in numbers]
        >>> dr.enable_grad(tensors[3])
        >>> camera = Camera(16.0, 16.0, 4.0, 4.0, look_at((0, 0, 2), (0, 0, 0)), 8, 8)
        >>> image = render(Gaussians(*tensors), camera)
        >>> dr.backward(dr.sum(image.alpha, axis=None))
        >>> image.color.shape, bool(dr.grad(tensors[3])[0] > 1)  # more than one pixel shows it
        ((8, 8, 3), True)
    """
    arrays = gaussians.arrays()
    kind = type(gaussians.means)
    on_llvm = dr.is_tensor_v(kind) and dr.backend_v(kind) is dr.JitBackend.LLVM
    for name, tensor in arrays.items():
        if type(tensor) is not kind or not dr.is_float_v(tensor) or not on_llvm:
            found = f"means {kind.__module__}.{kind.__name__}, {name} {type(tensor).__name__}"
            raise ValueError(
                "render(): inputs must be of one kind, float tensors of drjit.llvm or "
                f"drjit.llvm.ad, got {found}"
            )
    gaussians.check_shapes()
    D = gaussians.channels
    if background is None:
        background = dr.zeros(kind, shape=(D,))
    elif type(background) is not kind or tuple(background.shape) != (D,):
        raise ValueError(f"render(): background must be a {kind.__name__} of shape ({D},)")
    for name, matrix in camera.tensors._asdict().items():
        if matrix is not None and type(matrix) is not kind:
            found = f"{kind.__name__}, got {type(matrix).__name__}"
            raise ValueError(f"render(): the camera's {name} must be a {found}")
    shape = (camera.height, camera.width)
    fits = lambda limit: type(limit) is kind and tuple(limit.shape) == shape
    if depth_limit is not None and not fits(depth_limit):
        raise ValueError(f"render(): depth_limit must be a {kind.__name__} of shape {shape}")
    limit = None if depth_limit is None else dr.detach(depth_limit)
    constants = lambda: (gaussians.sh is not None, camera, options, limit)
    parts = arrays | {"colors": arrays.get("sh", gaussians.colors)}
    try:
        images = dr.custom(_Render, *map(parts.get, NAMES), background, *camera.tensors, constants)
    except RuntimeError as error:  # dr.custom wraps what the checks within raise
        if isinstance(error.__cause__, ValueError):
            raise error.__cause__ from None
        raise
    return Image(*images)


def _numpy(tensor: Array) -> np.ndarray:
    return dr.detach(tensor).numpy().astype(np.float64)


class _Render(dr.CustomOp):
    """The three passes of passes.py as an operation of Dr.Jit's autodiff."""

    def eval(
        self,
        means: Array,
        quats: Array | None,
        scales: Array | None,
        covars: Array | None,
        opacities: Array,
        colors: Array,
        background: Array,
        T_camera_world: Array,
        K: Array,
        constants: Callable[[], tuple[bool, Camera, SplatOptions, Array]],
    ) -> tuple[Array, ...]:
        harmonics, camera, options, limit = constants()
        parts = zip(NAMES, (means, quats, scales, covars, opacities, colors), strict=True)
        parts = {name: part for name, part in parts if part is not None}
        self.kind, self.shapes = type(means), {k: part.shape for k, part in parts.items()}
        given = CameraTensors(T_camera_world, K)._asdict()
        self.matrices = [name for name, matrix in given.items() if matrix is not None]
        flat = {k: dr.detach(part.array, preserve_type=False) for k, part in parts.items()}
        inputs = Inputs.of_named(flat)
        self.layout = Layout(camera.width, camera.height)
        limit = None if limit is None else self._plane(limit)
        behind = background.numpy().tolist()
        self.saved = render_forward(inputs, harmonics, camera, options, behind, limit=limit)
        return self._images(self.saved.planes)

    @exclusive
    def backward(self) -> None:
        color, alpha, *depth = self.grad_out()
        grad = Planes(
            self._plane(color, self.saved.plan.channels),
            self._plane(alpha),
            self._plane(depth[0]) if depth else None,
        )
        gradients = render_adjoint(self.saved, grad, RequestedGradients(camera=bool(self.matrices)))
        for name, flat in gradients.named():
            shape = self.shapes[name]
            lane = dr.arange(dr.uint32_array_t(flat), math.prod(shape))
            numbers = dr.gather(type(flat), flat, lane)
            self.set_grad_in(name, self.kind(dr.array_t(self.kind)(numbers), shape=shape))
        self.set_grad_in("background", self.kind(gradients.background))
        for name in self.matrices:
            self.set_grad_in(name, self.kind(getattr(gradients, name)))

    @exclusive
    def forward(self) -> None:
        flat = {k: dr.detach(self.grad_in(k).array, preserve_type=False) for k in self.shapes}
        matrices = {"T_camera_world": np.zeros((4, 4)), "K": np.zeros((3, 3))}
        matrices |= {name: _numpy(self.grad_in(name)) for name in self.matrices}
        tangents = Inputs.of_named(flat)
        dr.make_opaque(tangents)
        planes = render_tangent(
            self.saved, tangents, *matrices.values(), _numpy(self.grad_in("background")).tolist()
        )
        self.set_grad_out(self._images(planes))

    def _images(self, planes: Planes) -> tuple[Array, ...]:
        images = [self._image(planes.color, self.saved.plan.channels), self._image(planes.alpha)]
        return tuple(images) if planes.depth is None else (*images, self._image(planes.depth))

    def _image(self, plane: Array, channels: int = 0) -> Array:
        """Convert a plane to an image without padding; 0 channels leave out that axis."""
        layout = self.layout
        pixels = dr.gather(type(plane), plane, self._inside(channels or 1))
        shape = (layout.height, layout.width) + ((channels,) if channels else ())
        return self.kind(dr.array_t(self.kind)(pixels), shape=shape)

    def _plane(self, image: Array, channels: int = 1) -> Array:
        """Convert an image to a plane, padded with zeros."""
        height, width = self.layout.padded
        plane = dr.zeros(dr.detached_t(dr.array_t(self.kind)), height * width * channels)
        dr.scatter(plane, dr.detach(image.array, preserve_type=False), self._inside(channels))
        dr.make_opaque(plane)
        return plane

    def _inside(self, channels: int) -> Array:
        """Indices in a plane of all numbers of the picture."""
        layout = self.layout
        row = layout.width * channels
        k = dr.arange(dr.uint32_array_t(dr.detached_t(dr.array_t(self.kind))), layout.height * row)
        return k // row * (layout.padded[1] * channels) + k % row
