"""Training as it is: another pose, and so another number of pairs, at every call."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.splat.bench import machine
from gva_mi.splat.bench.timing import Timing, Work, seconds
from gva_mi.splat.scene import Scene


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
    """Seen from another side: the camera turned about the Gaussians' middle."""
    c, s = math.cos(angle), math.sin(angle)
    middle = scene.gaussians.means.detach().double().mean(dim=0).numpy()
    T_turned_world = np.eye(4)
    T_turned_world[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    T_turned_world[:3, 3] = middle - T_turned_world[:3, :3] @ middle
    T = scene.camera.T_camera_world @ T_turned_world
    return replace(scene, camera=replace(scene.camera, T_camera_world=T))
