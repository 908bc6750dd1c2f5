"""Upright lines of a room show which way is up."""

import numpy as np
import pytest
import torch

from gva_mi.prior.body_height import Stature
from gva_mi.stage1.body_prior import SharedPrior
from gva_mi.stage1.normal_equations import NormalEquations
from gva_mi.stage1.unknowns import Stage1State, Unknowns
from gva_mi.stage1.vertical_lines import Vertical, find_vertical
from gva_mi.subject.landmarks import Landmarks

SIZE, FOCAL = 320, 300.0
K = np.array([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def up_of(pitch, roll):
    """Return the direction up of a camera that looks down and leans to the side, degrees."""
    pitch, roll = np.radians([pitch, roll])
    up = np.array([np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch), -np.sin(pitch)])
    return up[[0, 2]] / -up[1]


def room(up, rng, bars=40):
    """Paint dark bars that stand upright before a light wall, and some that lean."""
    u = np.array([up[0], -1, up[1]])
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    picture = np.full((SIZE, SIZE), 200.0)
    for k in range(bars):
        foot = np.array([rng.uniform(-0.6, 0.6), rng.uniform(0.0, 0.4), 1]) * rng.uniform(2, 5)
        along = u if k % 2 else u + [rng.uniform(-0.5, 0.5), 0, 0]
        bottom, top = (K @ point / point[2] for point in (foot, foot + rng.uniform(0.5, 1) * along))
        slope = (top[0] - bottom[0]) / (top[1] - bottom[1])
        inside = 3 - np.abs(x - bottom[0] - slope * (y - bottom[1]))
        share = np.clip(inside + 0.5, 0, 1) * ((y > top[1]) & (y < bottom[1]))
        picture += share * (rng.uniform(20, 120) - picture)
    return np.repeat(picture[..., None], 3, 2).round().astype(np.uint8)


def person(points=np.nan):
    """Return landmarks of one frame; without points, nobody was found."""
    pixels = np.broadcast_to(np.asarray(points, float), (1, 2, 2)).copy()
    one = np.ones((1, 2))
    return Landmarks(("nose", "left_ankle"), pixels, one, one, np.zeros((1, 2, 3)))


@pytest.mark.parametrize(("pitch", "roll"), [(0, 0), (12, 0), (-5, 3), (25, -4), (0, 19)])
def test_the_direction_up_is_found_among_leaning_bars(pitch, roll, rng):
    found = find_vertical([room(up_of(pitch, roll), rng)], person(), K)
    assert (np.abs(found.up - up_of(pitch, roll)) < 2 * found.spread).all()
    assert (found.spread < 0.025).all()  # of which 0.006 is the least


def test_a_picture_without_upright_lines_shows_nothing(rng):
    noise = rng.integers(0, 255, (SIZE, SIZE, 3)).astype(np.uint8)
    flat = np.full((SIZE, SIZE, 3), 128, np.uint8)
    assert find_vertical([noise], person(), K) is None
    assert find_vertical([flat], person(), K) is None


def test_lines_lower_than_the_feet_do_not_count(rng):
    """They lie on the floor, and there are more of them than upright ones."""
    true, of_floor = up_of(10, 0), up_of(-20, 5)
    picture = room(true, rng, bars=60)
    picture[170:] = room(of_floor, rng, bars=200)[170:]
    found = find_vertical([picture], person([[[158, 90], [162, 170]]]), K)
    assert (np.abs(found.up - true) < 2 * found.spread).all()
    all_count = find_vertical([picture], person([[[158, 240], [162, 319]]]), K)
    assert (np.abs(all_count.up - of_floor) < 2 * all_count.spread).all()


def test_lines_of_an_unknown_lens_tie_the_direction_up_to_it(built_in_body):
    """The pull of the prior is the slope of its energy."""
    z = lambda *shape: torch.zeros(shape, dtype=torch.float64)
    unknowns = Unknowns([0], 4, True)
    lines = Vertical(np.array([0.02, -0.3]), np.array([0.01, 0.02]))
    stature = Stature.of(built_in_body)
    prior = SharedPrior(unknowns, (), z(0), z(0), z(4), stature, 1.7, 0.15, lines, None)
    start = Stage1State(z(1, 55, 3), z(1, 3), z(4) + 0.1, z() + 0.2, z(2) - 0.1, z(), z(0, 3), z(0))
    equations = NormalEquations.zero(1, unknowns.per_frame, unknowns.shared)
    prior.add(start, equations)

    def energy(step):
        return prior.energy(unknowns.moved(start, z(1, unknowns.per_frame), step))

    slope = torch.autograd.functional.jacobian(energy, z(unknowns.shared))
    torch.testing.assert_close(-equations.shared_pull, slope)
