"""The gradients of ``mesh_normals`` with respect to the body's pose agree with exact ones."""

import pytest

from gva_mi.gradcheck import normals
from gva_mi.gradcheck.normals import COORDINATES, check_normals

QUICK = {"size": 96, "lines": 2000, "points": 20}


def test_one_coordinate_is_right_and_an_error_is_found(monkeypatch):
    (rows,) = check_normals(1, **QUICK)
    parts = ["mask", "interior", "boundary"]
    assert [row.name for row in rows] == [f"free, transl x: {part}" for part in parts]
    assert all(row.passed for row in rows), rows
    by_plugin = normals._by_plugin

    def wrong(*args):
        inside, jumps = by_plugin(*args)
        return inside, 1.1 * jumps

    monkeypatch.setattr(normals, "_by_plugin", wrong)
    (rows,) = check_normals(1, **QUICK)
    assert [row.name.split(": ")[1] for row in rows if not row.passed] == ["mask", "boundary"]


@pytest.mark.slow
def test_gradients_by_the_pose_are_right():
    found = list(check_normals(len(COORDINATES)))
    assert len(found) == len(COORDINATES)
    assert all(row.passed for rows in found for row in rows), found
    without_mask = [rows for rows in found if not rows[0].name.endswith("mask")]
    assert len(without_mask) == 1  # a finger before the body
