"""A process's first call is measured in a process of its own."""

import pytest

from gva_mi.splat.bench.first_call import FirstCall, measure_first_call


@pytest.mark.slow
def test_a_process_is_measured():
    found = measure_first_call(1)
    assert found.torch > 0 and found.splat > 0 and 0 < found.second < 10 and found.first > 0
    assert found.compiled == 0  # the process before left them on disk
    assert "first call of a process" in found.line() and "compiled" not in found.line()


def test_kernels_that_the_disk_does_not_keep_are_told():
    assert "; 7 kernels compiled" in FirstCall(1.0, 0.2, 0.5, 0.01, 7).line()
