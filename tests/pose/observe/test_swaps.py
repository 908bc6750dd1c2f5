"""Limbs that stage 1 swapped are found, and no others."""

from dataclasses import replace
from itertools import product

import pytest
import roma
import torch

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.observe.swaps import (
    LIMBS,
    SWAP_NATS,
    SWAP_RUN_NATS,
    exchanged,
    fix_swaps,
    most_probable_states,
)
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine import SequenceOptions, refine
from gva_mi.splat import Camera, look_at

N = 48
MEAN = Shape(torch.zeros(10))
CAMERA = Camera(100, 100, 50, 50, look_at((0, 0, 3), (0, 0, 0)), 100, 100)
PAIRS = {name: [[JOINTS.index(f"{side}_{joint}") for joint in joints] for side in ("left", "right")]
         for name, joints in LIMBS.items()}  # fmt: skip


@pytest.fixture(scope="module")
def walk():
    """A person who takes a step in 12 frames and swings the arms."""
    pose, phase = Pose.rest(N), torch.arange(N) * torch.pi / 12
    for side, sign in (("left", 1), ("right", -1)):
        pose.rotations[:, JOINTS.index(f"{side}_hip"), 0] = 0.45 * sign * torch.sin(phase)
        pose.rotations[:, JOINTS.index(f"{side}_knee"), 0] = 0.3 - 0.3 * sign * torch.cos(phase)
        pose.rotations[:, JOINTS.index(f"{side}_shoulder"), 1] = 0.4 * torch.sin(phase)
        pose.rotations[:, JOINTS.index(f"{side}_shoulder"), 2] = -1.1 * sign
    return pose


def with_errors(pose, size=0.1):
    """The pose with white errors of its joints, radians."""
    generator = torch.Generator().manual_seed(0)
    rotations = pose.rotations.clone()
    errors = size * torch.randn(len(pose), 21, 3, generator=generator) / 3**0.5
    rotations[:, 1:22] = roma.rotvec_composition([rotations[:, 1:22], errors])
    return replace(pose, rotations=rotations)


def swapped_in(pose, name, frames):
    rotations = pose.rotations.clone()
    rotations[frames] = exchanged(pose, name).rotations[frames]
    return replace(pose, rotations=rotations)


def no_evidence(pose):
    return torch.full((len(pose),), torch.nan)


def found(pose, losses=no_evidence):
    return fix_swaps(Stage1Poses.of(pose, range(len(pose)), CAMERA), losses, prior_weight=0.015)


@pytest.mark.parametrize("name", LIMBS)
def test_each_limb_becomes_the_mirror_image_of_the_other(body, walk, name):
    """Relative to the pelvis, in the plane x = 0, within a centimetre: as symmetric as rest is."""
    before, after = body(walk, MEAN).joints, body(exchanged(walk, name), MEAN).joints
    left, right = PAIRS[name]
    if name == "arms":
        left, right = [*left, *range(55)[LEFT_HAND]], [*right, *range(55)[RIGHT_HAND]]
    mirrored = before[:, right + left] * torch.tensor([-1.0, 1.0, 1.0])
    assert (after[:, left + right] - mirrored).norm(dim=-1).max() < 0.01
    others = [i for i in range(55) if i not in left + right]
    assert torch.equal(after[:, others], before[:, others])
    assert torch.equal(exchanged(exchanged(walk, name), name).rotations, walk.rotations)


def test_the_states_have_the_least_energy_of_all():
    generator = torch.Generator().manual_seed(1)
    for _ in range(10):
        data, motion = (8 * torch.rand(shape, generator=generator) for shape in ((7, 2), (6, 2, 2)))

        def energy(states, data=data, motion=motion):
            begins = sum(a < b for a, b in zip((0, *states), states, strict=False))
            of_frames = sum(float(data[k, s]) for k, s in enumerate(states))
            of_steps = sum(float(motion[k, *states[k : k + 2]]) for k in range(6))
            return of_frames + of_steps + SWAP_NATS * sum(states) + SWAP_RUN_NATS * begins

        least = min(product((0, 1), repeat=7), key=energy)
        assert most_probable_states(data, motion).int().tolist() == list(least)


@pytest.mark.parametrize("size", [0.0, 0.05])
def test_swapped_legs_of_a_walker_are_fixed_by_the_motion_alone(walk, size):
    """Except in frames in which the legs pass each other."""
    given = with_errors(walk, size)
    hips = walk.rotations[:, [JOINTS.index(f"{side}_hip") for side in ("left", "right")], 0]
    apart = (hips[:, 0] - hips[:, 1]).abs()
    frames = [*range(4, 8), *range(28, 33)]
    assert apart[frames].max() > 0.4
    assert found(given)[1] == {}
    fixed, which = found(swapped_in(given, "legs", frames))
    assert list(which) == ["legs"]
    assert {k for k in frames if apart[k] > 0.2} <= set(which["legs"]) <= set(frames)
    assert torch.equal(fixed.rotations[which["legs"]], given.rotations[which["legs"]])


def test_only_images_can_swap_a_whole_video(walk):
    wrong = exchanged(walk, "legs")
    assert found(wrong)[1] == {}
    away = lambda pose: 0.3 * (pose.rotations - walk.rotations)[:, 1:3].abs().amax((1, 2))
    fixed, which = found(wrong, away)
    assert which["legs"] == list(range(N))
    assert torch.equal(fixed.rotations, walk.rotations)


def test_refine_fixes_swaps_first(body, seen_in, walk, clip):
    frames, part = [3, 4, 5], walk[2:12]
    pictures = seen_in(part)
    wrong = replace(clip, pose=swapped_in(part, "legs", frames), pictures=pictures)
    refined = refine(wrong, body, SequenceOptions(size=96, faces=2000, passes=1, learn=0))
    assert refined.swapped == {"legs": frames}
    error = (refined.pose.rotations - part.rotations)[:, PAIRS["legs"][0]].abs().amax((1, 2))
    assert error[frames].max() < 0.2
