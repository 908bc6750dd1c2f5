"""What the tests of a fit share beside the tiny subject of :mod:`tests.conftest`."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """All tests of this folder are of tensors."""
