"""What the tests of a fit share beside the tiny subject of :mod:`tests.conftest`."""

import pytest

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.splat import Camera


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """All tests of this folder are of tensors."""


@pytest.fixture(scope="session")
def hanging():
    """A function: a pose with arms so many radians below the T-pose."""

    def pose(lowered):
        found = Pose.rest()
        for side, sign in (("left", 1), ("right", -1)):
            found.rotations[:, JOINTS.index(f"{side}_shoulder"), 2] = -sign * lowered
        return found

    return pose


@pytest.fixture
def sharp(camera):
    """The camera with pixels of 7 mm."""
    lens = (6 * x for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    return Camera(*lens, camera.T_camera_world, 6 * camera.width, 6 * camera.height)
