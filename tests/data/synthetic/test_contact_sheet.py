"""The contact sheet's layout, and the whole of it."""

import errno
import resource

import numpy as np
import pytest

from gva_mi.body.smplx import load_body
from gva_mi.data.pictures import read_image
from gva_mi.data.synthetic import contact_sheet as module

pytest.importorskip("mitsuba")


def test_rows_lose_the_white_above_and_below_them():
    picture = np.ones((40, 30, 3), np.float32)
    picture[10:20, 12:18] = 0.5
    rows = [[picture] * module.COLUMNS] * 2
    canvas = module._laid_out(rows, [["one"], []], 24)
    assert canvas.shape[1] == module.COLUMNS * (24 + module.GAP) - module.GAP
    assert canvas.shape[0] == module.CAPTION + 2 * (10 + module.GAP)
    assert np.isclose(canvas[module.CAPTION : module.CAPTION + 10, 9:15], 0.5).all()


@pytest.mark.slow
def test_a_sheet_is_a_small_file(tmp_path):
    seen = []
    module.contact_sheet(
        tmp_path / "sheet.png", load_body(), size=64, samples=4,
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    image = read_image(tmp_path / "sheet.png", 3)
    assert image.shape[1] == 7 * (64 + module.GAP) - module.GAP and image.std() > 20
    assert (tmp_path / "sheet.png").stat().st_size < 1_200_000
    assert seen[-1] == (8, 8)


@pytest.mark.slow
def test_a_full_disk_leaves_the_older_sheet_and_the_next_one_removes_what_a_kill_left(
    tmp_path, monkeypatch
):
    """The disk that the sheet is on is the one that fills up, whatever is written on the way."""
    plain = np.full((30, 24, 3), 0.5, np.float32)
    monkeypatch.setattr(module, "_portrait_front_pose", lambda *_: [plain] * 3)
    monkeypatch.setattr(module, "draw_subject", lambda *_: None)
    path, left = tmp_path / "sheet.png", tmp_path / ".sheet.png.gva-mi-part/amira/frames"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for room in (100, 2000):
        path.write_text("older")
        left.mkdir(parents=True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
        try:
            with pytest.raises(OSError) as error:
                module.contact_sheet(path, load_body(), size=24, samples=1)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert error.value.errno == errno.EFBIG
        assert str(error.value.filename).startswith(str(tmp_path))
        assert list(tmp_path.iterdir()) == [path] and path.read_text() == "older"
    module.contact_sheet(path, load_body(), size=24, samples=1)
    assert read_image(path, 3).std() > 20 and list(tmp_path.iterdir()) == [path]
