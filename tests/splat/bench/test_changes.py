"""What was rendered once finds its kernels again; poses move about the Gaussians."""

import numpy as np
import pytest

from gva_mi.splat.bench.changes import measure_compiles, measure_moving, turned


def test_a_turned_camera_keeps_its_distance(work):
    middle = work.scene.gaussians.means.detach().double().mean(dim=0).numpy()
    far = lambda scene: np.linalg.norm(scene.camera.position - middle)
    assert far(turned(work.scene, 0.3)) == pytest.approx(far(work.scene))
    assert not np.allclose(turned(work.scene, 0.3).camera.position, work.scene.camera.position)


def test_both_loops_are_timed(work):
    found = measure_moving(work, 3)
    assert found.calls == 3 and found.ratio == found.moving.median / found.fixed.median
    assert found.memory_before >= 0 and found.memory_after >= 0


def test_a_size_seen_before_compiles_nothing(work):
    found = {compiled.scene: compiled for compiled in measure_compiles(work)}
    assert all(compiled.launched > 5 for compiled in found.values())
    for same in ("the same again", "another pose", "fewer Gaussians", "the first again"):
        assert found[same].new == 0, same
    assert found["a smaller picture"].new <= 1
