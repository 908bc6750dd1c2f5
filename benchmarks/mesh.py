"""Time ``mesh_normals`` in one step of a refinement, stage by stage.

The built-in body (22,000 faces) fills the height of a square picture. It moves a little at each
step, as in a fit, so that nothing can be reused from the step before.
"""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import numpy as np

from benchmarks.timing import WARM_UP, Clock, Table
from gva_mi.body.smplx import load_body
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera, look_at

VERTEX_STEP = 1e-3  # metres from one step to the next; chosen: as far as a refinement moves


def run(repeats: int, sizes: tuple[int, ...] = (256, 512)) -> Iterator[Table]:
    """Yield one table per size of picture (pixels)."""
    body = load_body()
    scene, template = MeshScene(body.faces, body.v_template), body.v_template
    import mitsuba as mi  # its variant is chosen by MeshScene

    centre = template.mean(0).numpy()
    T_camera_world = look_at(centre + (0.2, 0.1, 2.6), centre)
    for size in sizes:
        camera = Camera(1.2 * size, 1.2 * size, size / 2, size / 2, T_camera_world, size, size)
        noise = np.random.default_rng(0).normal(size=(size, size, 4))
        grad, clock = mi.TensorXf(noise.astype(np.float32)), Clock()
        for k in range(WARM_UP + repeats):
            moved = template + VERTEX_STEP * (k + 1)
            with clock("whole step"):
                with clock("ray tracer's update"):
                    scene.show(moved)
                with clock("image"):
                    view = scene.view(moved, camera)
                    dr.eval(view.image())
                with clock("adjoint"):
                    dr.eval(view.adjoint(grad))
        title = f"mesh_normals, {len(body.faces):,} faces, {size} x {size} pixels, 1 ray a pixel"
        yield clock.table(title, WARM_UP)
