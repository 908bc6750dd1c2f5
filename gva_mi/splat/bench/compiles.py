"""What a scene of another size costs: kernels that had to be compiled for it.

The kernels are traced once and replayed (frozen.py), so that a call with another number of
Gaussians, another pose or another picture finds all of its code in this process.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import drjit as dr

from gva_mi.splat.bench.timing import Work
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians


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
