"""The contact sheet."""

import numpy as np
import pytest

from gva_mi.data.pictures import read_image
from gva_mi.synthetic import contact_sheet as module

pytest.importorskip("mitsuba")


def test_rows_are_cropped_to_their_content():
    picture = np.ones((40, 30, 3), np.float32)
    picture[10:20, 12:18] = 0.5
    rows = [[picture] * module.COLUMNS] * 2
    canvas = module._laid_out(rows, [["one"], []], 24)
    assert canvas.shape[1] == module.COLUMNS * (24 + module.GAP) - module.GAP
    assert canvas.shape[0] == module.CAPTION + 2 * (10 + module.GAP)
    assert np.isclose(canvas[module.CAPTION : module.CAPTION + 10, 9:15], 0.5).all()


@pytest.mark.slow
def test_a_sheet_is_a_small_file(body, tmp_path):
    seen = []
    module.contact_sheet(
        tmp_path / "sheet.png", body, size=64, samples=4,
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    image = read_image(tmp_path / "sheet.png", 3)
    assert image.shape[1] == 7 * (64 + module.GAP) - module.GAP and image.std() > 20
    assert (tmp_path / "sheet.png").stat().st_size < 1_200_000
    assert seen[-1] == (8, 8)
