"""The bare puppet before a camera, few pixels, in three poses: see the fixtures of all tests."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """All tests of this folder are of tensors."""


@pytest.fixture(scope="session")
def scene(puppet_scene):
    return puppet_scene


@pytest.fixture(scope="session")
def camera(puppet_camera):
    return puppet_camera
