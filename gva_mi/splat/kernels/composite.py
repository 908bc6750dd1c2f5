"""Compositing of all chunks of the channels, and its adjoint: blend.py, called once per chunk."""

from __future__ import annotations

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.jit.packets import Packets
from gva_mi.splat.kernels import chunks
from gva_mi.splat.kernels.blend import Limit, blend, blend_adjoint
from gva_mi.splat.kernels.planes import Planes, SavedPixels
from gva_mi.splat.kernels.records import RecordFormat
from gva_mi.splat.kernels.tiles import Grid, Lists, capacity
from gva_mi.splat.options import SplatOptions


def composite(
    splats: list[Packets],
    lists: Lists,
    grid: Grid,
    background: list[Array],
    limit: Limit | None,
    pixels: int,
    formats: tuple[RecordFormat, ...],
    options: SplatOptions,
) -> tuple[Planes, SavedPixels, Array]:
    """Return the picture, its ``SavedPixels``, and where in ``lists.ids`` each lane stopped.

    Planes hold the picture's pixels first; there may be unused memory behind them.

    Args:
        splats: one entry per chunk, of ``formats``.
        background: D arrays of size one.
        pixels: of the picture, padded to whole tiles.
        lists, grid, limit, options: as ``blend`` takes them.
    """
    pictures, size = [], capacity(pixels)  # few sizes for the boxes of a video: few recordings
    parts = zip(splats, chunks.split_background(background, formats), formats, strict=True)
    for part, colors, format in parts:
        picture, saved_pixels, stop = blend(
            part, lists, grid, colors, limit, pixels=size, format=format, options=options
        )
        pictures.append(picture)
    return chunks.join_planes(pictures, len(background)), saved_pixels, stop


def composite_adjoint(
    splats: list[Packets],
    lists: Lists,
    grid: Grid,
    background: list[Array],
    saved_pixels: SavedPixels,
    stop: Array,
    grad: Planes,
    formats: tuple[RecordFormat, ...],
    options: SplatOptions,
    absolute: bool,
    moments: bool = True,
    features: bool = True,
) -> tuple[list[Packets], tuple[RecordFormat, ...], list[float]]:
    """Return the slots of each chunk, their formats, and the gradient by the background.

    Args:
        saved_pixels, stop: what :func:`composite` returned for the other arguments.
        grad: dL/dplanes, padded to whole tiles with zeros; alpha and depth may be None.
        absolute: whether slots hold the absolute sums too.
        moments: whether they hold the moments, which all gradients except the colours' need.
        features: whether they hold the gradients of the colour's channels.
    """
    slots, slot_formats, sums = [], [], []
    pictures = chunks.split_gradient(grad, len(background), len(formats))
    backgrounds = chunks.split_background(background, formats)
    for part, by_picture, behind, format in zip(
        splats, pictures, backgrounds, formats, strict=True
    ):
        channels, depth = format.channels if features else 0, by_picture.depth is not None
        slot_formats.append(RecordFormat(channels, depth and moments, absolute, moments))
        memory, shares = blend_adjoint(
            part,
            lists,
            stop,
            grid,
            behind,
            saved_pixels,
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


def sum_rows(flat: Array, width: int) -> np.ndarray:
    """Add up the rows of a flat array on the host.

    numpy adds in one thread, in float64: the same bits for any number of threads.
    """
    return flat.numpy().reshape(-1, width).sum(axis=0, dtype=np.float64)
