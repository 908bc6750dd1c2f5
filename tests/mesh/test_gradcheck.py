"""The study of the gradients by the pose holds what it promises."""

import pytest

from gva_mi.mesh.gradcheck import (
    CASES,
    LIMITS,
    GradientErrors,
    GradientOptions,
    check_gradients,
    table,
)


def test_a_case_that_is_too_far_off_is_marked():
    fine = GradientErrors("free", "transl x", 0.01, 0.02, 0.03)
    hidden = GradientErrors("occluding", "left_index1 z", None, 0.02, 0.03)
    wrong = GradientErrors("free", "transl y", 0.01, 0.02, 1.01 * LIMITS["boundary"])
    assert fine.passed and hidden.passed and not wrong.passed
    lines = table([fine, hidden, wrong]).splitlines()
    assert [line.endswith("too much") for line in lines] == [False, False, False, True]


@pytest.mark.slow
def test_gradients_by_the_pose_are_right():
    rows = list(check_gradients(GradientOptions()))
    assert len(rows) == len(CASES)
    assert all(row.passed for row in rows), table(rows)
    assert sum(row.mask is None for row in rows) == 1  # a finger before the body
