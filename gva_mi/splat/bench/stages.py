"""Each step of passes.py: its time, and its shares of what the machine can do.

The work of a stage is counted, not sampled:

* operations of the two compositing kernels, in the code that LLVM is given: additions,
  multiplications and divisions in the body of the loop over a tile's list, a multiply-add being
  two, times the turns that the lanes took;
* bytes of a stage: every array it must read or write, once.

A share is the work per second over the machine's measured limit (machine.py).
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from types import ModuleType

import drjit as dr

from gva_mi.splat.bench.machine import Limits
from gva_mi.splat.bench.timing import Timing, Work, pairs_of, walked_of
from gva_mi.splat.kernels import composite, passes, tiles
from gva_mi.splat.kernels.blend import UNROLL, UNROLL_ADJOINT
from gva_mi.splat.kernels.records import Footprint, Format, Slot, Splat

STAGES: dict[str, tuple[ModuleType, str]] = {  # a stage's name, and the function that is it
    "project": (passes, "_project"),
    "tile lists": (tiles, "make_lists"),
    "composite": (composite, "blend"),
    "composite, adjoint": (composite, "blend_adjoint"),
    "sum and project, adjoint": (passes, "_gaussians_adjoint"),
}
COUNTED = {  # whose operations are counted, and the Gaussians that a turn of its loop meets
    "composite": UNROLL,
    "composite, adjoint": UNROLL_ADJOINT,
}


@dataclass(frozen=True)
class StageCost:
    """One step of passes.py."""

    name: str
    time: Timing
    gflops: float | None  # 1e9 operations per second; None where they are not counted
    gigabytes: float  # 1e9 bytes per second, of the least that must move
    share_flops: float | None  # of the machine's limit
    share_bytes: float


def measure_stages(work: Work, repeats: int, limits: Limits) -> Iterator[StageCost]:
    """Every stage of ``repeats`` forward and backward passes."""
    counted: dict[str, int] = {}
    with _around_stages(_count(counted)), dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        work.both()
    dr.kernel_history_clear()
    times: dict[str, list[float]] = {name: [] for name in STAGES}
    with _around_stages(_clock(times)):
        for _ in range(repeats + 2):  # two that compile and allocate
            work.both()
    walked = walked_of(work.saved())
    for name, moved in _bytes(work).items():
        timing = Timing.of(times[name][2:])
        rate = 1e-6 / timing.least  # 1e9 per second, for each of the work's units
        flops = walked / COUNTED[name] * counted[name] * rate if name in COUNTED else None
        share = None if flops is None else flops / limits.gflops
        yield StageCost(name, timing, flops, moved * rate, share, moved * rate / limits.gigabytes)


def _clock(times: dict[str, list[float]]) -> Callable[[str, Callable[[], object]], object]:
    """Appends the seconds of every call of a stage."""

    def call(name: str, stage: Callable[[], object]) -> object:
        dr.sync_thread()
        start = time.perf_counter()
        result = stage()
        dr.sync_thread()
        times[name].append(time.perf_counter() - start)
        return result

    return call


def _count(counted: dict[str, int]) -> Callable[[str, Callable[[], object]], object]:
    """Notes the operations of a stage's heaviest kernel, from the history of kernels."""

    def call(name: str, stage: Callable[[], object]) -> object:
        dr.kernel_history_clear()
        result = stage()
        if name in COUNTED:
            kernels = dr.kernel_history((dr.KernelType.JIT,))
            counted[name] = max(operations(kernel["ir"].getvalue()) for kernel in kernels)
        return result

    return call


@contextmanager
def _around_stages(call: Callable[[str, Callable[[], object]], object]) -> Iterator[None]:
    """While the context lasts, every stage runs inside ``call(name, stage)``."""
    originals = {name: getattr(module, function) for name, (module, function) in STAGES.items()}

    def wrapped(name: str) -> Callable[..., object]:
        return lambda *args, **kwargs: call(name, partial(originals[name], *args, **kwargs))

    try:
        for name, (module, function) in STAGES.items():
            setattr(module, function, wrapped(name))
        yield
    finally:
        for name, (module, function) in STAGES.items():
            setattr(module, function, originals[name])


def operations(code: str) -> int:
    """Operations per lane and turn of the longest loop of a kernel, in LLVM's language."""
    most = 0
    for body in re.findall(r"^l_\d+_body:\n(.*?)^\w+:\n", code, re.MULTILINE | re.DOTALL):
        single = len(re.findall(r"= f(?:add|sub|mul|div) ", body))
        most = max(most, single + 2 * len(re.findall(r"= call .*@llvm\.fma\.", body)))
    return most


def _bytes(work: Work) -> dict[str, int]:
    """What every stage has to move, in float32."""
    scene, saved = work.scene, work.saved()
    n, D = len(scene.gaussians), len(scene.background)
    pairs, walked = pairs_of(saved), walked_of(saved)
    pixels = math.prod(saved.layout.padded)
    inputs = sum(v.numel() for v in scene.gaussians.arrays().values())
    row, slot = Splat.columns(Format(D, depth=True)), Slot.columns(Format(D, depth=False))
    footprint, picture, trail = Footprint.columns(), D + 2, 2
    numbers = {
        "project": inputs + n * (row + footprint + 4),
        # a pair is two numbers, emitted, sorted by tile and read back by it
        "tile lists": n * (footprint + 4) + 8 * pairs,
        "composite": walked * (row + 1) + pixels * (picture + trail),
        "composite, adjoint": walked * (row + 1) + pairs * slot + pixels * (picture + trail),
        "sum and project, adjoint": pairs * (slot + 1) + 2 * inputs,
    }
    return {name: 4 * count for name, count in numbers.items()}
