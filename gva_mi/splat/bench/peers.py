"""Other people's renderers on the CPU, beside ours: who draws the same picture, and how fast.

A peer is timed where its picture is ours, to :data:`SAME` dB; else what it shows is told and its
time is not. Peers and ours take turns, so that the machine's other work falls on all.

The bounds are what this machine allows our kernels at best: their operations and their bytes
(stages.py) over the limits that machine.py measures.
"""

from __future__ import annotations

import io
import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from gva_mi.errors import InputError
from gva_mi.files import replacing
from gva_mi.splat.bench import gsplat_peer, opensplat_peer
from gva_mi.splat.bench.machine import Limits
from gva_mi.splat.bench.stages import measure_stages
from gva_mi.splat.bench.timing import Timing, Work, seconds
from gva_mi.splat.scene import Scene
from gva_mi.splat.torch_op import render

PeerName = Literal["gsplat", "opensplat"]
Drawing = Callable[[], Tensor]  # draws the colour (H, W, D) of one scene
Peer = Callable[[Scene], Drawing]

COUNTS = (1_000, 3_000, 10_000, 30_000, 100_000)
SAME = 40.0  # dB
OURS = "gva_mi"


@dataclass(frozen=True)
class Beside:
    """One peer on one scene, forward and backward; no times where its picture is another one."""

    peer: str
    gaussians: int
    psnr: float  # dB, of its picture beside ours
    gradients: dict[str, float]  # |theirs - ours| / |ours|, by input
    time: Timing | None
    ours: Timing | None
    ratio_least: float | None  # of the least times: theirs / ours
    ratio: float | None  # of the medians of each call's time and its neighbour's

    def row(self) -> str:
        """A line of the table."""
        name, worst = max(self.gradients.items(), key=lambda item: item[1])
        head = f"{self.peer:10}{self.gaussians:10,} {self.psnr:8.1f}  {worst:8.1e} {name:10}"
        if self.time is None:
            return f"{head} another picture, below {SAME:.0f} dB: not timed"
        return f"{head} {self.time} {self.ours} {self.ratio_least:8.1f} {self.ratio:8.1f}"


@dataclass(frozen=True)
class Bounds:
    """The least time that this machine's limits allow our kernels, forward and backward."""

    gaussians: int
    operations: float  # ms, of the compositing
    memory: float  # ms, of all stages


@dataclass(frozen=True)
class Comparison:
    """All peers on all scenes."""

    found: tuple[Beside, ...]
    bounds: tuple[Bounds, ...]

    @staticmethod
    def of(scenes: Sequence[tuple[list[Beside], Bounds]]) -> Comparison:
        """From what :func:`measure_peers` found."""
        found = tuple(row for rows, _ in scenes for row in rows)
        return Comparison(found, tuple(bounds for _, bounds in scenes))

    def table(self) -> str:
        """For a person to read."""
        head = f"{'peers':10}{'Gaussians':>10} {'PSNR dB':>8}  {'gradients differ':19}"
        times = "theirs: least, median    ours: least, median"
        ratios = "ratio: least, median"
        rows = [found.row() for found in self.found]
        bounds = [
            f"{b.gaussians:20,}  multiply-adds {b.operations:.2f}, memory {b.memory:.2f}"
            for b in self.bounds
        ]
        lines = [f"{head} {times} {ratios}", *rows, "bounds of this machine for ours, ms:", *bounds]
        return "\n".join(lines)

    def draw(self, path: Path) -> None:
        """Time against the number of Gaussians, each peer a line, and the machine's bounds."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 5), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        for name, points in self.lines().items():
            axes.loglog(*zip(*points, strict=True), "o-", label=name)
        counts = [b.gaussians for b in self.bounds]
        axes.loglog(counts, [b.operations for b in self.bounds], "k--", label="multiply-adds")
        axes.loglog(counts, [b.memory for b in self.bounds], "k:", label="memory")
        axes.set_xlabel("Gaussians")
        axes.set_ylabel("forward and backward, least of the calls, ms")
        axes.set_title("dashed, dotted: this machine's limits for gva_mi", fontsize=10)
        axes.grid(which="both", alpha=0.2)
        figure.legend(loc="outside lower center", ncols=5, fontsize=9)
        whole = io.BytesIO()  # Matplotlib's writers stumble over a disk that fills up
        figure.savefig(whole, dpi=150, format=path.suffix[1:])
        with replacing(path) as unfinished:
            unfinished.write_bytes(whole.getbuffer())

    def lines(self) -> dict[str, list[tuple[int, float]]]:
        """(Gaussians, ms) of each that was timed, ours first."""
        timed = [b for b in self.found if b.time is not None]
        ours: dict[int, float] = {}
        for b in timed:
            ours[b.gaussians] = min(b.ours.least, ours.get(b.gaussians, math.inf))
        lines = {OURS: sorted(ours.items())} if ours else {}
        for b in timed:
            lines.setdefault(b.peer, []).append((b.gaussians, b.time.least))
        return lines


def load(names: Sequence[PeerName], opensplat_sources: Path | None) -> dict[str, Peer]:
    """The peers by name.

    Raises:
        InputError: one is not there.
    """
    found: dict[str, Peer] = {}
    for name in names:
        if name == "opensplat":
            found[name] = opensplat_peer.load(opensplat_sources)
        elif gsplat_peer.installed():
            found[name] = gsplat_peer.drawing
        else:
            raise InputError(
                "bench: --against gsplat needs the package gsplat, which is not installed: "
                "pip install gsplat (its CUDA kernels are not used)"
            )
    return found


def can_draw(scene: Scene) -> bool:
    """Whether peers take such a scene."""
    return scene.gaussians.sh is not None and scene.camera.model == "pinhole"


def measure_peers(
    peers: dict[str, Peer], scenes: Sequence[Callable[[], Scene]], repeats: int, limits: Limits
) -> Iterator[tuple[list[Beside], Bounds]]:
    """Each scene with all peers.

    Args:
        peers: by name.
        scenes: makers of scenes with spherical harmonics and a pinhole camera.
        repeats: calls of each.
        limits: of this machine.
    """
    for make in scenes:
        scene = make()
        work = Work.on(scene)
        found = [beside(name, peer, work, repeats) for name, peer in peers.items()]
        stages = list(measure_stages(work, 2, limits))
        operations = sum(s.time.least * (s.share_flops or 0) for s in stages)
        memory = sum(s.time.least * s.share_bytes for s in stages)
        yield found, Bounds(len(scene.gaussians), operations, memory)


def beside(name: str, peer: Peer, work: Work, repeats: int) -> Beside:
    """One peer on one scene: its picture and gradients beside ours and, if it is ours, its time."""
    options = replace(work.scene.options, depth=False)  # peers draw colour and alpha
    scene = replace(work.scene, options=options)
    theirs, inputs = peer(scene), scene.gaussians.arrays()

    def ours() -> Tensor:
        return render(scene.gaussians, scene.camera, scene.options, scene.background).color

    def step(draw: Drawing) -> tuple[Tensor, dict[str, Tensor]]:
        color = draw()
        grads = torch.autograd.grad(color, list(inputs.values()), work.weights)
        return color.detach(), dict(zip(inputs, grads, strict=True))

    (picture, grads), (expected, truth) = step(theirs), step(ours)
    error = float((picture.double() - expected.double()).square().mean())
    psnr = -10 * math.log10(max(error, 1e-20))
    gradients = {k: float((grads[k] - v).norm() / v.norm()) for k, v in truth.items()}
    if not psnr >= SAME:
        return Beside(name, len(scene.gaussians), psnr, gradients, None, None, None, None)
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats):
        for taken, draw in zip(times, (theirs, ours), strict=True):
            taken.append(seconds(lambda draw=draw: step(draw)))
    time, our_time = map(Timing.of, times)
    ratio = statistics.median(a / b for a, b in zip(*times, strict=True))
    least = time.least / our_time.least
    return Beside(name, len(scene.gaussians), psnr, gradients, time, our_time, least, ratio)
