"""Assign lists of different length to SIMD lanes and threads.

A packet works until its longest list ends. Therefore lists of similar length share a packet.
Packets are dealt round-robin over the blocks that threads work on, or one thread would get all long
lists. The result of a list does not depend on its lane.
"""

from __future__ import annotations

import drjit as dr
from drjit import ArrayBase as Array

SIMD = 16  # lanes of a packet with AVX-512; AVX2's 8 lanes divide it
BLOCKS = 16  # packets are dealt over so many parts
LONGEST = 8191  # lists are ordered by length up to this one


def lists_by_length(length: Array, lanes: int) -> Array:
    """Return the list of each lane, given their lengths; their number for lanes without one."""
    U, lists = type(length), dr.width(length)
    order = dr.detail.block_mkperm(LONGEST - dr.minimum(length, LONGEST), lists, LONGEST + 1)
    lane = dr.arange(U, lanes)
    # arrays: another size needs no other kernel
    stride, count = dr.opaque(U, lanes // (BLOCKS * SIMD)), dr.opaque(U, lists)
    packet = lane // SIMD
    rank = ((packet % stride) * BLOCKS + packet // stride) * SIMD + lane % SIMD
    return dr.select(rank < count, dr.gather(U, order, rank, active=rank < count), count)
