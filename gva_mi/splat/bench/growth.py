"""How time and memory grow: with the Gaussians, with the picture, and in scenes made to be hard.

A *share* compares a scene's time per pair (tile, Gaussian) with that of a plain scene: 1 where the
time grows as the pairs do, 2 at a cliff.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import drjit as dr
import numpy as np
import torch

from gva_mi.splat.bench import machine
from gva_mi.splat.bench.timing import Timing, Work, pairs_of, repeated
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.scene import Scene, person_scene

COUNTS = (1_000, 10_000, 100_000, 1_000_000)
WIDTHS = (128, 256, 512, 1024, 2048)  # px, of square pictures


@dataclass(frozen=True)
class Growth:
    """Time and memory at one size of scene."""

    name: str
    gaussians: int
    width: int  # px
    height: int
    pairs: int
    forward: Timing
    both: Timing
    memory: int  # bytes, most that Dr.Jit held
    process: int  # bytes, most that the process held, the interpreter and all libraries included
    share: float | None = None  # time per pair, over that of the scene it is compared with

    def beside(self, plain: Growth) -> Growth:
        """The same with its share."""
        per_pair = [g.both.least / max(1, g.pairs) for g in (self, plain)]
        return replace(self, share=per_pair[0] / per_pair[1])


def growing(most_gaussians: int, most_pixels: int) -> Iterator[tuple[int, int]]:
    """(Gaussians, width of the picture): first the Gaussians grow, then the picture."""
    middle, few = min(512, most_pixels), min(20_000, most_gaussians)
    yield from ((n, middle) for n in COUNTS if n <= most_gaussians)
    yield from ((few, width) for width in WIDTHS if width <= most_pixels)


def hard_scenes(
    most_gaussians: int, most_pixels: int, seed: int
) -> Iterator[tuple[Callable[[], Scene], Callable[[], Scene]]]:
    """Scenes that break renderers, each with the plain one it is compared with."""
    n = lambda count: min(count, most_gaussians)
    size = min(512, most_pixels)
    width, height = min(1920, most_pixels), min(1080, most_pixels)
    person = lambda count, size: person_scene(np.random.default_rng(seed), count, size)
    plain = lambda: person(n(20_000), size)
    yield lambda: _with_a_huge_one(plain()), plain
    yield lambda: _large(n(2_000), size, seed), plain
    wide = lambda count: _widened(person(count, height), width)
    yield lambda: wide(n(1_000_000)), lambda: wide(n(100_000))


HARD = ("one covers all", "all large", "full HD")


def measure_growth(name: str, scene: Scene, repeats: int) -> Growth:
    """Time and memory of one scene."""
    work = Work.on(scene)
    forward, both = repeated(work.forward, repeats), repeated(work.both, repeats)
    dr.flush_malloc_cache()
    dr.detail.malloc_clear_statistics()
    machine.forget_peak()
    work.both()
    memory, process = dr.detail.malloc_watermark(dr.JitBackend.LLVM), machine.peak()
    pairs, camera = pairs_of(work.saved()), scene.camera
    size = camera.width, camera.height
    return Growth(name, len(scene.gaussians), *size, pairs, forward, both, memory, process)


def _with_a_huge_one(scene: Scene) -> Scene:
    """The scene with a translucent Gaussian of 3 m before all others, which touches every tile."""
    g, camera = scene.gaussians, scene.camera
    ahead = camera.position + 1.0 * camera.T_camera_world[2, :3]
    huge = {
        "means": torch.from_numpy(ahead),
        "quats": torch.tensor([1.0, 0.0, 0.0, 0.0]),
        "scales": torch.full((3,), 3.0),
        "opacities": torch.tensor(0.3),
    }
    arrays = {
        k: torch.cat([v, huge[k].to(v)[None] if k in huge else v[:1]])
        for k, v in g.arrays().items()
    }
    return replace(scene, gaussians=Gaussians(**arrays))


def _large(count: int, size: int, seed: int) -> Scene:
    """Translucent Gaussians, each over a good part of the picture: long lists everywhere."""
    scene = person_scene(np.random.default_rng(seed), count, size)
    generator = torch.Generator().manual_seed(seed)
    uniform = lambda low, high, *shape: (
        low + (high - low) * torch.rand(*shape, generator=generator, dtype=torch.float64)
    )
    large = {"scales": uniform(0.2, 0.5, count, 3), "opacities": uniform(0.01, 0.05, count)}
    return scene.with_inputs(scene.inputs() | large)


def _widened(scene: Scene, width: int) -> Scene:
    """The same view in a wider picture."""
    c = scene.camera
    camera = Camera(c.fx, c.fy, width / 2, c.cy, c.T_camera_world, width, c.height, c.model)
    return replace(scene, camera=camera)
