"""Clips cover a video, overlap as asked, and join without a seam."""

import pytest
import roma
import torch

from gva_mi.body.pose import Pose
from gva_mi.refine.clips import cut, join, skim


@pytest.mark.parametrize("overlap", [0, 16])
@pytest.mark.parametrize("frames", [1, 40, 41, 997])
def test_clips_cover_the_video_and_overlap(frames, overlap):
    clips = cut(frames, 40, overlap)
    assert clips[0].start == 0 and clips[-1].stop == frames
    assert all(0 < len(clip) <= 40 for clip in clips)
    assert all(a.stop - b.start == overlap for a, b in zip(clips, clips[1:], strict=False))
    lengths = [len(clip) for clip in clips]
    assert max(lengths) - min(lengths) <= 1 and (len(clips) == 1) == (frames <= 40)


def test_a_skim_is_runs_from_the_whole_video():
    frames = skim(1000, 96)
    assert len(frames) == 96 and frames[0] == 0 and frames[-1] == 999
    starts = [k for k in frames if k - 1 not in frames]
    gaps = [b - a for a, b in zip(starts, starts[1:], strict=False)]
    assert len(starts) == 8 and max(gaps) - min(gaps) <= 1
    assert all(skim(n, 96) == list(range(n)) for n in (1, 5, 96))


def smooth(frames):
    generator = torch.Generator().manual_seed(2)
    axis = torch.nn.functional.normalize(torch.randn(55, 3, generator=generator), dim=-1)
    rotations = torch.linspace(0, 2.5, frames)[:, None, None] * axis
    transl = torch.linspace(0, 1, frames)[:, None] * torch.tensor([1.0, 2.0, 3.0])
    return Pose(rotations, transl, transl @ torch.ones(3, 10))


def apart(a, b):
    return roma.rotmat_geodesic_distance(roma.rotvec_to_rotmat(a), roma.rotvec_to_rotmat(b))


def test_clips_that_agree_join_to_the_same_poses():
    pose = smooth(100)
    clips = cut(100, 40, 8)
    found = join(clips, [pose[clip.start : clip.stop] for clip in clips])
    assert float(apart(found.rotations, pose.rotations).max()) < 2e-3
    torch.testing.assert_close(found.transl, pose.transl)
    assert torch.equal(found.expression, pose.expression)


def test_a_disagreement_is_spread_over_the_overlap():
    pose = smooth(60)
    a, b = cut(60, 40, 9)
    off = torch.tensor([0.1, 0.0, 0.0])
    turn = roma.rotvec_composition([pose.rotations, off.expand_as(pose.rotations)])
    other = Pose(turn, pose.transl + off, pose.expression)
    found = join([a, b], [pose[: a.stop], other[b.start :]])
    steps = (found.transl - pose.transl)[:, 0]
    assert (steps[: b.start] == 0).all() and steps[a.stop :].allclose(off[:1], atol=1e-6)
    jumps = steps.diff()
    assert float(jumps.max()) < 0.1 / 9 and float(jumps.min()) > -1e-6
    angles = apart(found.rotations, pose.rotations)[:, 0]
    torch.testing.assert_close(angles, steps, atol=2e-3, rtol=0)
