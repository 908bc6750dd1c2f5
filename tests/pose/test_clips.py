"""Parts cover a video, overlap as told, and join without a seam."""

import pytest
import roma
import torch

from gva_mi.pose.clips import cut, join, skim


@pytest.mark.parametrize("overlap", [0, 3, 16])
@pytest.mark.parametrize("frames", [1, 39, 40, 41, 100, 997])
def test_parts_cover_the_video_and_overlap_as_told(frames, overlap):
    parts = cut(frames, 40, overlap)
    assert parts[0].start == 0 and parts[-1].stop == frames
    assert all(0 < len(part) <= 40 for part in parts)
    assert all(a.stop - b.start == overlap for a, b in zip(parts, parts[1:], strict=False))
    lengths = [len(part) for part in parts]
    assert max(lengths) - min(lengths) <= 1 + (overlap if len(parts) == 1 else 1)
    assert len(parts) == 1 or frames > 40


def test_a_skim_is_runs_from_all_over_the_video():
    frames = skim(1000, 96)
    assert len(frames) == 96 and frames[0] == 0 and frames[-1] == 999
    starts = [k for k in frames if k - 1 not in frames]
    assert len(starts) == 8
    gaps = [b - a for a, b in zip(starts, starts[1:], strict=False)]
    assert max(gaps) - min(gaps) <= 1


@pytest.mark.parametrize("frames", [1, 5, 96, 97])
def test_a_short_video_is_skimmed_whole(frames):
    assert set(skim(frames, 96)) <= set(range(frames))
    assert len(skim(frames, 96)) >= min(frames, 96)


def smooth(frames):
    generator = torch.Generator().manual_seed(2)
    axis = torch.nn.functional.normalize(torch.randn(55, 3, generator=generator), dim=-1)
    rotations = torch.linspace(0, 2.5, frames)[:, None, None] * axis
    return rotations, torch.linspace(0, 1, frames)[:, None] * torch.tensor([1.0, 2.0, 3.0])


def apart(a, b):
    return roma.rotmat_geodesic_distance(roma.rotvec_to_rotmat(a), roma.rotvec_to_rotmat(b))


def test_parts_that_agree_come_back_as_they_were():
    rotations, transl = smooth(100)
    parts = cut(100, 40, 8)
    of_parts = lambda x: [x[part.start : part.stop] for part in parts]
    R, t = join(parts, of_parts(rotations), of_parts(transl))
    assert R.shape == rotations.shape and t.shape == transl.shape
    assert float(apart(R, rotations).max()) < 2e-3
    torch.testing.assert_close(t, transl)


def test_a_disagreement_is_spread_over_the_overlap():
    rotations, transl = smooth(60)
    parts = cut(60, 40, 9)
    off = torch.tensor([0.1, 0.0, 0.0])
    turn = roma.rotvec_composition([rotations, off.expand_as(rotations)])
    a, b = parts
    R, t = join(
        parts,
        [rotations[: a.stop], turn[b.start :]],
        [transl[: a.stop], transl[b.start :] + off],
    )
    steps = (t - transl)[:, 0]
    assert (steps[: b.start] == 0).all() and steps[a.stop :].allclose(off[:1], atol=1e-6)
    jumps = steps.diff()
    assert float(jumps.max()) < 0.1 / 9 and float(jumps.min()) > -1e-6
    angles = apart(R, rotations)[:, 0]
    torch.testing.assert_close(angles, steps, atol=2e-3, rtol=0)


def test_two_solutions_half_a_turn_of_numbers_apart_are_blended_the_short_way():
    """Axis-angle vectors of one rotation may be opposite; the mean of the vectors is another."""
    half = torch.tensor([0.0, 3.1, 0.0]).expand(6, 55, 3)
    zero = torch.zeros(6, 3)
    parts = [range(0, 6), range(2, 8)]
    R, _ = join(parts, [half, -half], [zero, zero])
    assert float(apart(R[2:6], half[:4]).max()) < 0.09
