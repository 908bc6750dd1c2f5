"""Time the renderer: stages, a camera that moves, entry points, larger scenes, threads, gsplat.

Without ``--scene`` it draws a person of 20,000 Gaussians at 512 px with harmonics of degree 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import drjit as dr
import numpy as np
import torch
from torch import Tensor

from benchmarks import gsplat_reference
from benchmarks.timing import WARM_UP, Clock, Table, by_turns, timed
from gva_mi.splat import rasterization, render
from gva_mi.splat.kernels import composite, passes, tiles
from gva_mi.splat.scene import Scene, person_scene

STAGES = {  # a stage's name, and the function that is it
    "project": (passes, "project_gaussians"),
    "tile lists": (tiles, "make_lists"),
    "composite": (composite, "blend"),
    "composite, adjoint": (composite, "blend_adjoint"),
    "places of the pairs": (tiles.Lists, "places"),
    "sum and project, adjoint": (passes, "gaussians_adjoint"),
}
COUNTS = (1_000, 10_000, 100_000, 1_000_000, 3_000_000)
WIDTHS = (128, 256, 512, 1024, 2048, 4096)  # px, of square pictures
SHARED = ((20_000, 512), (100_000, 512), (1_000_000, 1024))  # Gaussians and px, for more threads


def run(
    repeats: int,
    seed: int,
    path: Path | None = None,
    growth: bool = True,
    gaussians: int = 20_000,
    size: int = 512,
) -> Iterator[Table]:
    """Yield all tables.

    Args:
        repeats: calls per figure.
        seed: seed of the random scene.
        path: file of another scene to use instead.
        growth: whether to measure larger scenes.
        gaussians, size: of the person, and of the picture in pixels.
    """
    person = lambda n, size: person_scene(np.random.default_rng(seed), n, size)
    work = Work.on(person(gaussians, size) if path is None else Scene.load(path))
    g, camera = work.scene.gaussians, work.scene.camera
    size_of = f"{len(g):,} Gaussians, {camera.width} x {camera.height} px"
    clock = Clock()
    with _timed_stages(clock):
        for _ in range(WARM_UP + repeats):
            work.both()
    table = clock.table(f"renderer, {size_of}, {dr.thread_count()} threads", WARM_UP)
    for name, call in (("forward", work.forward), ("forward and backward", work.both)):
        table.rows.append({"": name} | timed(call, repeats).columns)
    yield table
    moving = iter(range(10**9))
    poses = lambda: _turned(work, 0.3 * math.sin(0.7 * next(moving))).both()
    yield by_turns("camera", {"fixed": work.both, "another pose each call": poses}, repeats)
    yield by_turns("entry points, no depth", _entry_points(work), repeats)
    if gsplat_reference.installed() and g.sh is not None and camera.model == "pinhole":
        yield gsplat_reference.compare(work.scene, max(2, repeats // 5))
    if growth:
        yield _growth(person, max(2, repeats // 5))
        yield more_threads(person, max(2, repeats // 2))


@dataclass(frozen=True)
class Work:
    """A scene in float32, and its picture's gradient, so that no loss is timed."""

    scene: Scene
    weights: Tensor  # (H, W, D)

    @staticmethod
    def on(scene: Scene) -> Work:
        """Convert ``scene`` to float32, with random weights."""
        scene = scene.to(torch.float32)
        size = (scene.camera.height, scene.camera.width, len(scene.background))
        return Work(scene, torch.randn(size, generator=torch.Generator().manual_seed(0)))

    def forward(self) -> None:
        """Draw the picture."""
        s = self.scene
        with torch.no_grad():
            render(s.gaussians, s.camera, s.options, s.background)

    def both(self) -> None:
        """Draw the picture and its gradient by every input."""
        s = self.scene
        image = render(s.gaussians, s.camera, s.options, s.background)
        torch.autograd.grad(image.color, list(s.inputs().values()), self.weights)


@contextmanager
def _timed_stages(clock: Clock) -> Iterator[None]:
    """Time every stage of a pass within this context."""
    originals = {name: getattr(*place) for name, place in STAGES.items()}

    def wrapped(name: str) -> Callable[..., object]:
        def stage(*args: object, **kwargs: object) -> object:
            dr.sync_thread()
            with clock(name):
                return originals[name](*args, **kwargs)

        return stage

    try:
        for name, place in STAGES.items():
            setattr(*place, wrapped(name))
        yield
    finally:
        for name, place in STAGES.items():
            setattr(*place, originals[name])


def _turned(work: Work, angle: float) -> Work:
    """Return the scene with its camera turned about the Gaussians' middle."""
    c, s, camera = math.cos(angle), math.sin(angle), work.scene.camera
    middle = work.scene.gaussians.means.detach().double().mean(dim=0).numpy()
    T = np.eye(4)
    T[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    T[:3, 3] = middle - T[:3, :3] @ middle
    camera = replace(camera, T_camera_world=camera.T_camera_world @ T)
    return Work(replace(work.scene, camera=camera), work.weights)


def _entry_points(work: Work) -> dict[str, Callable[[], None]]:
    """Time ``render``, and ``rasterization`` called as by a densifier, keeping ``means2d.grad``."""
    scene = replace(work.scene, options=replace(work.scene.options, depth=False))
    g, camera, dtype = scene.gaussians, scene.camera, scene.gaussians.means.dtype
    matrices = [torch.tensor(m, dtype=dtype)[None] for m in (camera.T_camera_world, camera.K)]
    colors, degree = (g.colors, None) if g.sh is None else (g.sh, math.isqrt(g.sh.shape[1]) - 1)

    def rasterized(packed: bool) -> None:
        pictures, _, meta = rasterization(
            g.means, g.quats, g.scales, g.opacities, colors, *matrices, camera.width,
            camera.height, sh_degree=degree, packed=packed, backgrounds=scene.background[None],
            camera_model=camera.model,
        )  # fmt: skip
        meta["means2d"].retain_grad()
        leaves = [*g.arrays().values(), scene.background]
        torch.autograd.grad(pictures, leaves, work.weights[None])

    return {
        "render": Work(scene, work.weights).both,
        "rasterization, packed=False": lambda: rasterized(False),
        "rasterization, packed": lambda: rasterized(True),
    }


def _growth(person: Callable[[int, int], Scene], repeats: int) -> Table:
    """Measure time and memory as the scene grows.

    A pair is a Gaussian and a tile of pixels that it reaches.
    """
    scenes = [("more Gaussians", lambda n=n: person(n, 512)) for n in COUNTS]
    scenes += [("more pixels", lambda w=w: person(20_000, w)) for w in WIDTHS]
    scenes.append(("full HD", lambda: _wide(person(1_000_000, 1080), 1920)))
    rows = []
    for name, make in scenes:
        work = Work.on(make())
        forward, both = timed(work.forward, repeats), timed(work.both, repeats)
        dr.flush_malloc_cache()
        dr.detail.malloc_clear_statistics()
        work.both()
        memory = dr.detail.malloc_watermark(dr.JitBackend.LLVM) / 2**20
        c, count, pairs = work.scene.camera, len(work.scene.gaussians), _pairs(work)
        row = {"growth": name, "Gaussians": count, "pixels": f"{c.width}x{c.height}"}
        row |= {"pairs": pairs, "forward min ms": forward.minimum, "both min ms": both.minimum}
        row |= {"both ns a pair": 1e6 * both.minimum / max(1, pairs)}
        row |= {"both ns a pixel": 1e6 * both.minimum / (c.width * c.height)}
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


def more_threads(person: Callable[[int, int], Scene], repeats: int) -> Table:
    """Time forward and backward with 1, 2, 4 ... threads, up to as many as there are."""
    most = dr.thread_count()
    counts = [*(n for n in (2**k for k in range(16)) if n < most), most]
    rows = []
    try:
        for n, size in SHARED:
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
