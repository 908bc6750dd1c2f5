"""Wide colours in chunks: D channels are composited a few at a time, by one kernel for all chunks.

The compositing kernels hold every pixel's channels in registers and are compiled for their number.
Beyond ``CHUNK`` channels the same lists are composited once per chunk, the last one padded with
zeros: time grows linearly with D. The first chunk also has the depth. The moments of eq. 16 are
linear in the loss's gradient, so those of the chunks add up.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.jit.frozen import Frozen
from gva_mi.splat.kernels.records import PairGradient, RecordFormat, Splat
from gva_mi.splat.kernels.tile_memory import Planes

CHUNK = 8  # channels composited at a time: chosen, a packet of floats


def formats(channels: int, depth: bool, whole: bool = False) -> tuple[RecordFormat, ...]:
    """Return the format of each chunk's splats, padding included.

    Args:
        channels: D.
        depth: whether the depth is composited too.
        whole: make one chunk of all channels.
    """
    if whole or channels <= CHUNK:
        return (RecordFormat(channels, depth),)
    return tuple(RecordFormat(CHUNK, depth and k == 0) for k in range(-(-channels // CHUNK)))


def split_splat(splat: Splat, formats: tuple[RecordFormat, ...]) -> list[Splat]:
    """Split a splat: the same ellipse in every chunk, some of the channels each."""
    out, first = [], 0
    for format in formats:
        color = splat.color[first : first + format.channels]
        color = [*color, *([splat.depth * 0] * (format.channels - len(color)))]
        out.append(replace(splat, color=color, depth=splat.depth if format.depth else None))
        first += format.channels
    return out


def split_background(
    background: list[Array], formats: tuple[RecordFormat, ...]
) -> list[list[Array]]:
    """Split the background's channels into chunks."""
    F, total = type(background[0]), sum(format.channels for format in formats)
    rest = background + [dr.opaque(F, 0) for _ in range(total - len(background))]
    out = []
    for format in formats:
        out.append(rest[: format.channels])
        rest = rest[format.channels :]
    return out


@Frozen
def join(parts: list[Array], alpha: Array, whole: Array, *, channels: int) -> Array:
    """Join the planes of the chunks to one of ``channels``."""
    pixel = dr.arange(dr.uint32_array_t(type(alpha)), dr.width(alpha))
    for c in range(channels):
        value = dr.gather(type(alpha), parts[c // CHUNK], pixel * CHUNK + c % CHUNK)
        dr.scatter(whole, value, pixel * channels + c, mode=dr.ReduceMode.NoConflicts)
    dr.eval(whole)
    return whole


@Frozen
def split(whole: Array, zeros: Array, parts: list[Array], *, channels: int) -> list[Array]:
    """Reverse of :func:`join`; ``zeros`` has a zero for each pixel."""
    pixel = dr.arange(dr.uint32_array_t(type(zeros)), dr.width(zeros))
    for c in range(CHUNK * len(parts)):
        value = zeros * 1
        if c < channels:
            value = dr.gather(type(whole), whole, pixel * channels + c)
        part = parts[c // CHUNK]
        dr.scatter(part, value, pixel * CHUNK + c % CHUNK, mode=dr.ReduceMode.NoConflicts)
    dr.eval(parts)
    return parts


def join_planes(parts: list[Planes], channels: int) -> Planes:
    """Join the pictures of the chunks."""
    if len(parts) == 1:
        return parts[0]
    alpha = parts[0].alpha
    whole = packets.memory(type(alpha), dr.width(alpha) * channels)
    color = join([part.color for part in parts], alpha, whole, channels=channels)
    return Planes(color, alpha, parts[0].depth)


def split_gradient(grad: Planes, channels: int, parts: int) -> list[Planes]:
    """Split the picture's gradient into chunks; the first has alpha's and depth's."""
    if parts == 1:
        return [grad]
    F, size = type(grad.color), dr.width(grad.color) // channels
    memory = [packets.memory(F, size * CHUNK) for _ in range(parts)]
    zeros = dr.opaque(F, 0, size)
    colors = split(grad.color, zeros, memory, channels=channels)
    rest = [Planes(color, None, None) for color in colors[1:]]
    return [Planes(colors[0], grad.alpha, grad.depth), *rest]


def add_slots(parts: list[PairGradient], channels: int) -> PairGradient:
    """Add the slots of the chunks to one of D channels."""
    first = parts[0]
    if len(parts) == 1:
        return first
    color = [channel for part in parts for channel in part.color][:channels]
    rows = zip(*(replace(part, color=[], depth=None).pack() for part in parts), strict=True)
    sums = [sum(row[1:], row[0]) for row in rows]
    format = RecordFormat(0, False, first.absolute is not None, first.m0 is not None)
    return replace(PairGradient.unpack(sums, format), color=color, depth=first.depth)
