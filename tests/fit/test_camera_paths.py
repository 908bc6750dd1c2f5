"""Camera paths keep the person in the picture and upright, in any world."""

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import Pose
from gva_mi.body.skinning import skin_points
from gva_mi.fit.renders import CameraPath, shots

WORLDS = {"z up": (np.pi / 2, 0, 0), "askew": (0.4, -1.1, 0.7)}


def in_world(pose, rig, rotvec):
    """The same motion in a world that is turned."""
    R = roma.rotvec_to_rotmat(torch.tensor(rotvec, dtype=torch.float32))
    rotations = pose.rotations.clone()
    rotations[:, 0] = roma.rotmat_to_rotvec(R @ roma.rotvec_to_rotmat(rotations[:, 0]))
    return Pose(rotations, (rig.joints[0] + pose.transl) @ R.T - rig.joints[0], pose.expression)


def seen(shot, rig, motion):
    """Pixels (V, 2) of the body's vertices in a shot."""
    pose = motion[shot.frame]
    maps = joint_transforms(pose.rotations, rig.joints, rig.parents, pose.transl)[0]
    return shot.camera.project(skin_points(rig.vertices, rig.weights, maps).double().numpy())


@pytest.fixture
def walk(turning):
    pose, _ = turning(6)
    pose.transl[:, 0] = torch.linspace(0, 3, 6)
    return pose


@pytest.mark.parametrize("path", ["turntable", "orbit", "static"])
@pytest.mark.parametrize("world", WORLDS)
def test_the_person_is_in_the_picture_and_upright(known, walk, path, world):
    motion = in_world(walk, known.rig, WORLDS[world])
    options = CameraPath(path, frames=6, size=(120, 160))
    for shot in shots(options, known.rig, motion):
        pixels = seen(shot, known.rig, motion)
        assert (pixels > 0).all() and (pixels < (120, 160)).all()
        height = known.rig.vertices[:, 1]
        head, feet = pixels[height.argmax()], pixels[height.argmin()]
        assert head[1] < feet[1] and abs(head[0] - feet[0]) < 0.35 * (feet[1] - head[1])


def test_a_turntable_holds_one_pose_and_goes_once_round(known, walk):
    found = shots(CameraPath("turntable", frames=8), known.rig, walk[4:])
    assert [shot.frame for shot in found] == [0] * 8
    eyes = np.stack([shot.camera.position for shot in found])
    middle = eyes.mean(0)
    angles = np.unwrap(np.arctan2(eyes[:, 0] - middle[0], eyes[:, 2] - middle[2]))
    assert np.allclose(np.diff(angles), np.pi / 4, atol=1e-5)
    assert np.allclose(np.linalg.norm(eyes - middle, axis=1).std(), 0, atol=1e-6)
    assert len(shots(CameraPath("turntable"), known.rig, walk)) == 72


def test_a_static_camera_stands_before_the_person(known, walk):
    found = shots(CameraPath("static"), known.rig, walk)
    assert [shot.frame for shot in found] == list(range(6))
    assert len({shot.camera for shot in found}) == 1
    joints = known.rig.joints.double().numpy()
    assert found[0].camera.position[2] > joints[:, 2].max()  # they look toward +z in frame 0
    behind = shots(CameraPath("static", turn=180), known.rig, walk)[0].camera.position
    assert behind[2] < joints[:, 2].min()
    high = shots(CameraPath("static", elevation=45), known.rig, walk)[0].camera.position
    assert high[1] > found[0].camera.position[1] + 1 > joints[0, 1] + 1
