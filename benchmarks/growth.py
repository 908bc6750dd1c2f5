"""Time the renderer on larger scenes and pictures, and with more threads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import drjit as dr

from benchmarks.splat import Work, person
from benchmarks.timing import Table, timed
from gva_mi.splat.kernels import tiles
from gva_mi.splat.scene import Scene

GAUSSIAN_COUNTS = (1_000, 10_000, 100_000, 1_000_000, 3_000_000)
PICTURE_WIDTHS = (128, 256, 512, 1024, 2048, 4096)  # px, a side of square pictures
THREAD_SCENES = ((20_000, 512), (100_000, 512), (1_000_000, 1024))  # Gaussians, and px of a side


def run(repeats: int) -> Iterator[Table]:
    """Yield both tables, of fewer calls than others have, because each takes long."""
    yield larger_scenes(max(2, repeats // 5))
    yield more_threads(max(2, repeats // 2))


def larger_scenes(repeats: int) -> Table:
    """Measure time, forward and backward, and memory as the scene grows.

    A pair is a Gaussian and a tile of pixels that it reaches.
    """
    scenes = [("more Gaussians", lambda n=n: person(n, 512)) for n in GAUSSIAN_COUNTS]
    scenes += [("more pixels", lambda w=w: person(20_000, w)) for w in PICTURE_WIDTHS]
    scenes.append(("full HD", lambda: _wide(person(1_000_000, 1080), 1920)))
    rows = []
    for name, make in scenes:
        work = Work.on(make())
        both = timed(work.both, repeats).minimum
        dr.flush_malloc_cache()
        dr.detail.malloc_clear_statistics()
        work.both()
        memory = dr.detail.malloc_watermark(dr.JitBackend.LLVM) / 2**20
        c, count, pairs = work.scene.camera, len(work.scene.gaussians), _pairs(work)
        row = {"growth": name, "Gaussians": count, "pixels": f"{c.width}x{c.height}"}
        row |= {"pairs": pairs, "min ms": both, "ns a pair": 1e6 * both / max(1, pairs)}
        row["ns a Gaussian"] = 1e6 * both / count
        rows.append(row | {"Dr.Jit's MiB": round(memory)})
    return Table("growth", rows)


def _pairs(work: Work) -> int:
    """Return how many pairs of a Gaussian and a tile a picture has."""
    make, counts = tiles.make_lists, []

    def counted(*args: object, **kwargs: object) -> tiles.Lists:
        lists = make(*args, **kwargs)
        counts.append(int(dr.sum(lists.counts)[0]))
        return lists

    try:
        tiles.make_lists = counted
        work.forward()
    finally:
        tiles.make_lists = make
    return counts[0]


def more_threads(repeats: int) -> Table:
    """Time forward and backward with 1, 2, 4 ... threads, up to as many as there are."""
    most = dr.thread_count()
    counts = [*(n for n in (2**k for k in range(16)) if n < most), most]
    rows = []
    try:
        for n, size in THREAD_SCENES:
            work, found = Work.on(person(n, size)), []
            for threads in counts:
                dr.set_thread_count(threads)
                found.append(timed(work.both, repeats).minimum)
            row = {"Gaussians": n, "pixels": f"{size}x{size}", "1 thread, min ms": found[0]}
            ratios = zip(counts[1:], found[1:], strict=True)
            rows.append(row | {f"{threads} threads": found[0] / x for threads, x in ratios})
    finally:
        dr.set_thread_count(most)
    return Table("threads: forward and backward, times as fast", rows)


def _wide(scene: Scene, width: int) -> Scene:
    """Return the same view on a wider picture."""
    return replace(scene, camera=replace(scene.camera, width=width, cx=width / 2))
