"""A person who stands as the body does at rest costs nothing as upright; one who leans does."""

import pytest
import torch

from gva_mi.body.pose import JOINTS
from gva_mi.pose.film.film_evidence import AXIS, film_points
from gva_mi.pose.film.posed_points import PosedPoints
from gva_mi.pose.film.rig import LandmarkRig


def axis_of(body, betas, turns):
    """Return chest, pelvis and the middle of the feet (3, 3) of a body with some joints turned."""
    points = film_points(body, LandmarkRig.of(body), True)
    rotations = torch.zeros(1, len(JOINTS), 3, dtype=torch.float64)
    for joint, turn in turns.items():
        rotations[0, JOINTS.index(joint)] = torch.tensor(turn).double()
    offsets = torch.zeros(len(points.rest), 3, dtype=torch.float64)
    place = torch.zeros(1, 3, dtype=torch.float64)
    posed = PosedPoints.of(points, rotations, place, betas.double(), offsets)
    chest, pelvis, *feet = posed.X[0, -len(AXIS) :]
    return torch.stack([chest, pelvis, torch.stack(feet).mean(0)])


def test_the_axis_of_any_shape_is_upright_at_rest(built_in_body):
    for betas in (torch.zeros(10), torch.linspace(-2, 2, 10)):
        axis = axis_of(built_in_body, betas, {})
        assert (axis[:, 2] - axis[1, 2]).abs().max() < 1e-9
        assert (axis[:, 0] - axis[1, 0]).abs().max() < 2e-3  # bodies are not quite symmetric
        assert axis[0, 1] > axis[1, 1] > axis[2, 1]


@pytest.mark.parametrize("lean", [-0.2, 0.1])
def test_legs_and_trunk_lean_with_their_joints(built_in_body, lean):
    upright = axis_of(built_in_body, torch.zeros(10), {})
    legs = axis_of(
        built_in_body, torch.zeros(10), {f"{s}_hip": (lean, 0, 0) for s in ("left", "right")}
    )
    trunk = axis_of(built_in_body, torch.zeros(10), {"spine1": (lean, 0, 0)})
    assert torch.equal(legs[:2], upright[:2])
    assert torch.equal(trunk[1:], upright[1:])
    angle = lambda axis, top, below: torch.atan2(*(axis[top] - axis[below])[[2, 1]])
    # The legs turn about the hips, a little below the pelvis; the trunk about the lowest spine.
    assert angle(legs, 1, 2) == pytest.approx(lean, rel=0.25)
    assert angle(trunk, 0, 1) == pytest.approx(lean, rel=0.35)
