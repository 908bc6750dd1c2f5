"""Time the renderer: stages, a camera that moves, entry points, and gsplat's torch reference.

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
from gva_mi.splat.kernels import passes, tiles
from gva_mi.splat.scene import Scene, person_scene

STAGES = {  # a stage's name, and the function that is it
    "project": (passes, "project_gaussians"),
    "tile lists": (tiles, "make_lists"),
    "composite": (passes, "blend"),
    "composite, adjoint": (passes, "blend_adjoint"),
    "places of the pairs": (tiles.Lists, "places"),
    "sum and project, adjoint": (passes, "gaussians_adjoint"),
}


def run(
    repeats: int, path: Path | None = None, gaussians: int = 20_000, size: int = 512
) -> Iterator[Table]:
    """Yield all tables.

    Args:
        repeats: calls per figure.
        path: file of another scene to use instead.
        gaussians, size: of the person, and of the picture in pixels.
    """
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


def person(gaussians: int, size: int) -> Scene:
    """Return the synthetic person in a square picture of ``size`` pixels."""
    return person_scene(np.random.default_rng(0), gaussians, size)


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
        """Draw the picture and compute its gradient with respect to every input."""
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
