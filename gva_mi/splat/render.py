"""``render`` on Dr.Jit tensors: Gaussians and a camera make a picture, with its adjoint."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.blend import Planes
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.pipeline import render_adjoint, render_forward
from gva_mi.splat.project import Inputs

_DEFAULTS = SplatOptions()


def render(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Array = None,
) -> Image:
    """The picture of ``gaussians`` from ``camera``.

    Args:
        gaussians: Dr.Jit tensors of one kind: ``TensorXf`` or ``TensorXf64`` from ``drjit.llvm`` or
            ``drjit.llvm.ad``. Shapes and units: :class:`Gaussians`. The precision is theirs.
        camera: the view; any size of picture.
        options: cut-offs.
        background: (D,) tensor of the same kind, the colour behind the Gaussians; None is black, as
            in gsplat.

    Returns:
        color (H, W, D), alpha (H, W) and depth (H, W), tensors of the same kind.

    Raises:
        ValueError: for wrong shapes or kinds, NaN or infinite numbers.

    Note:
        The order by depth and the set of pixels a Gaussian reaches are not differentiated.
    """
    arrays = gaussians.arrays()
    kind = type(gaussians.means)
    for name, tensor in arrays.items():
        if not dr.is_tensor_v(tensor) or not dr.is_float_v(tensor) or type(tensor) is not kind:
            found = f"means {kind.__name__}, {name} {type(tensor).__name__}"
            raise ValueError(
                f"render(): inputs must be Dr.Jit float tensors of one kind, got {found}"
            )
    gaussians.check_shapes()
    D = gaussians.channels
    if background is None:
        background = dr.zeros(kind, shape=(D,))
    elif type(background) is not kind or tuple(background.shape) != (D,):
        raise ValueError(f"render(): background must be a {kind.__name__} of shape ({D},)")
    constants = lambda: (gaussians.sh is not None, camera, options)
    return Image(*dr.custom(_Render, *arrays.values(), background, constants))


class _Render(dr.CustomOp):
    """The two halves of pipeline.py, as Dr.Jit's autodiff wants them."""

    NAMES = ("means", "quats", "scales", "opacities", "colors")

    def eval(
        self,
        means: Array,
        quats: Array,
        scales: Array,
        opacities: Array,
        colors: Array,
        background: Array,
        constants: Callable[[], tuple[bool, Camera, SplatOptions]],
    ) -> tuple[Array, Array, Array]:
        harmonics, camera, options = constants()
        parts = (means, quats, scales, opacities, colors)
        self.kind, self.shapes = type(means), [part.shape for part in parts]
        inputs = Inputs(*(dr.detach(part.array, preserve_type=False) for part in parts))
        saved = render_forward(inputs, harmonics, camera, options, background.numpy().tolist())
        self.saved, planes = saved, saved.planes
        return (
            self._image(planes.color, saved.channels),
            self._image(planes.alpha),
            self._image(planes.depth),
        )

    def backward(self) -> None:
        color, alpha, depth = self.grad_out()
        grad = Planes(
            self._plane(color, self.saved.channels), self._plane(alpha), self._plane(depth)
        )
        inputs, _, by_background = render_adjoint(self.saved, grad)
        for name, shape in zip(self.NAMES, self.shapes, strict=True):
            flat = dr.array_t(self.kind)(getattr(inputs, name))
            self.set_grad_in(name, self.kind(flat, shape=shape))
        self.set_grad_in("background", self.kind(by_background))

    def _image(self, plane: Array, channels: int = 0) -> Array:
        """A plane as an image, without its padding; 0 channels: without that axis."""
        layout = self.saved.layout
        pixels = dr.gather(type(plane), plane, self._inside(channels or 1))
        shape = (layout.height, layout.width) + ((channels,) if channels else ())
        return self.kind(dr.array_t(self.kind)(pixels), shape=shape)

    def _plane(self, image: Array, channels: int = 1) -> Array:
        """An image as a plane, padded with zeros."""
        height, width = self.saved.layout.padded
        F = type(self.saved.inputs.means)
        plane = dr.zeros(F, height * width * channels)
        dr.scatter(plane, dr.detach(image.array, preserve_type=False), self._inside(channels))
        dr.make_opaque(plane)
        return plane

    def _inside(self, channels: int) -> Array:
        """Index in a plane of every number of the picture."""
        layout = self.saved.layout
        row = layout.width * channels
        k = dr.arange(dr.uint32_array_t(type(self.saved.inputs.means)), layout.height * row)
        return k // row * (layout.padded[1] * channels) + k % row
