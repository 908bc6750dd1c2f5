"""Legs and arms that stage 1 takes for each other are found, and nothing else is."""

from dataclasses import replace
from itertools import product

import pytest
import roma
import torch

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.pose import SequenceOptions, refine
from gva_mi.pose.stage1 import Stage1
from gva_mi.pose.swaps import BEGINS, EACH, LIMBS, exchanged, fix_swaps, least_states
from gva_mi.splat import Camera, look_at

N = 48
MEAN = Shape(torch.zeros(10))
CAMERA = Camera(100, 100, 50, 50, look_at((0, 0, 3), (0, 0, 0)), 100, 100)
PAIRS = {name: [[JOINTS.index(f"{side}_{joint}") for joint in joints] for side in ("left", "right")]
         for name, joints in LIMBS.items()}  # fmt: skip


@pytest.fixture(scope="module")
def walk():
    """Somebody who takes a step in 12 frames and swings the arms."""
    pose, phase = Pose.rest(N), torch.arange(N) * torch.pi / 12
    for side, sign in (("left", 1), ("right", -1)):
        pose.rotations[:, JOINTS.index(f"{side}_hip"), 0] = 0.45 * sign * torch.sin(phase)
        pose.rotations[:, JOINTS.index(f"{side}_knee"), 0] = 0.3 - 0.3 * sign * torch.cos(phase)
        pose.rotations[:, JOINTS.index(f"{side}_shoulder"), 1] = 0.4 * torch.sin(phase)
        pose.rotations[:, JOINTS.index(f"{side}_shoulder"), 2] = -1.1 * sign
    return pose


def with_errors(pose, size=0.1):
    """White errors of the joints of the body, radians."""
    generator = torch.Generator().manual_seed(0)
    rotations = pose.rotations.clone()
    errors = size * torch.randn(len(pose), 21, 3, generator=generator) / 3**0.5
    rotations[:, 1:22] = roma.rotvec_composition([rotations[:, 1:22], errors])
    return replace(pose, rotations=rotations)


def swapped_in(pose, name, frames):
    rotations = pose.rotations.clone()
    rotations[frames] = exchanged(pose, name).rotations[frames]
    return replace(pose, rotations=rotations)


def unseen(pose):
    """Losses where no picture tells anything."""
    return torch.full((len(pose),), torch.nan)


def found(pose, losses=unseen):
    return fix_swaps(Stage1.of(pose, range(len(pose)), CAMERA), losses, nat=0.015)


@pytest.mark.parametrize("name", LIMBS)
def test_each_limb_becomes_the_mirror_image_of_the_other(body, walk, name):
    """Seen from the pelvis, in the plane x = 0, within a centimetre, as symmetric as rest is."""
    before, after = body(walk, MEAN).joints, body(exchanged(walk, name), MEAN).joints
    left, right = PAIRS[name]
    if name == "arms":
        left, right = [*left, *range(55)[LEFT_HAND]], [*right, *range(55)[RIGHT_HAND]]
    mirrored = before[:, right + left] * torch.tensor([-1.0, 1.0, 1.0])
    assert (after[:, left + right] - mirrored).norm(dim=-1).max() < 0.01
    others = [i for i in range(55) if i not in left + right]
    assert torch.equal(after[:, others], before[:, others])
    assert torch.equal(exchanged(exchanged(walk, name), name).rotations, walk.rotations)


def test_the_likeliest_states_are_those_of_the_least_energy():
    """Of all that there are."""
    generator = torch.Generator().manual_seed(1)
    for _ in range(20):
        data, motion = (8 * torch.rand(shape, generator=generator) for shape in ((7, 2), (6, 2, 2)))

        def energy(states, data=data, motion=motion):
            begins = sum(a < b for a, b in zip((0, *states), states, strict=False))
            of_frames = sum(float(data[k, s]) for k, s in enumerate(states))
            of_steps = sum(float(motion[k, *states[k : k + 2]]) for k in range(6))
            return of_frames + of_steps + EACH * sum(states) + BEGINS * begins

        least = min(product((0, 1), repeat=7), key=energy)
        assert least_states(data, motion).int().tolist() == list(least)


@pytest.mark.parametrize("size", [0.0, 0.05])
def test_legs_of_a_walker_are_put_right_by_the_motion_alone(walk, size):
    """But for frames in which they pass each other."""
    given = with_errors(walk, size)
    hips = walk.rotations[:, [JOINTS.index(f"{side}_hip") for side in ("left", "right")], 0]
    apart = (hips[:, 0] - hips[:, 1]).abs()
    frames = [*range(4, 8), *range(28, 33)]
    assert apart[frames].max() > 0.4
    assert found(given)[1] == {}
    right, which = found(swapped_in(given, "legs", frames))
    assert list(which) == ["legs"]
    assert {k for k in frames if apart[k] > 0.2} <= set(which["legs"]) <= set(frames)
    assert torch.equal(right.rotations[which["legs"]], given.rotations[which["legs"]])


def test_limbs_that_are_held_alike_are_left_alone(body):
    """Where only jitter would be exchanged."""
    pose = with_errors(Pose.rest(N), 0.2)
    assert found(pose)[1] == {}


def test_a_whole_video_is_not_exchanged(walk):
    """Motion says nothing about it, and pictures would have to."""
    wrong = exchanged(walk, "legs")
    assert found(wrong)[1] == {}
    away = lambda pose: 0.3 * (pose.rotations - walk.rotations)[:, 1:3].abs().amax((1, 2))
    right, which = found(wrong, away)
    assert which["legs"] == list(range(N))
    assert torch.equal(right.rotations, walk.rotations)


@pytest.mark.parametrize("unswap", [True, False])
def test_refine_exchanges_them_before_anything_else(body, scene, camera, walk, clip, unswap):
    """Of frames that are seen as masks and normals."""
    frames = [5, 6, 7]
    part = walk[:16]
    with torch.no_grad():
        views = [scene.render(body(part[k], MEAN).vertices[0], camera).numpy() for k in range(16)]
    pictures = [(view[..., 3].copy(), view[..., :3].copy()) for view in views]
    wrong = replace(clip, pose=swapped_in(part, "legs", frames), pictures=pictures)
    refined = refine(wrong, body, SequenceOptions(size=96, passes=1, learn=0, unswap=unswap))
    assert refined.swapped == ({"legs": frames} if unswap else {})
    error = (refined.pose.rotations - part.rotations)[:, PAIRS["legs"][0]].abs().amax((1, 2))
    assert (error[frames].min() > 0.3) == (not unswap)
    assert (error[frames].max() < 0.2) == unswap


@pytest.mark.parametrize("frames", [1, 2])
def test_very_few_frames(walk, frames):
    assert found(walk[:frames])[1] == {}
