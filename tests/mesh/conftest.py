"""The built-in body before a camera: the fixtures of all tests under short names."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """All tests of this folder are of tensors."""


@pytest.fixture(scope="session")
def scene(body_scene):
    return body_scene


@pytest.fixture(scope="session")
def camera(body_camera):
    return body_camera
