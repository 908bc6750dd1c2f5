"""Picture evidence prefers the right pose and gives gradients to all of it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.fit.photometric import PhotometricOptions, PictureAndMask

BOTH = PhotometricOptions(alpha=0.5, ssim=0.1)
PICTURE = PhotometricOptions(alpha=0.0, ssim=0.0)


def moved(pose, shift=(0.0, 0.0, 0.0), elbow=0.0):
    rotations = pose.rotations.clone()
    rotations[:, JOINTS.index("right_elbow"), 1] += elbow
    return Pose(rotations, pose.transl + torch.tensor(shift), pose.expression)


@pytest.fixture
def frame(video):
    return video[1]


@pytest.fixture
def points(known, frame):
    with torch.no_grad():
        return known(frame.pose).means.double().numpy()


@pytest.fixture
def seen(frame, points):
    return PictureAndMask.of(frame, points)


@pytest.mark.parametrize(
    "change",
    [{"shift": shift} for shift in np.concatenate([0.04 * np.eye(3), -0.04 * np.eye(3)]).tolist()]
    + [{"elbow": 0.4}, {"elbow": -0.4}],
    ids=str,
)
def test_the_right_pose_has_the_smallest_loss(change, known, frame, seen):
    with torch.no_grad():
        wrong = seen.loss(known, moved(frame.pose, **change), BOTH)
        assert seen.loss(known, frame.pose, BOTH) < wrong


def test_outlines_do_not_follow_the_mask(known, frame, points, seen):
    """A damaged mask changes the alpha term only, apart from the area in the denominator."""
    bitten = frame.mask.copy()
    bitten[20:28, 20:24] = 0
    other = PictureAndMask.of(replace(frame, mask=bitten), points)
    assert other.picture.equal(seen.picture) and not other.mask.equal(seen.mask)
    with torch.no_grad():
        a, b = (s.loss(known, frame.pose, PICTURE) * s.mask.float().mean() for s in (seen, other))
        torch.testing.assert_close(a, b)
        assert other.loss(known, frame.pose, BOTH) > seen.loss(known, frame.pose, BOTH)
