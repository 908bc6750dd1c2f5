"""Depths of arms from exact observations are those of the landmarks, wherever these sit."""

import math

import torch

from gva_mi.body.pose import JOINTS
from gva_mi.observe.rig import LandmarkRig
from gva_mi.stage1.arm_depths import ARMS, with_arm_depths
from gva_mi.stage1.evidence import LandmarkEvidence, landmark_points
from gva_mi.stage1.posed_points import PosedPoints
from gva_mi.stage1.unknowns import Stage1State, Unknowns

FRAMES, GAIN = 12, 0.5
PIXELS, DEPTH = 4.0, 0.08  # how far off landmarks may be, and depths in metres, as networks' are
NAMES = [f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")]


def test_the_depth_is_that_of_landmarks_that_sit_beside_the_joints(built_in_body):
    rig = LandmarkRig.of(built_in_body, NAMES)
    at = {name: k for k, name in enumerate(rig.names)}
    zero = torch.zeros(0, dtype=torch.float64)
    rotations = torch.zeros(FRAMES, len(JOINTS), 3, dtype=torch.float64)
    rotations[:, 0, 1] = torch.linspace(0, 2 * math.pi, FRAMES)
    place = torch.tensor([0.0, 0, 3], dtype=torch.float64).expand(FRAMES, 3)
    torch.manual_seed(0)
    offsets = 0.04 * torch.randn(len(NAMES), 3, dtype=torch.float64)
    betas = torch.zeros(built_in_body.num_betas, dtype=torch.float64)
    state = Stage1State(
        rotations, place, betas, torch.zeros(()), torch.zeros(2), zero, offsets, zero
    )
    points = landmark_points(built_in_body, rig, whole_body=False)
    X = PosedPoints.of(points, rotations, place, betas, offsets).X
    K = torch.diag(torch.tensor([500.0, 500, 1], dtype=torch.float64))
    bones = [[at[f"{side}_{end}"] for end in bone] for side in ("left", "right") for bone in ARMS]
    i, j = torch.tensor(bones).unbind(1)
    depths = X[:, j, 2] - X[:, i, 2]
    sure = torch.full(X.shape[:2], PIXELS**-2, dtype=torch.float64)
    gain = torch.full((len(bones),), GAIN, dtype=torch.float64)
    evidence = LandmarkEvidence(Unknowns([0]), points, K, 500 * X[..., :2] / X[..., 2:], sure,
        torch.eye(2).double().expand(*sure.shape, 2, 2), torch.tensor(bones), gain, GAIN * depths,
        torch.full_like(depths, DEPTH**-2), X,
        correlated=torch.ones(len(X), dtype=torch.float64))  # fmt: skip
    found = with_arm_depths(evidence, rig.names, state, 1 / 15)
    assert bool((found.gain == 1).all())
    errors = (found.depths - depths).abs()
    # Offsets are 4 cm, and directions 3 cm apart at a bone's end: their mean lies between them.
    assert errors.mean() < 0.005 and errors.max() < 0.015
