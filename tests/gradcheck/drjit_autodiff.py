"""The picture by Dr.Jit's own autodiff through a plain loop: a second witness for the reference.

No kernel here has a hand-written derivative. Every pixel is one lane and meets every Gaussian in
depth order, and Dr.Jit differentiates the statements and the loop:

    Sigma' = J R Sigma R^T J^T + blur I,   J the derivative of the perspective division
    alpha  = min(alpha_max, o exp(-d^T Sigma'^-1 d / 2));  0 where that is below alpha_min
    T'     = T (1 - alpha);  stop before T' falls to transmittance_min
    color  = sum T alpha c + T background

Note:
    Dr.Jit 1.5.0 has three traps, which silently give a wrong gradient or end the process:
    ``max_iterations`` must be a true bound (-1 is for loops without state between turns); a state
    of the loop must not be Boolean; and an array must be unravelled once, because of two
    unravelled copies only one hands its gradient on.
"""

from __future__ import annotations

import drjit as dr
from drjit import ArrayBase as Array
from drjit.llvm import ad

from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.kernels import sh
from gva_mi.splat.options import SplatOptions

_DEFAULTS = SplatOptions()


def render(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Array = None,
) -> Image:
    """Render Gaussians of ``TensorXf64``, at least one, differentiable by Dr.Jit."""
    kind, F, n = type(gaussians.means), ad.Float64, len(gaussians)
    D = gaussians.channels
    behind = background.array if background is not None else dr.zeros(F, D)
    T, K = camera.tensors
    T = F(camera.T_camera_world.ravel()) if T is None else T.array
    K = F(camera.K.ravel()) if K is None else K.array
    R, t = ad.Matrix3f64(*(_entry(T, k) for k in (0, 1, 2, 4, 5, 6, 8, 9, 10))), _column(T)
    means = dr.unravel(ad.Array3f64, gaussians.means.array)
    x, u, conic, kept = _project(means, gaussians, camera, R, t, K, options)
    features = [*_colors(gaussians, means, -(dr.rcp(R) @ t)), x.z]

    drawn = (x.z > options.near) & (x.z < options.far)
    opacity = dr.select(drawn, gaussians.opacities.array * kept, 0)
    order = ad.UInt(dr.argsort(dr.detach(x.z, preserve_type=False)))
    columns = [*u, *conic, opacity, *features]
    dr.eval(columns, order)

    pixel = dr.arange(ad.UInt, camera.width * camera.height)
    px = F(pixel % camera.width) + 0.5
    py = F(pixel // camera.width) + 0.5

    def body(k: Array, T: Array, alive: Array, *C: Array) -> tuple[Array, ...]:
        i = dr.gather(ad.UInt, order, k)
        u, v, a, b, c, o, *f = (dr.gather(F, column, i) for column in columns)
        dx, dy = px - u, py - v
        free = o * dr.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
        alpha = dr.select(free < options.alpha_max, free, options.alpha_max)
        alpha = dr.select(free >= options.alpha_min, alpha, 0)
        rest = T * (1 - alpha)
        goes_on = (alive > 0) & (rest > options.transmittance_min)
        weight = dr.select(goes_on, T * alpha, 0)
        C = [total + weight * channel for total, channel in zip(C, f, strict=True)]
        return (k + 1, dr.select(goes_on, rest, T), dr.select(goes_on, alive, 0), *C)

    # alive counts 1 or 0: a Boolean state aborts the process in Dr.Jit 1.5.0's reverse loops
    state = (pixel * 0, F(1) + px * 0, pixel * 0 + 1, *(px * 0 for _ in features))
    _, T, _, *C = dr.while_loop(state, lambda k, *_: k < n, body, mode="symbolic", max_iterations=n)
    color = dr.zeros(F, dr.width(pixel) * D)
    for c in range(D):
        value = C[c] + T * dr.gather(F, behind, ad.UInt(c))
        dr.scatter(color, value, pixel * D + c, mode=dr.ReduceMode.NoConflicts)
    size = (camera.height, camera.width)
    return Image(kind(color, shape=(*size, D)), kind(1 - T, shape=size), kind(C[D], shape=size))


def _colors(gaussians: Gaussians, means: Array, position: Array) -> list[Array]:
    """The channels of each Gaussian's colour, seen from a camera's position."""
    harmonics = gaussians.sh is not None
    flat = gaussians.sh.array if harmonics else gaussians.colors.array
    width = dr.width(flat) // len(gaussians)
    rows = dr.arange(ad.UInt, len(gaussians)) * width
    numbers = [dr.gather(ad.Float64, flat, rows + c) for c in range(width)]
    return sh.color(numbers, list(means), list(position)) if harmonics else numbers


def _entry(matrix: Array, k: int) -> Array:
    return dr.gather(ad.Float64, matrix, ad.UInt(k))


def _column(T: Array) -> Array:
    """The translation of a (4, 4) matrix."""
    return ad.Array3f64(_entry(T, 3), _entry(T, 7), _entry(T, 11))


def _project(
    means: Array,
    gaussians: Gaussians,
    camera: Camera,
    R: Array,
    t: Array,
    K: Array,
    options: SplatOptions,
) -> tuple[Array, list[Array], list[Array], Array]:
    """Means in camera space and in the picture, inverse covariances, the share of o that stays."""
    x = R @ means + t
    w, i, j, k = dr.unravel(ad.Array4f64, gaussians.quats.array)
    length = dr.sqrt(w * w + i * i + j * j + k * k)
    whole = length > 0  # a zero quaternion is no rotation
    unit = [dr.select(whole, q / dr.select(whole, length, 1), 0) for q in (i, j, k)]
    w = dr.select(whole, w / dr.select(whole, length, 1), 1)
    rotation = dr.quat_to_matrix(ad.Matrix3f64, ad.Quaternion4f64(*unit, w))
    scales = dr.unravel(ad.Array3f64, gaussians.scales.array)

    f, c = (_entry(K, 0), _entry(K, 4)), (_entry(K, 2), _entry(K, 5))
    p, J = _lens(x, f, c, camera, options)
    A = J @ R @ rotation @ dr.diag(scales)
    C = A @ A.T
    sharp = C[0, 0] * C[1, 1] - C[0, 1] * C[0, 1]
    xx, xy, yy = C[0, 0] + options.blur, C[0, 1], C[1, 1] + options.blur
    det = xx * yy - xy * xy
    ratio = sharp / det
    kept = dr.sqrt(dr.select(ratio > 0, ratio, 0)) if options.antialiased else ad.Float64(1)
    u = [f[axis] * p[axis] + c[axis] for axis in range(2)]
    return x, u, [yy / det, -xy / det, xx / det], kept


def _lens(
    x: Array, f: tuple[Array, Array], c: tuple[Array, Array], camera: Camera, options: SplatOptions
) -> tuple[list[Array], Array]:
    """Where means fall in the picture at focal length one, and J, the derivative of pixels by x."""
    zero = x.z * 0
    if camera.model == "ortho":
        p, rows = [x.x, x.y], [[zero + 1, zero, zero], [zero, zero + 1, zero]]
    elif camera.model == "pinhole":
        z = dr.select(x.z > options.near, x.z, 1)  # what lies before the near plane is not drawn
        p, held = [x.x / z, x.y / z], []
        for axis, size in enumerate((camera.width, camera.height)):
            # gsplat: the derivative follows the mean up to 15 % of the picture beyond its border
            low = (-c[axis] - 0.15 * size) / f[axis]
            high = (size - c[axis] + 0.15 * size) / f[axis]
            held.append(dr.select(p[axis] < low, low, dr.select(p[axis] > high, high, p[axis])))
        rows = [[1 / z, zero, -held[0] / z], [zero, 1 / z, -held[1] / z]]
    else:
        r = dr.sqrt(x.x * x.x + x.y * x.y)
        angle, squared = dr.atan2(r, x.z), r * r + x.z * x.z
        ratio = angle / r
        bend = (x.z / squared - ratio) / (r * r)
        p = [x.x * ratio, x.y * ratio]
        rows = [
            [ratio + x.x * x.x * bend, x.x * x.y * bend, -x.x / squared],
            [x.x * x.y * bend, ratio + x.y * x.y * bend, -x.y / squared],
        ]
    rows = [[f[axis] * entry for entry in row] for axis, row in enumerate(rows)]
    return p, ad.Matrix3f64(*rows, [zero, zero, zero])
