"""How fast the renderer is: per stage, against the machine's limits, and as the scene grows.

Times are wall clock, the least and the median of repeated calls; on a shared machine trust ratios
of figures of one run. The work of a stage is counted, not sampled:

* operations of the two compositing kernels: additions and multiplications per pixel of every
  (tile, Gaussian) pair they walk, a multiply-add being two, transcendental functions none;
* bytes of a stage: every array it must read or write, once.

A share is the work per second over the machine's measured limit (machine.py).
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from types import ModuleType

import drjit as dr
import numpy as np
import torch
from drjit.llvm import Float
from torch import Tensor

from gva_mi.splat import gsplat_peer, machine, pipeline, tiles
from gva_mi.splat.blend import PIXELS
from gva_mi.splat.pipeline import Saved
from gva_mi.splat.project import GEOMETRY, MOMENTS, Inputs
from gva_mi.splat.scene import Scene, person_scene
from gva_mi.splat.torch_op import render

STAGES: dict[str, tuple[ModuleType, str]] = {  # a stage's name, and the function that is it
    "project": (pipeline, "_project"),
    "tile lists": (tiles, "make_lists"),
    "composite": (pipeline, "blend"),
    "composite, adjoint": (pipeline, "blend_adjoint"),
    "sum and project, adjoint": (pipeline, "_gaussians_adjoint"),
}
FORWARD_OPS, FORWARD_OPS_FEATURE = 18, 2  # per pixel of a pair, and for every feature of it
ADJOINT_OPS, ADJOINT_OPS_FEATURE = 29, 4


@dataclass(frozen=True)
class BenchOptions:
    """What to measure, and how often."""

    repeats: int = 20  # calls per figure
    calls: int = 200  # of the loop with moving poses
    most_gaussians: int = 1_000_000  # where the growth in N ends, from 1,000 in steps of 10
    most_pixels: int = 2048  # where the growth in the picture's width ends, from 128 by doubling
    no_gsplat: bool = False  # leave gsplat's torch reference out where it is installed
    seed: int = 0  # of the scenes


@dataclass(frozen=True)
class Timing:
    """Of repeated calls."""

    least: float  # ms
    median: float  # ms


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline."""

    name: str
    time: Timing
    gflops: float | None  # 1e9 operations per second; None where they are not counted
    gigabytes: float  # 1e9 bytes per second, of the least that must move
    share_flops: float | None  # of the machine's limit
    share_bytes: float


@dataclass(frozen=True)
class Growth:
    """One size of scene."""

    gaussians: int
    pixels: int  # width and height
    pairs: int
    forward: Timing
    both: Timing
    memory: int  # bytes, most that Dr.Jit held


@dataclass(frozen=True)
class Moving:
    """The same scene with another camera pose at every call."""

    fixed: Timing
    moving: Timing
    ratio: float  # of the medians
    memory_before: int  # bytes of the process
    memory_after: int


@dataclass(frozen=True)
class Bench:
    """All figures of one run."""

    limits: machine.Limits
    gaussians: int
    width: int
    height: int
    pairs: int
    walked: int  # pairs that the compositing reached before its pixels were opaque
    forward: Timing
    both: Timing  # forward and backward, through torch
    pairs_per_second: float  # pixels of walked pairs, forward
    stages: tuple[Stage, ...]
    moving: Moving
    growth: tuple[Growth, ...]
    gsplat: Timing | None  # its torch reference on the CPU, forward and backward
    gsplat_ratio: float | None

    def to_dict(self) -> dict:
        """For JSON."""
        return asdict(self)

    def table(self) -> str:
        """For a person to read."""
        ms = lambda t: f"{t.least:9.2f} {t.median:9.2f}"
        head = f"{self.gaussians:,} Gaussians, {self.width}x{self.height}, {self.pairs:,} pairs"
        limits = f"{self.limits.gflops:.0f} GFLOP/s, {self.limits.gigabytes:.1f} GB/s"
        lines = [f"{head}; this machine's limits: {limits}, {self.limits.threads} threads", ""]
        lines.append(f"{'':26}{'least':>9} {'median':>9} ms   of FMA  of memory")
        for s in self.stages:
            flops = "      –" if s.share_flops is None else f"{s.share_flops:7.0%}"
            lines.append(f"{s.name:26}{ms(s.time)}   {flops}   {s.share_bytes:8.0%}")
        lines.append(f"{'forward':26}{ms(self.forward)}")
        lines.append(f"{'forward and backward':26}{ms(self.both)}")
        rate = f"{self.pairs_per_second / 1e9:.2f}e9 pixels of pairs composited per second"
        lines += ["", f"{rate}; {self.walked:,} pairs walked"]
        m, mib = self.moving, 1 / 2**20
        memory = f"{m.memory_before * mib:.0f} -> {m.memory_after * mib:.0f} MiB"
        lines.append(f"a new pose at every call: {m.ratio:.2f} x the fixed one's time, {memory}")
        if self.gsplat is not None:
            lines.append(f"gsplat's torch reference: {self.gsplat_ratio:.0f} x our time")
        lines += ["", "Gaussians  pixels       pairs   forward      both ms   memory MiB"]
        for g in self.growth:
            size = f"{g.gaussians:9,}  {g.pixels:6} {g.pairs:11,}"
            times = f"{g.forward.least:9.2f} {g.both.least:9.2f}"
            lines.append(f"{size} {times}    {g.memory * mib:10.0f}")
        return "\n".join(lines)


def bench(
    scene: Scene | None = None,
    options: BenchOptions | None = None,
    progress: Callable[..., None] | None = None,
) -> Bench:
    """Measure the renderer on ``scene``, or on a person of 20,000 Gaussians at 512 px."""
    options = options or BenchOptions()
    person = lambda n, size: person_scene(np.random.default_rng(options.seed), n, size)
    scene = (person(20_000, 512) if scene is None else scene).to(torch.float32)
    sizes = _sizes(options)
    steps = iter(range(1, len(sizes) + 5))
    tell = lambda: progress and progress(next(steps), len(sizes) + 4)

    limits = machine.measure()
    tell()
    forward, both = _time_whole(scene, options.repeats)
    saved = _saved(scene)
    stages = tuple(_stages(scene, saved, options.repeats, limits))
    tell()
    moving = _moving(scene, options.calls)
    tell()
    peer = None if options.no_gsplat else gsplat_peer.time_step(scene, max(1, options.repeats // 5))
    gsplat = None if peer is None else _timing(peer)
    tell()
    growth = []
    for n, size in sizes:
        growth.append(_grown(person(n, size), max(2, options.repeats // 5)))
        tell()
    walked = _walked(saved)
    composite = next(stage for stage in stages if stage.name == "composite").time.least
    return Bench(
        limits=limits,
        gaussians=len(scene.gaussians),
        width=scene.camera.width,
        height=scene.camera.height,
        pairs=_pairs(saved),
        walked=walked,
        forward=forward,
        both=both,
        pairs_per_second=walked * PIXELS / composite * 1e3,
        stages=stages,
        moving=moving,
        growth=tuple(growth),
        gsplat=gsplat,
        gsplat_ratio=None if gsplat is None else gsplat.least / both.least,
    )


def _sizes(options: BenchOptions) -> list[tuple[int, int]]:
    """(Gaussians, pixels): first N grows, then the picture."""
    counts = [n for n in (1_000, 10_000, 100_000, 1_000_000) if n <= options.most_gaussians]
    widths = [w for w in (128, 256, 512, 1024, 2048) if w <= options.most_pixels]
    few = min(20_000, options.most_gaussians)
    middle = min(512, options.most_pixels)
    return [(n, middle) for n in counts] + [(few, w) for w in widths]


def _step(scene: Scene, weights: Tensor) -> None:
    """One forward and backward; the image's gradient is given, so no loss is timed."""
    image = render(scene.gaussians, scene.camera, scene.options, scene.background)
    torch.autograd.grad(image.color, list(scene.inputs().values()), weights)


def _weights(scene: Scene) -> Tensor:
    size = (scene.camera.height, scene.camera.width, len(scene.background))
    return torch.randn(size, generator=torch.Generator().manual_seed(0))


def _time_whole(scene: Scene, repeats: int) -> tuple[Timing, Timing]:
    weights = _weights(scene)

    def forward() -> None:
        with torch.no_grad():
            render(scene.gaussians, scene.camera, scene.options, scene.background)

    return _time(forward, repeats), _time(lambda: _step(scene, weights), repeats)


def _time(run: Callable[[], None], repeats: int) -> Timing:
    """After two calls that compile and allocate."""
    run(), run()
    return _timing([_seconds(run) for _ in range(repeats)])


def _seconds(run: Callable[[], None]) -> float:
    start = time.perf_counter()
    run()
    dr.sync_thread()
    return time.perf_counter() - start


def _timing(seconds: list[float]) -> Timing:
    return Timing(1e3 * min(seconds), 1e3 * statistics.median(seconds))


@contextmanager
def _stopwatches() -> Iterator[dict[str, list[float]]]:
    """Seconds of every call of a stage, by name, while the context lasts."""
    seconds: dict[str, list[float]] = {name: [] for name in STAGES}
    originals = {name: getattr(module, function) for name, (module, function) in STAGES.items()}

    def watched(name: str) -> Callable:
        def call(*args: object, **kwargs: object) -> object:
            dr.sync_thread()
            start = time.perf_counter()
            result = originals[name](*args, **kwargs)
            dr.sync_thread()
            seconds[name].append(time.perf_counter() - start)
            return result

        return call

    try:
        for name, (module, function) in STAGES.items():
            setattr(module, function, watched(name))
        yield seconds
    finally:
        for name, (module, function) in STAGES.items():
            setattr(module, function, originals[name])


def _stages(scene: Scene, saved: Saved, repeats: int, limits: machine.Limits) -> Iterator[Stage]:
    weights = _weights(scene)
    with _stopwatches() as seconds:
        for _ in range(repeats + 2):
            _step(scene, weights)
    for name, work in _work(scene, saved).items():
        timing = _timing(seconds[name][2:])
        rate = 1e-6 / timing.least  # 1e9 per second, for each of the work's units
        flops = None if work.operations is None else work.operations * rate
        share = None if flops is None else flops / limits.gflops
        yield Stage(
            name, timing, flops, work.bytes * rate, share, work.bytes * rate / limits.gigabytes
        )


@dataclass(frozen=True)
class _Work:
    operations: int | None
    bytes: int


def _work(scene: Scene, saved: Saved) -> dict[str, _Work]:
    """What every stage has to do, in float32."""
    n, D = len(scene.gaussians), len(scene.background)
    pairs, walked = _pairs(saved), _walked(saved)
    pixels = math.prod(saved.layout.padded)
    inputs = sum(v.numel() for v in scene.gaussians.arrays().values())
    row, slot, picture = GEOMETRY + D + 1, MOMENTS + D, pixels * (D + 2)
    projected = n * (row + tiles.FOOTPRINT + 4)
    forward = walked * PIXELS * (FORWARD_OPS + FORWARD_OPS_FEATURE * (D + 1))
    adjoint = walked * PIXELS * (ADJOINT_OPS + ADJOINT_OPS_FEATURE * D)
    return {
        "project": _Work(None, 4 * (inputs + projected)),
        # a pair is two numbers, emitted, sorted by tile and read back by it
        "tile lists": _Work(None, 4 * (n * (tiles.FOOTPRINT + 4) + 8 * pairs)),
        "composite": _Work(forward, 4 * (walked * (row + 1) + picture)),
        "composite, adjoint": _Work(adjoint, 4 * (walked * (row + 1) + pairs * slot + 2 * picture)),
        "sum and project, adjoint": _Work(None, 4 * (pairs * (slot + 1) + 2 * inputs)),
    }


def _saved(scene: Scene) -> Saved:
    arrays = [Float(v.detach().contiguous().view(-1)) for v in scene.gaussians.arrays().values()]
    harmonics = scene.gaussians.sh is not None
    behind = scene.background.tolist()
    return pipeline.render_forward(Inputs(*arrays), harmonics, scene.camera, scene.options, behind)


def _pairs(saved: Saved) -> int:
    return 0 if saved.lists is None else int(saved.lists.counts.numpy().sum(dtype=np.int64))


def _walked(saved: Saved) -> int:
    if saved.lists is None:
        return 0
    real = saved.lists.real.numpy()
    steps = saved.stop.numpy().astype(np.int64) - saved.lists.start.numpy()
    return int(np.maximum(steps[real], 0).sum())


def _moving(scene: Scene, calls: int) -> Moving:
    """The two are measured alternately, so that the machine's other work falls on both."""
    weights = _weights(scene)
    poses = [_turned(scene, 0.3 * math.sin(0.7 * k)) for k in range(calls)]
    for pose in poses[:10]:
        _step(pose, weights)
    before, fixed, moving = machine.resident(), [], []
    for pose in poses:
        fixed.append(_seconds(lambda: _step(scene, weights)))
        moving.append(_seconds(lambda pose=pose: _step(pose, weights)))
    times = _timing(fixed), _timing(moving)
    ratio = times[1].median / times[0].median
    return Moving(*times, ratio, before, machine.resident())


def _turned(scene: Scene, angle: float) -> Scene:
    """Seen from another side: the camera turned about the Gaussians' middle."""
    c, s = math.cos(angle), math.sin(angle)
    middle = scene.gaussians.means.detach().double().mean(dim=0).numpy()
    T_turned_world = np.eye(4)
    T_turned_world[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    T_turned_world[:3, 3] = middle - T_turned_world[:3, :3] @ middle
    T = scene.camera.T_camera_world @ T_turned_world
    return replace(scene, camera=replace(scene.camera, T_camera_world=T))


def _grown(scene: Scene, repeats: int) -> Growth:
    scene = scene.to(torch.float32)
    forward, both = _time_whole(scene, repeats)
    dr.flush_malloc_cache()
    dr.detail.malloc_clear_statistics()
    _step(scene, _weights(scene))
    memory = dr.detail.malloc_watermark(dr.JitBackend.LLVM)
    pairs = _pairs(_saved(scene))
    return Growth(len(scene.gaussians), scene.camera.width, pairs, forward, both, memory)
