"""Hinges bend as bodies do, and other turns cost."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, mirrored_name
from gva_mi.prior.anatomy import Anatomy

N = 24
TIMES = torch.arange(N)
joint = JOINTS.index


def straight():
    """Joints (55, 3) of a body whose bones lie along axes: x to its left, y up, z ahead."""
    rest = torch.zeros(55, 3)
    for side, sign in (("left", 1), ("right", -1)):
        places = {"knee": (0.1, -0.5, 0), "ankle": (0.1, -0.9, 0), "foot": (0.1, -0.9, 0.15)}
        places |= {"elbow": (0.45, 0.4, 0), "wrist": (0.7, 0.4, 0)}
        for finger, z in (("index", 0.03), ("middle", 0.01), ("ring", -0.01), ("pinky", -0.03)):
            places |= {f"{finger}{k}": (0.77 + 0.03 * k, 0.4, z) for k in (1, 2, 3)}
        places |= {f"thumb{k}": (0.73 + 0.03 * k, 0.4, 0.02 + 0.03 * k) for k in (1, 2, 3)}
        for name, (x, y, z) in places.items():
            rest[joint(f"{side}_{name}")] = torch.tensor([sign * x, y, z])
    return rest


STRAIGHT = Anatomy.of(straight())


def turned(*turns):
    """Rotations (N, 55, 3) of joints, each given by name, axis and degrees (one or N)."""
    rotations = torch.zeros(N, 55, 3)
    for name, axis, degrees in turns:
        sign = -1 if axis[0] == "-" else 1
        rotations[:, joint(name), "xyz".index(axis[-1])] = sign * torch.deg2rad(
            torch.as_tensor(degrees, dtype=torch.float32)
        )
    return rotations


def energy(anatomy, rotations, times=TIMES):
    return anatomy.energy(rotations, None, times)


def cost(*turns):
    return float(energy(STRAIGHT, turned(*turns)))


def noise(size, frames=N, seed=0):
    return size * torch.randn(frames, 55, 3, generator=torch.Generator().manual_seed(seed))


def white(size, frames=N):
    """The covariance (55, n, n) of errors that are independent in every frame, degrees."""
    variance = np.radians(size) ** 2 * torch.eye(frames, dtype=torch.float64)
    return variance.repeat(55, 1, 1)


@pytest.fixture(scope="module")
def anatomy(body):
    return Anatomy.of(body.j_template)


@pytest.mark.parametrize(
    ("name", "axis", "degrees"),
    [
        ("left_knee", "x", 150), ("right_knee", "x", 150), ("left_elbow", "-y", 150),
        ("right_elbow", "y", 150), ("left_index1", "-z", 100), ("right_pinky1", "z", 100),
    ],
)  # fmt: skip
def test_hinges_bend_forward_freely_and_not_backward(name, axis, degrees):
    assert cost((name, axis, torch.linspace(0, degrees, N))) < 1e-6
    back, farther = (cost((name, axis, -angle)) for angle in (45, 60))
    assert 0.5 < back < farther


def test_beyond_a_limit_the_energy_is_quadratic():
    """A knee may bend back by 5°; 5° more are a standard deviation; six frames count as one."""
    assert cost(("left_knee", "x", -4)) == 0
    assert cost(("left_knee", "x", -15)) == pytest.approx(N / 6 * 2**2 / 2, rel=1e-4)
    assert cost(("left_knee", "x", 155 + 20)) == pytest.approx(N / 6 * 4**2 / 2, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "axis"),
    [
        ("left_knee", "z"), ("left_knee", "y"), ("right_elbow", "z"), ("left_foot", "y"),
        ("left_ring2", "x"), ("left_ring2", "y"), ("right_middle1", "y"),
    ],
)  # fmt: skip
def test_hinges_do_not_turn_aside_or_twist(name, axis):
    once, twice = cost((name, axis, 10)), cost((name, axis, 20))
    assert 0.1 < once and twice == pytest.approx(4 * once, rel=1e-4)


@pytest.mark.parametrize(("side", "axis"), [("left", "-z"), ("right", "z")])
def test_the_last_joint_of_a_finger_follows_the_middle_one(side, axis):
    middle, last = ((f"{side}_index{k}", axis) for k in (2, 3))
    bend = torch.linspace(0, 90, N)
    follows = cost((*middle, bend), (*last, 2 / 3 * bend))
    assert follows < 1e-3 < 1 < min(cost((*middle, bend)), cost((*last, 2 / 3 * bend)))


@pytest.mark.parametrize("size", [0.02, 0.5])
def test_left_and_right_are_symmetric(anatomy, size):
    rotations = noise(size)
    order = [joint(mirrored_name(name)) for name in JOINTS]
    mirrored = rotations[:, order] * torch.tensor([1.0, -1.0, -1.0])
    energies = [float(energy(anatomy, x)) for x in (rotations, mirrored)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-3)


def test_the_gradient_reaches_every_held_joint(anatomy):
    leaf = (noise(0.5).cumsum(0) / 5).requires_grad_()
    energy(anatomy, leaf).backward()
    kinds = ("knee", "elbow", "foot", "index", "middle", "ring", "pinky", "thumb2", "thumb3")
    held = {i for i, name in enumerate(JOINTS) if name.split("_")[-1].startswith(kinds)}
    assert set(leaf.grad.any(2).any(0).nonzero()[:, 0].tolist()) == held


def test_conditioning_removes_tremor_aside_and_keeps_bends():
    tremor = 10 * (-1.0) ** TIMES
    bend = ("left_knee", "x", 60 + 5 * (-1.0) ** TIMES)
    free = (("left_hip", "z", tremor), ("right_elbow", "x", tremor))
    before = turned(("left_knee", "z", tremor), bend, *free)
    found = STRAIGHT.conditioned(before, white(10), TIMES)
    torch.testing.assert_close(found, turned(bend, *free), atol=0.01, rtol=0)
    torch.testing.assert_close(found[..., 0], before[..., 0], atol=1e-6, rtol=0)


@pytest.mark.parametrize("at", ["wrist", "middle1"])
def test_hands_without_finger_joints_have_no_hinges(at):
    """In some body files all finger joints lie in one point."""
    rest = straight()
    for side, hand in (("left", LEFT_HAND), ("right", RIGHT_HAND)):
        rest[hand] = rest[joint(f"{side}_{at}")].clone()
    anatomy, leaf = Anatomy.of(rest), noise(0.5).requires_grad_()
    energy(anatomy, leaf).backward()
    assert leaf.grad.isfinite().all() and leaf.grad[:, joint("left_knee")].any()
    assert not leaf.grad[:, LEFT_HAND].any() and not leaf.grad[:, RIGHT_HAND].any()
    found = anatomy.conditioned(leaf.detach(), white(10), TIMES)
    assert found.isfinite().all() and torch.equal(found[:, LEFT_HAND], leaf[:, LEFT_HAND])


def test_free_turns_cost_nothing():
    """Toes bend both ways, forearms twist, shoulders turn about all axes."""
    wave = 60 * torch.sin(TIMES / 3.0)
    assert cost(("left_foot", "x", wave), ("right_foot", "x", -wave)) < 1e-6
    assert cost(("left_elbow", "x", wave), ("right_elbow", "x", -wave)) < 1e-6
    assert cost(*(("left_shoulder", axis, wave) for axis in "xyz")) == 0
