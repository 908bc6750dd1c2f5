"""What gradients by some inputs cost; scripts in processes of their own."""

import pytest

from gva_mi.splat.bench.environment import Environment, measure_environment
from gva_mi.splat.bench.partial import measure_partial


def test_passes_by_some_inputs_are_timed_beside_those_by_all(work):
    found = measure_partial(work, 2)
    assert found.all.least > 0 and found.ratio_colors > 0 and found.ratio_motion > 0
    assert f"{found.ratio_colors:.2f} x" in found.line()


@pytest.mark.slow
def test_a_script_that_sets_nothing_is_measured_beside_one_that_does(monkeypatch):
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")  # of this process: it is not passed on
    found = measure_environment(1, 2)
    assert found.plain > 0 and found.best > 0 and found.ratio > 0


def test_the_line_says_what_was_set():
    line = Environment(7.5, 7.25, 1.0345).line()
    assert "1.03 x one with OMP_WAIT_POLICY=PASSIVE (7.50 and 7.25 ms at least)" in line
