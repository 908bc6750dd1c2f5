import torch

from gva_mi.fit.poses import TrainedPoses


def equal(a, b):
    return torch.equal(a.rotations, b.rotations) and torch.equal(a.transl, b.transl)


def test_poses_start_as_they_were_given(video):
    for trained in (False, True):
        poses = TrainedPoses(video.pose, trained)
        assert equal(poses.all(video.splits.train), video.pose)
        assert all(equal(poses(k), video.pose[k]) for k in range(len(video)))
        assert len(list(poses.parameters())) == trained * len(video)


def test_a_step_on_one_frame_leaves_the_others_alone(video):
    poses = TrainedPoses(video.pose, trained=True)
    optimizer = torch.optim.Adam(poses.parameters(), lr=0.1)
    for frame in (2, 4):  # frame 2 has momentum when frame 4 has its turn
        optimizer.zero_grad(set_to_none=True)
        (poses(frame).rotations.sum() + poses(frame).transl.sum()).backward()
        optimizer.step()
    moved = (poses.all(range(len(video))).transl - video.pose.transl).abs().amax(1)
    torch.testing.assert_close(moved, torch.tensor([0, 0, 0.1, 0, 0.1, 0]), rtol=0, atol=1e-4)


def test_a_frame_that_is_not_trained_on_takes_its_neighbours_correction(video):
    poses = TrainedPoses(video.pose, trained=True)
    with torch.no_grad():
        for frame, shift in ((1, 0.1), (2, 7.0), (3, 0.3)):  # frame 2 is not to be looked at
            poses.frames[frame][-1] += shift
    moved = (poses.all([0, 1, 3, 4, 5]).transl - video.pose.transl)[:, 2]
    expected = torch.tensor([0, 0.1, 0.2, 0.3, 0, 0])
    torch.testing.assert_close(moved, expected, rtol=0, atol=1e-6)
