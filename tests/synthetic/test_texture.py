"""Textures: cloth of a skirt unrolls without stretching; colours are albedos."""

import numpy as np
import pytest

from gva_mi.synthetic.look import SkirtCone

pytest.importorskip("mitsuba")
CONE = SkirtCone(apex=(0.0, 1.2, 0.05), slope=0.35, aspect=1.0)


def on_cone(height, angle):
    radius = CONE.slope * (CONE.apex[1] - height)
    return np.stack([radius * np.sin(angle), height, CONE.apex[2] + radius * np.cos(angle)])


def unrolled(points):
    from drjit.llvm import Array3f

    return np.stack([x.numpy() for x in CONE.unrolled(Array3f(points.astype(np.float32)))])


def test_unrolling_a_cone_keeps_lengths():
    random = np.random.default_rng(0)
    height, angle = random.uniform(0.4, 0.9, 200), random.uniform(-2.8, 2.8, 200)
    for dy, da in ((0.01, 0.0), (0.0, 0.02), (0.007, -0.02)):
        on = [on_cone(height, angle), on_cone(height + dy, angle + da)]
        flat = unrolled(on[1]) - unrolled(on[0])
        length = np.linalg.norm(on[1] - on[0], axis=0)
        assert np.allclose(np.linalg.norm(flat, axis=0), length, rtol=0.01)
