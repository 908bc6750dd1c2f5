"""One run of all measurements, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from gva_mi.errors import InputError
from gva_mi.ranges import Seed, Within, require_ranges
from gva_mi.splat.bench import gsplat_peer, machine, peers
from gva_mi.splat.bench.changes import Compiled, Moving, measure_compiles, measure_moving
from gva_mi.splat.bench.doors import Doors, measure_doors
from gva_mi.splat.bench.environment import Environment, measure_environment
from gva_mi.splat.bench.first_call import FirstCall, measure_first_call
from gva_mi.splat.bench.growth import HARD, Growth, growing, hard_scenes, measure_growth
from gva_mi.splat.bench.partial import Partial, measure_partial
from gva_mi.splat.bench.peers import Beside, Comparison, PeerName
from gva_mi.splat.bench.stages import StageCost, measure_stages
from gva_mi.splat.bench.timing import Timing, Work, pairs_of, repeated, walked_of
from gva_mi.splat.kernels.pixel import PIXELS
from gva_mi.splat.scene import Scene, person_scene

PLOTS = (".png", ".svg", ".pdf")


@dataclass(frozen=True)
class BenchOptions:
    """What to measure, and how often."""

    repeats: Annotated[int, Within(1, 100_000)] = 20  # calls per figure
    calls: Annotated[int, Within(1, 1_000_000)] = 200  # of the loop with moving poses
    # Where the growth in N ends, from 1,000 in steps of 10.
    most_gaussians: Annotated[int, Within(1, 10_000_000)] = 1_000_000
    # Where the growth in the picture's width ends, from 128 by doubling.
    most_pixels: Annotated[int, Within(1, 4096)] = 2048
    no_growth: bool = False  # leave the growth and the hard scenes out
    no_gsplat: bool = False  # leave gsplat's torch reference out where it is installed
    against: tuple[PeerName, ...] = ()  # other renderers to time beside ours
    opensplat_sources: Path | None = None  # folder of OpenSplat's, compiled here
    plot: Path | None = None  # where to draw the peers' times, .png or .svg
    seed: Seed = 0  # of the scenes

    def __post_init__(self) -> None:
        require_ranges("bench", self)
        if self.plot is not None and self.plot.suffix not in PLOTS:
            raise InputError(f"bench: --plot must end in {' or '.join(PLOTS)}, got {self.plot}")
        for name in ("plot", "opensplat_sources"):
            if getattr(self, name) is not None and not self.against:
                raise InputError(f"bench: --{name.replace('_', '-')} is for --against, not given")


@dataclass(frozen=True)
class Bench:
    """All figures of one run."""

    limits: machine.Limits
    gaussians: int
    width: int
    height: int
    pairs: int  # (tile, Gaussian)
    walked: int  # pairs that the compositing reached before its pixels were opaque
    forward: Timing
    both: Timing  # forward and backward, through torch
    pairs_per_second: float  # pixels of walked pairs, forward
    stages: tuple[StageCost, ...]
    compiles: tuple[Compiled, ...]
    moving: Moving
    doors: tuple[Doors, ...]  # of the scene; where growth is measured, of a larger person's, too
    partial: Partial
    environment: Environment
    first_call: FirstCall
    gsplat: Beside | None  # its torch reference on the CPU, on the same scene
    growth: tuple[Growth, ...]
    hard: tuple[Growth, ...]
    peers: Comparison | None  # those that --against names

    def to_dict(self) -> dict:
        """For JSON."""
        return asdict(self)

    def table(self) -> str:
        """All figures as text, for a person to read."""
        head = f"{self.gaussians:,} Gaussians, {self.width}x{self.height}, {self.pairs:,} pairs"
        limits = f"{self.limits.gflops:.0f} GFLOP/s, {self.limits.gigabytes:.1f} GB/s"
        lines = [f"{head}; this machine's limits: {limits}, {self.limits.threads} threads", ""]
        lines.append(f"{'':26}{'least':>9} {'median':>9} ms   of FMA  of memory")
        for s in self.stages:
            flops = "      –" if s.share_flops is None else f"{s.share_flops:7.0%}"
            lines.append(f"{s.name:26}{s.time}   {flops}   {s.share_bytes:8.0%}")
        lines.append(f"{'forward':26}{self.forward}")
        lines.append(f"{'forward and backward':26}{self.both}")
        rate = f"{self.pairs_per_second / 1e9:.2f}e9 pixels of pairs composited per second"
        lines += ["", f"{rate}; {self.walked:,} pairs walked"]
        lines.append("kernels compiled by one forward and backward pass (of those launched):")
        news = [f"{c.scene} {c.new} ({c.launched})" for c in self.compiles]
        lines.append("  " + ", ".join(news))
        m, mib = self.moving, 1 / 2**20
        memory = f"{m.memory_before * mib:.0f} -> {m.memory_after * mib:.0f} MiB"
        lines.append(
            f"a new pose at every call: {m.ratio:.2f} x the fixed one's time; memory over "
            f"{m.calls:,} calls {memory}"
        )
        lines += [doors.line() for doors in self.doors]
        lines += [self.partial.line(), self.environment.line(), self.first_call.line()]
        if self.gsplat is not None and self.gsplat.time is None:
            seen = f"another picture, {self.gsplat.psnr:.1f} dB from ours: not timed"
            lines.append(f"gsplat's torch reference draws {seen}")
        elif self.gsplat is not None:
            peer = f"{self.gsplat.time.least:.0f} ms, {self.gsplat.ratio_least:.0f} x ours"
            lines.append(f"gsplat's torch reference, forward and backward: {peer}")
        if self.peers is not None:
            lines += ["", self.peers.table()]
        for title, grown in (("growth", self.growth), ("hard scenes", self.hard)):
            if not grown:
                continue
            head = f"{title:16}{'Gaussians':>11} {'pixels':>11} {'pairs':>11} {'forward':>9}"
            lines += ["", f"{head} {'both ms':>9} {'MiB':>6} {'process':>8} {'share':>6}"]
            for g in grown:
                size = f"{g.width}x{g.height}"
                line = f"{g.name:16}{g.gaussians:11,} {size:>11} {g.pairs:11,}"
                line += f" {g.forward.least:9.2f} {g.both.least:9.2f} {g.memory * mib:6.0f}"
                share = "" if g.share is None else f"{g.share:6.2f}"
                lines.append(f"{line} {g.process * mib:8.0f} {share}".rstrip())
        if self.hard:
            lines.append("share: time per pair, over that of the plain scene above it")
        return "\n".join(lines)


_DEFAULTS = BenchOptions()
MANY = 100_000  # Gaussians of the larger person


def bench(
    scene: Scene | None = None,
    options: BenchOptions = _DEFAULTS,
    progress: Callable[..., None] | None = None,
) -> Bench:
    """Measure the renderer on ``scene``, or on a person of 20,000 Gaussians at 512 px."""
    person = lambda n, size: person_scene(np.random.default_rng(options.seed), n, size)
    work = Work.on(person(20_000, 512) if scene is None else scene)
    sizes, hard = [], []
    if not options.no_growth:
        most = (options.most_gaussians, options.most_pixels)
        sizes, hard = list(growing(*most)), list(hard_scenes(*most, options.seed))
    others = peers.load(options.against, options.opensplat_sources)
    beside = _scenes_of_peers(scene, options, person) if others else []
    total = 9 + len(sizes) + len(hard) + len(beside)
    steps = iter(range(1, total + 1))
    tell = lambda: progress and progress(next(steps), total)

    limits = machine.measure()
    tell()
    forward = repeated(work.forward, options.repeats)
    both = repeated(work.both, options.repeats)
    stages = tuple(measure_stages(work, options.repeats, limits))
    tell()
    many = min(MANY, options.most_gaussians)
    larger = [] if options.no_growth else [Work.on(person(many, min(512, options.most_pixels)))]
    calls = _calls(work, larger, options, tell)
    few = max(2, options.repeats // 5)  # calls of what takes long
    gsplat = None if options.no_gsplat else _beside_gsplat(work, few)
    tell()
    compared = []
    for found in peers.measure_peers(others, beside, max(2, options.repeats // 2), limits):
        compared.append(found)
        tell()
    growth = []
    for n, size in sizes:
        growth.append(measure_growth("a person", person(n, size), few))
        tell()
    hardest = _beside_plain_ones(hard, few, tell)
    saved = work.saved()
    walked, by_name = walked_of(saved), {stage.name: stage for stage in stages}
    return Bench(
        limits=limits,
        gaussians=len(work.scene.gaussians),
        width=work.scene.camera.width,
        height=work.scene.camera.height,
        pairs=pairs_of(saved),
        walked=walked,
        forward=forward,
        both=both,
        pairs_per_second=walked * PIXELS / by_name["composite"].time.least * 1e3,
        stages=stages,
        **calls,
        gsplat=gsplat,
        growth=tuple(growth),
        hard=hardest,
        peers=Comparison.of(compared) if compared else None,
    )


def _calls(
    work: Work, larger: list[Work], options: BenchOptions, tell: Callable[[], None]
) -> dict[str, Any]:
    """What one way to call costs beside another: fields of :class:`Bench`."""
    repeats, found = options.repeats, {}
    for name, measure in {
        "compiles": lambda: tuple(measure_compiles(work)),
        "moving": lambda: measure_moving(work, options.calls),
        "doors": lambda: tuple(measure_doors(on, repeats) for on in (work, *larger)),
        "partial": lambda: measure_partial(work, repeats),
        "environment": lambda: measure_environment(max(1, repeats // 5), repeats),
        "first_call": lambda: measure_first_call(3),
    }.items():
        found[name] = measure()
        tell()
    return found


def _beside_plain_ones(
    hard: Sequence[tuple[Callable[[], Scene], Callable[[], Scene]]],
    calls: int,
    tell: Callable[[], None],
) -> tuple[Growth, ...]:
    """Each hard scene, after the plain one that it is compared with."""
    found = []
    for name, (make, plain) in zip(HARD, hard, strict=False):
        base = measure_growth(f"{name}: plain", plain(), calls)
        found += [base, measure_growth(name, make(), calls).beside(base)]
        tell()
    return tuple(found)


def _beside_gsplat(work: Work, calls: int) -> Beside | None:
    """gsplat's torch reference on the same scene; None where one of them is not for the other."""
    if not gsplat_peer.installed() or not peers.can_draw(work.scene):
        return None
    return peers.beside("gsplat", gsplat_peer.drawing, work, calls)


def _scenes_of_peers(
    given: Scene | None, options: BenchOptions, person: Callable[[int, int], Scene]
) -> list[Callable[[], Scene]]:
    """The given scene, or people of more and more Gaussians."""
    if given is None:
        counts = [n for n in peers.COUNTS if n <= options.most_gaussians]
        size = min(512, options.most_pixels)
        return [partial(person, n, size) for n in counts or [options.most_gaussians]]
    if not peers.can_draw(given):
        raise InputError(
            "bench: --against needs a scene with spherical harmonics and a pinhole camera: peers "
            "draw no other"
        )
    return [lambda: given]
