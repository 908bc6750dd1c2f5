"""Derivatives of posed points against differences."""

import torch

from gva_mi.body.so3 import compose
from gva_mi.observe.rig import LandmarkRig
from gva_mi.stage1.posed_points import PointSet, PosedPoints

STEP = 1e-6
JOINTS = [0, 3, 16, 18, 20, 37]
NAMES = ["nose", "left_wrist", "left_hand_ring_tip", "right_knee"]


def test_derivatives_agree_with_differences(built_in_body):
    rig = LandmarkRig.of(built_in_body, NAMES)
    points = PointSet.of(built_in_body, rig.joints, rig.rest, rig.directions)
    torch.manual_seed(0)
    random = lambda *shape: torch.randn(*shape, dtype=torch.float64)
    rotations, place = 0.4 * random(2, 55, 3), random(2, 3)
    betas, offsets = random(10), 0.01 * random(4, 3)
    posed = PosedPoints.of(points, rotations, place, betas, offsets)

    def moved(rotations=rotations, betas=betas, offsets=offsets):
        return (PosedPoints.of(points, rotations, place, betas, offsets).X - posed.X) / STEP

    by_joints, by_betas, by_offsets = (
        posed.by_joints(JOINTS), posed.by_betas(), posed.by_offsets()
    )  # fmt: skip
    for axis in range(3):
        unit = STEP * torch.eye(3, dtype=torch.float64)[axis]
        for k, joint in enumerate(JOINTS):
            turned = rotations.clone()
            turned[:, joint] = turned[:, joint] + unit if joint else compose(turned[:, 0], unit)
            assert torch.allclose(by_joints[:, :, :, k, axis], moved(turned), atol=1e-5)
        assert torch.allclose(by_offsets[..., axis], moved(offsets=offsets + unit), atol=1e-5)
    for k in range(10):
        unit = STEP * torch.eye(10, dtype=torch.float64)[k]
        assert torch.allclose(by_betas[..., k], moved(betas=betas + unit), atol=1e-5)
