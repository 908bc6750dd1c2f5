"""Wide colours in chunks: D channels composited a few at a time, by one kernel for all of them.

The compositing kernels hold every pixel's channels in registers and are compiled for their number.
Beyond ``CHUNK`` channels the same lists are walked once per chunk, the last one filled up with
zeros: time and compile time grow with D, and not faster. The geometry's moments (blend.py, eq. 6)
are linear in the loss's gradient, so those of the chunks add up.
"""

from __future__ import annotations

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.kernels import packets
from gva_mi.splat.kernels.frozen import Frozen
from gva_mi.splat.kernels.pixels import Planes

CHUNK = 8  # channels composited at a time


def widths(channels: int, whole: bool = False) -> list[int]:
    """Channels of each chunk, padding included; ``whole`` makes one of all, however many."""
    if whole or channels <= CHUNK:
        return [channels]
    return [CHUNK] * -(-channels // CHUNK)


def rows_of(
    columns: list[Array], geometry: int, parts: list[int], depth: bool
) -> list[list[Array]]:
    """Columns of the rows to composite: each chunk's geometry and channels, the first's depth."""
    shape, features, z = columns[:geometry], columns[geometry:-1], columns[-1]
    rows, first = [], 0
    for width in parts:
        part = features[first : first + width]
        rows.append([*shape, *part, *([z * 0] * (width - len(part)))])
        first += width
    if depth:
        rows[0].append(z)
    return rows


def of_background(background: list[Array], parts: list[int]) -> list[list[Array]]:
    """The background's channels, chunk by chunk."""
    F = type(background[0])
    padded = background + [dr.opaque(F, 0) for _ in range(sum(parts) - len(background))]
    return [padded[sum(parts[:i]) : sum(parts[: i + 1])] for i in range(len(parts))]


@Frozen
def join(parts: list[Array], alpha: Array, whole: Array, *, channels: int) -> Array:
    """One plane of ``channels`` from the chunks' planes."""
    pixel = dr.arange(dr.uint32_array_t(type(alpha)), dr.width(alpha))
    for c in range(channels):
        value = dr.gather(type(alpha), parts[c // CHUNK], pixel * CHUNK + c % CHUNK)
        dr.scatter(whole, value, pixel * channels + c, mode=dr.ReduceMode.NoConflicts)
    dr.eval(whole)
    return whole


@Frozen
def split(whole: Array, alpha: Array, parts: list[Array], *, channels: int) -> list[Array]:
    """The reverse of :func:`join`; ``alpha`` tells the number of pixels."""
    pixel = dr.arange(dr.uint32_array_t(type(alpha)), dr.width(alpha))
    for c in range(CHUNK * len(parts)):
        value = alpha * 0
        if c < channels:
            value = dr.gather(type(whole), whole, pixel * channels + c)
        part = parts[c // CHUNK]
        dr.scatter(part, value, pixel * CHUNK + c % CHUNK, mode=dr.ReduceMode.NoConflicts)
    dr.eval(parts)
    return parts


def join_planes(parts: list[Planes], channels: int) -> Planes:
    """The picture from those of its chunks."""
    if len(parts) == 1:
        return parts[0]
    alpha = parts[0].alpha
    whole = packets.memory(type(alpha), dr.width(alpha) * channels)
    color = join([part.color for part in parts], alpha, whole, channels=channels)
    return Planes(color, alpha, parts[0].depth)


def split_gradient(grad: Planes, channels: int, parts: int) -> list[Planes]:
    """The gradient of the picture, chunk by chunk; alpha's and depth's go with the first."""
    if parts == 1:
        return [grad]
    F, size = type(grad.alpha), dr.width(grad.alpha)
    memory = [packets.memory(F, size * CHUNK) for _ in range(parts)]
    colors = split(grad.color, grad.alpha, memory, channels=channels)
    nothing = dr.opaque(F, 0, size)
    rest = [Planes(color, nothing, None) for color in colors[1:]]
    return [Planes(colors[0], grad.alpha, grad.depth), *rest]


def add_moments(parts: list[list[Array]], shared: int, channels: int, depth: bool) -> list[Array]:
    """One list from the chunks' sums: ``shared`` moments, D features and, if any, the depth."""
    if len(parts) == 1:
        return parts[0]
    moments = [sum((part[k] for part in parts[1:]), parts[0][k]) for k in range(shared)]
    features = [c for part in parts for c in part[shared : shared + CHUNK]]
    return [*moments, *features[:channels], *(parts[0][shared + CHUNK :] if depth else ())]
