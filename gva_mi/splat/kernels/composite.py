"""A picture of ellipses and lists, and the way back to them: blend.py, chunk by chunk.

passes.py comes here with what project.py and tiles.py make, gsplat_pixels.py with what a caller
hands over.
"""

from __future__ import annotations

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat.kernels import chunks
from gva_mi.splat.kernels.blend import Limit, blend, blend_adjoint, sum_slots
from gva_mi.splat.kernels.frozen import Frozen
from gva_mi.splat.kernels.packets import Packets
from gva_mi.splat.kernels.planes import Planes, Trail
from gva_mi.splat.kernels.records import Format
from gva_mi.splat.kernels.tiles import Grid, Lists, capacity
from gva_mi.splat.options import SplatOptions


def composite(
    splats: list[Packets],
    lists: Lists,
    grid: Grid,
    background: list[Array],
    limit: Limit | None,
    pixels: int,
    formats: tuple[Format, ...],
    options: SplatOptions,
) -> tuple[Planes, Trail, Array]:
    """The picture, the trail, and where in ``lists.ids`` each lane stopped.

    Planes hold the picture's pixels first; there may be more memory behind them.

    Args:
        splats: chunk by chunk, of ``formats``.
        background: D arrays of size one.
        pixels: of the picture, padded to whole tiles.
        lists, grid, limit, options: as ``blend`` takes them.
    """
    pictures, size = [], capacity(pixels)  # of a video's boxes hardly two are of one size
    parts = zip(splats, chunks.split_background(background, formats), formats, strict=True)
    for part, colors, format in parts:
        picture, trail, stop = blend(
            part, lists, grid, colors, limit, pixels=size, format=format, options=options
        )
        pictures.append(picture)
    return chunks.join_planes(pictures, len(background)), trail, stop


def composite_adjoint(
    splats: list[Packets],
    lists: Lists,
    grid: Grid,
    background: list[Array],
    trail: Trail,
    stop: Array,
    grad: Planes,
    formats: tuple[Format, ...],
    options: SplatOptions,
    absolute: bool,
    moments: bool = True,
    features: bool = True,
) -> tuple[list[Packets], tuple[Format, ...], list[float]]:
    """Each chunk's slots, their formats, and the gradient by the background.

    Args:
        trail, stop: what :func:`composite` returned for the other arguments.
        grad: dL/dplanes, padded to whole tiles with zeros; alpha and depth may be None.
        absolute: whether slots hold the absolute sums too.
        moments: whether they hold the moments, of which all gradients but the colours' are made.
        features: whether they hold the gradients of the colour's channels.
    """
    slots, slot_formats, sums = [], [], []
    pictures = chunks.split_gradient(grad, len(background), len(formats))
    backgrounds = chunks.split_background(background, formats)
    for part, by_picture, behind, format in zip(
        splats, pictures, backgrounds, formats, strict=True
    ):
        channels, depth = format.channels if features else 0, by_picture.depth is not None
        slot_formats.append(Format(channels, depth and moments, absolute, moments))
        memory, shares = blend_adjoint(
            part,
            lists,
            stop,
            grid,
            behind,
            trail,
            by_picture,
            pairs=dr.width(lists.ids),
            lanes=dr.width(lists.tile),
            format=format,
            slot_format=slot_formats[-1],
            options=options,
        )
        slots.append(memory)
        sums.append(sum_rows(shares, format.channels))
    return slots, tuple(slot_formats), np.concatenate(sums)[: len(background)].tolist()


@Frozen
def sums_of_slots(
    lists: Lists, slots: list[Packets], *, formats: tuple[Format, ...], channels: int
) -> list[Array]:
    """The columns of a ``Slot`` of all channels, (N,) each: every Gaussian's slots added up."""
    parts = [sum_slots(lists, part, format) for part, format in zip(slots, formats, strict=True)]
    found = chunks.add_slots(parts, channels).pack()
    dr.eval(found)
    return found


def sum_rows(flat: Array, width: int) -> np.ndarray:
    """Sums of the columns of a flat array of rows, on the host.

    numpy adds in one thread, in float64: the same bits for any number of threads.
    """
    return flat.numpy().reshape(-1, width).sum(axis=0, dtype=np.float64)
