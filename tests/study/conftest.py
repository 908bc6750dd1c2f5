"""The studies' tests share the cores with others."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """Use one thread of torch."""
