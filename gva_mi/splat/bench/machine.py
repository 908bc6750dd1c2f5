"""What this machine can do at most: multiply-adds and memory traffic, measured with two kernels."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
from drjit.llvm import Float, UInt

CHAINS = 12  # independent sums per lane: enough to hide the latency of a multiply-add
UNROLL = 4
BUFFER = 1 << 24  # floats of a memory buffer, 64 MiB: no cache holds it


@dataclass(frozen=True)
class Limits:
    """The limits that a kernel's share is measured against."""

    gflops: float  # 1e9 multiplications and additions per second, float32, all threads
    gigabytes: float  # 1e9 bytes per second, read and written
    threads: int  # of Dr.Jit


def measure(repeats: int = 30) -> Limits:
    """The best of ``repeats`` runs; takes about a second.

    Note:
        Other processes on the machine lower the figures, as they lower those of the kernels: take
        both in one run.
    """
    lanes, turns = 1 << 12, 4000
    flops = 2 * CHAINS * UNROLL * turns * lanes
    seconds = min(_timed(lambda: _multiply_add(lanes, turns)) for _ in range(repeats))
    source = dr.full(Float, 1, BUFFER)
    dr.make_opaque(source)

    def copy() -> None:
        dr.eval(source + 1)

    moved = min(_timed(copy) for _ in range(repeats))
    return Limits(flops / seconds / 1e9, 8 * BUFFER / moved / 1e9, dr.thread_count())


def resident() -> int:
    """Bytes of memory this process holds now; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def forget_peak() -> None:
    """Start :func:`peak` anew."""
    try:
        with open("/proc/self/clear_refs", "w") as file:
            file.write("5")
    except OSError:
        pass  # then the peak is that of the whole process so far


def peak() -> int:
    """Most bytes that this process held since :func:`forget_peak`; 0 if the system is silent."""
    try:
        with open("/proc/self/status") as file:
            kilobytes = [line.split()[1] for line in file if line.startswith("VmHWM:")]
    except OSError:
        return 0
    return 1024 * int(kilobytes[0]) if kilobytes else 0


def _multiply_add(lanes: int, turns: int) -> None:
    a, b = dr.opaque(Float, 0.5), dr.opaque(Float, 1.0)
    lane = Float(dr.arange(UInt, lanes))

    def body(k: UInt, *sums: Float) -> tuple[UInt | Float, ...]:
        for _ in range(UNROLL):
            sums = [dr.fma(x, a, b) for x in sums]
        return (k + 1, *sums)

    state = (dr.zeros(UInt, lanes), *(lane + i for i in range(CHAINS)))
    last = dr.opaque(UInt, turns)
    _, *sums = dr.while_loop(state, lambda k, *_: k < last, body, mode="symbolic", compress=False)
    dr.eval(sum(sums))


def _timed(run: Callable[[], None]) -> float:
    dr.sync_thread()
    start = time.perf_counter()
    run()
    dr.sync_thread()
    return time.perf_counter() - start
