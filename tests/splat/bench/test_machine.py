"""The roof and the memory: positive, and a peak is remembered until it is forgotten."""

from pathlib import Path

import pytest

from gva_mi.splat.bench import machine


def test_limits_are_positive():
    limits = machine.measure(repeats=1)
    assert limits.gflops > 0 and limits.gigabytes > 0 and limits.threads >= 1


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux says how much")
def test_a_peak_is_remembered_until_it_is_forgotten():
    machine.forget_peak()
    before = machine.peak()
    memory = bytearray(200 << 20)
    assert machine.peak() >= before + (190 << 20)
    del memory
    machine.forget_peak()
    assert machine.peak() < before + (100 << 20)
    assert machine.resident() > 0
