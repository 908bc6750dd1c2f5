"""The number of the first frame: by program, by the pictures' names, by counts."""

import numpy as np
import pytest

from gva_mi.subject.footage import first_number, frames_named

# Names of six pictures, or None: a video file has none.
UNNAMED, NAMED = None, [f"shot_{k}.png" for k in range(8, 14)]
CASES = {"from 0, as WHAM": ([0, 1, 5], 0, UNNAMED, 0),
    "from 0, the first frames without anybody": ([1, 2, 3], 0, UNNAMED, 0),
    "from 1, as HybrIK, nobody in the last": ([1, 2, 5], 1, UNNAMED, 1),
    "from 1, as SMPLer-X": ([1, 2, 3, 6], 1, UNNAMED, 1),
    "HybrIK's, but numbered from 0": ([0, 1, 2], 1, UNNAMED, 0),
    "from 1, by counts": ([2, 6], 0, UNNAMED, 1),
    "from 0, since 1 does not fit": ([0, 5], 1, UNNAMED, 0),
    "by the pictures' names": ([9, 10], None, NAMED, 8),
    "not by the pictures' names": ([0, 1, 2], None, NAMED, 0),
    "as many as pictures": ([100, 105], 0, UNNAMED, 100), "in no way": ([100, 104], 0, UNNAMED, 0),
    "too many": ([0, 6], 0, UNNAMED, 0)}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_first_number_is_inferred(name):
    frames, usual, pictures, wanted = CASES[name]
    assert first_number(np.array(frames), 6, usual, pictures) == wanted


def test_the_frame_is_the_number_that_differs():
    """Whether other numbers stand before it, as ROMP names pictures of ``take2``, or behind."""
    for names in (
        ["take2_000007.png", "take2_000011.png"], ["7_v3.pkl", "11_v3.pkl"], ["a/7", "b/11"],
        ["2024_7", "2025_11"],
    ):  # fmt: skip
        assert frames_named(names).tolist() == [7, 11]
    assert frames_named(["x_5"]).tolist() == [5] and frames_named(["3_1", "3_1"]).tolist() == [1, 1]
    with pytest.raises(ValueError, match="no number in the name 'x'"):
        frames_named(["x"])
