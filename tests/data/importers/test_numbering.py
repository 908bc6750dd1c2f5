"""The number of the first frame: by program, by the pictures' names, by counts."""

import numpy as np
import pytest

from gva_mi.data.importers.footage import first_number, frames_named

FILM, NAMED = None, [f"shot_{k}.png" for k in range(8, 14)]  # six pictures
CASES = {
    "from 0, as WHAM": ([0, 1, 5], 0, FILM, 0),
    "from 0, the first frames without anybody": ([1, 2, 3], 0, FILM, 0),
    "from 1, as HybrIK, nobody in the last": ([1, 2, 5], 1, FILM, 1),
    "from 1, as SMPLer-X": ([1, 2, 3, 6], 1, FILM, 1),
    "HybrIK's, but numbered from 0": ([0, 1, 2], 1, FILM, 0),
    "from 1, by counts": ([2, 6], 0, FILM, 1),
    "from 0, since 1 does not fit": ([0, 5], 1, FILM, 0),
    "by the pictures' names": ([9, 10], None, NAMED, 8),
    "not by the pictures' names": ([0, 1, 2], None, NAMED, 0),
    "as many as pictures": ([100, 105], 0, FILM, 100),
    "in no way": ([100, 104], 0, FILM, 0),
    "too many": ([0, 6], 0, FILM, 0),
}  # fmt: skip


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


def test_a_file_a_frame_follows_the_pictures_names(tmp_path, cli, walk, footage):
    """Files 9 to 12 belong to the pictures 9 to 12 of 8 to 12, and it is said."""
    rotations, _ = walk(4)
    for k in range(4):
        place = np.array([0.1 * k, -0.3, 4.0])
        (tmp_path / "out").mkdir(exist_ok=True)
        np.savez(tmp_path / f"out/{k + 9}.npz", global_orient=rotations[k, :1], transl=place[None],
                 body_pose=rotations[k, 1:22].reshape(1, 63))  # fmt: skip
    given = ("prepare", "parameters", tmp_path / "out", tmp_path / "s", *footage, "--lens", 70)
    assert "numbered from 8" in cli.works(*given)
    x = np.load(tmp_path / "s/poses.npz")["transl"][:, 0]
    assert np.allclose(np.diff(x)[1:4], 0.1, atol=1e-5)
