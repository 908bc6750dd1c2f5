"""The equations of a video's evidence are the slopes of its energy, whatever a frame counts."""

from dataclasses import replace

import torch

from gva_mi.body.pose import JOINTS
from gva_mi.observe.rig import LandmarkRig
from gva_mi.stage1.evidence import LandmarkEvidence, landmark_points
from gva_mi.stage1.unknowns import Stage1State, Unknowns

NAMES = ["left_hip", "left_knee", "left_ankle", "right_shoulder"]
FRAMES, BONES, STEP = 3, [[0, 1], [1, 2]], 1e-6


def test_pulls_are_the_slopes_of_the_energy(built_in_body):
    torch.manual_seed(0)
    random = lambda *shape: torch.randn(shape, dtype=torch.float64)
    joints = [JOINTS.index(name) for name in ("pelvis", "spine1", "left_hip", "left_knee")]
    unknowns = Unknowns(joints, built_in_body.num_betas, camera=True)
    rotations, zero = 0.3 * random(FRAMES, len(JOINTS), 3), torch.zeros(0, dtype=torch.float64)
    rotations[:, 0, 0] += torch.pi  # the camera's y points down
    place = torch.tensor([0.0, 0.2, 3.0]) + 0.1 * random(FRAMES, 3)
    state = Stage1State(
        rotations, place, 0.3 * random(unknowns.betas), 0.1 * random(), 0.1 * random(2),
        torch.tensor(1.2).double(), 0.01 * random(len(NAMES), 3), zero,
    )  # fmt: skip
    rig = LandmarkRig.of(built_in_body, NAMES)
    K = torch.diag(torch.tensor([500.0, 500, 1])).double()
    evidence = LandmarkEvidence(unknowns, landmark_points(built_in_body, rig, whole_body=True), K,
        30 * random(FRAMES, len(NAMES), 2), torch.full((FRAMES, len(NAMES)), 0.01).double(),
        torch.eye(2) + 0.3 * random(FRAMES, len(NAMES), 2, 2), torch.tensor(BONES),
        torch.ones(2).double(), 0.2 * random(FRAMES, 2), torch.full((FRAMES, 2), 50.0).double(),
        random(FRAMES, len(NAMES), 3),
        correlated=torch.tensor([1.0, 2.5, 7.0]).double())  # fmt: skip
    for terms in (evidence, replace(evidence, starting=True)):
        slopes = 0
        for row in terms.rows(state, derive=True):
            slopes = slopes + torch.einsum("nr,nrc->nc", row.weights * row.residuals, row.jacobian)
        F = unknowns.per_frame
        expected = torch.cat([slopes[:, :F].flatten(), slopes[:, F:].sum(0)])
        found = torch.stack([_slope(terms, state, k) for k in range(len(expected))])
        torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-4)
    double = replace(evidence, whitening=2 * evidence.whitening, precision=evidence.precision / 4)
    energy = lambda terms: sum(row.energy for row in terms.rows(state, derive=False))
    torch.testing.assert_close(energy(double), energy(evidence))  # only S / σ counts


def _slope(evidence, state, column):
    """Return the slope of the energy along one unknown, by central differences."""
    unknowns, frames = evidence.unknowns, len(state.pelvis_position)
    energies = []
    for sign in (1, -1):
        step = torch.zeros(frames * unknowns.per_frame + unknowns.shared, dtype=torch.float64)
        step[column] = sign * STEP
        some = frames * unknowns.per_frame
        moved = unknowns.moved(state, step[:some].view(frames, -1), step[some:])
        energies.append(sum(row.energy for row in evidence.rows(moved, derive=False)))
    return (energies[0] - energies[1]) / (2 * STEP)
