"""State of a tile's pixels on the way forward, in memory of the lane, and the loop over its parts.

A tile's state is 32 pixels of 2 + D numbers, far more than there are registers. As variables of the
loop over a tile's list they would be unrolled: 40 KB of code, whose variables move between
registers and stack at every turn. In local memory (``dr.alloc_local``) a second loop works on
``PART`` pixels at a time. Its code is an eighth of that, and its pixels fit into registers.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.kernels.pixel import PIXELS, PLACES, Pixel, larger
from gva_mi.splat.kernels.tiles import WIDTH

PART = 4  # neighbouring pixels of a row
PARTS = PIXELS // PART
PER_ROW = WIDTH // PART

Memory = list[dr.Local]  # a tile's numbers: of the PART pixels of each part, field by field
Place = tuple[Array, list[Array]]  # the row of some pixels in the tile, their places in the row


def store_pixels(pixels: list[list[Array]]) -> Memory:
    """Copy the fields of a tile's pixels to local memory."""
    memory = []
    for place in range(PART):
        for field in zip(*pixels[place::PART], strict=True):
            local = dr.alloc_local(type(field[0]), PARTS, field[0])
            for part, number in enumerate(field):
                local[part] = number
            memory.append(local)
    return memory


def load_pixels(memory: Memory, part: Array | int) -> list[list[Array]]:
    """Return the fields of each pixel of a part."""
    fields = len(memory) // PART
    numbers = [local[part] for local in memory]
    return [numbers[i * fields : (i + 1) * fields] for i in range(PART)]


def for_each_part(
    step: Callable[[Place, list[Pixel], list[Array]], list[Pixel]],
    memory: Memory,
    limits: Memory,
    F: type,
) -> tuple[Memory, Memory, Array]:
    """Replace the pixels of each part by ``step(place, pixels, limits)``.

    Returns:
        ``memory``, ``limits``, and the greatest transmittance of a pixel.
    """
    U = dr.uint32_array_t(F)

    def body(part: Array, greatest: Array, memory: Memory, limits: Memory) -> tuple:
        row = part // PER_ROW
        left = F(part - row * PER_ROW) * PART
        pixels = [Pixel(T, end, y) for T, end, *y in load_pixels(memory, part)]
        within = [number for (number,) in load_pixels(limits, part)] if limits else []
        pixels = step((F(row), [left + e for e in PLACES[:PART]]), pixels, within)
        numbers = [number for p in pixels for number in (p.T, p.end, *p.y)]
        for local, number in zip(memory, numbers, strict=True):
            local[part] = number
        for pixel in pixels:
            greatest = larger(greatest, pixel.T)
        return part + 1, greatest, memory, limits

    state = (U(0), F(-1), memory, limits)
    last = dr.while_loop(state, lambda part, *_: part < PARTS, body, mode="symbolic")
    return last[2], last[3], last[1]
