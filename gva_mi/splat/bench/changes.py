"""What a change costs: another pose at every call, as in training, and scenes of another size.

The kernels are traced once and replayed (frozen.py), so that a call with another number of
Gaussians, another pose or another picture finds all of its code in this process.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import drjit as dr
import numpy as np

from gva_mi.splat.bench import machine
from gva_mi.splat.bench.timing import Timing, Work, seconds
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.scene import Scene


@dataclass(frozen=True)
class Compiled:
    """The kernels of one forward and backward pass."""

    scene: str  # how it differs from the scene before
    launched: int  # kernels
    new: int  # of them, those whose code this process had not met


def measure_compiles(work: Work) -> Iterator[Compiled]:
    """Render ``work``, then the same again, and then with one thing changed at a time.

    Note:
        A size is new once per process: where it was rendered before, nothing is compiled.
    """
    work.both()
    s, c = work.scene, work.scene.camera
    fewer = Gaussians(**{k: v[: -max(1, len(v) // 7)] for k, v in s.gaussians.arrays().items()})
    T = c.T_camera_world.copy()
    T[:3, 3] += (0.01, -0.02, 0.03)
    pose = Camera.from_matrices(c.K, T, c.width, c.height, c.model)
    smaller = c.resized(max(1, 3 * c.width // 4 - 5), max(1, 2 * c.height // 3 + 3))
    for name, scene in (
        ("the same again", s),
        ("another pose", replace(s, camera=pose)),
        ("fewer Gaussians", replace(s, gaussians=fewer)),
        ("a smaller picture", replace(s, camera=smaller)),
        ("the first again", s),
    ):
        changed = Work.on(scene)
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            changed.both()
        kernels = dr.kernel_history((dr.KernelType.JIT,))
        yield Compiled(name, len(kernels), sum(not kernel["cache_hit"] for kernel in kernels))
    dr.kernel_history_clear()


@dataclass(frozen=True)
class Moving:
    """The same scene with another camera pose at every call."""

    calls: int
    fixed: Timing
    moving: Timing
    ratio: float  # of the medians
    memory_before: int  # bytes of the process
    memory_after: int


def measure_moving(work: Work, calls: int) -> Moving:
    """Measure fixed and moving calls by turns, so that the machine's other work falls on both."""
    pose = lambda k: Work(turned(work.scene, 0.3 * math.sin(0.7 * k)), work.weights)
    for k in range(10):
        pose(k).both()
    before, fixed, moving = machine.resident(), [], []
    for k in range(calls):
        fixed.append(seconds(work.both))
        moving.append(seconds(pose(k).both))
    times = Timing.of(fixed), Timing.of(moving)
    ratio = times[1].median / times[0].median
    return Moving(calls, *times, ratio, before, machine.resident())


def turned(scene: Scene, angle: float) -> Scene:
    """The scene from another side: its camera turned about the Gaussians' middle."""
    c, s = math.cos(angle), math.sin(angle)
    middle = scene.gaussians.means.detach().double().mean(dim=0).numpy()
    T_turned_world = np.eye(4)
    T_turned_world[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    T_turned_world[:3, 3] = middle - T_turned_world[:3, :3] @ middle
    T = scene.camera.T_camera_world @ T_turned_world
    return replace(scene, camera=replace(scene.camera, T_camera_world=T))
