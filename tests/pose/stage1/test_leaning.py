"""A person who stands as the body does at rest costs nothing as upright; one who leans does."""

import pytest
import torch

from gva_mi.body.pose import JOINTS
from gva_mi.observe.rig import LandmarkRig
from gva_mi.stage1.evidence import landmark_points
from gva_mi.stage1.leaning import AXIS_FACTORS, MASS_SHARES, Leaning
from gva_mi.stage1.posed_points import PosedPoints
from gva_mi.subject.landmarks import BODY_LANDMARKS


def axes_of(body, betas, turns):
    """Return trunk, balance and feet (3, 3), metres, of a body with some joints turned."""
    return AXIS_FACTORS @ joints_of(body, betas, turns)


def joints_of(body, betas, turns):
    """Return the joints that have mass (15, 3), metres."""
    points = landmark_points(body, LandmarkRig.of(body, BODY_LANDMARKS), True)
    rotations = torch.zeros(1, len(JOINTS), 3, dtype=torch.float64)
    for joint, turn in turns.items():
        rotations[0, JOINTS.index(joint)] = torch.tensor(turn).double()
    offsets = torch.zeros(len(points.rest), 3, dtype=torch.float64)
    place = torch.zeros(1, 3, dtype=torch.float64)
    posed = PosedPoints.of(points, rotations, place, betas.double(), offsets)
    return posed.X[0, -len(MASS_SHARES) :]


def both(joint, angle):
    return {f"{side}_{joint}": (angle, 0, 0) for side in ("left", "right")}


def test_the_masses_are_those_of_one_body():
    assert sum(MASS_SHARES.values()) == pytest.approx(1)
    assert torch.allclose(AXIS_FACTORS.sum(1), torch.zeros(3, dtype=AXIS_FACTORS.dtype), atol=1e-12)


def test_the_axes_of_any_shape_are_upright_at_rest(built_in_body):
    for betas in (torch.zeros(10), torch.linspace(-2, 2, 10)):
        axes = axes_of(built_in_body, betas, {})[:2]
        assert axes[:, 2].abs().max() < 1e-7
        assert axes[:, 0].abs().max() < 5e-3  # bodies are not quite symmetric
        assert (axes[:, 1] > 0.3).all()


def test_who_crouches_in_balance_leans_forward(built_in_body):
    """Knees, hips and ankles bent: only with the trunk forward the mass stays above the feet."""
    crouch = both("hip", -1.4) | both("knee", 1.6) | both("ankle", -0.4)
    off = lambda turns: abs(float(axes_of(built_in_body, torch.zeros(10), crouch | turns)[1, 2]))
    assert off({"pelvis": (0.2, 0, 0), "spine1": (0.6, 0, 0)}) < 0.01
    assert off({"pelvis": (0.2, 0, 0)}) > 0.08
    assert off({}) > 0.2


@pytest.mark.parametrize("lean", [-0.2, 0.0, 0.15])
def test_the_mass_may_be_above_either_foot(built_in_body, lean):
    """With a leg raised aside, turning aside moves the mass from one foot to the other."""
    turns = {"left_hip": (0, 0, 0.9), "pelvis": (0, 0, lean)}
    X = joints_of(built_in_body, torch.zeros(10), turns)
    leaning = Leaning.of(X[None], torch.tensor([0.0, 1, 0]).double(), 0.05)
    middle = AXIS_FACTORS[1] @ X
    assert abs(middle[0] / middle.norm()) > 0.1
    assert leaning.lean[0, 1].norm() < 0.02
    assert -0.5 < float(leaning.share) < 0
