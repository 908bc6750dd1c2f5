"""The pictures of a video at an even rate: which, how many, how large, in which order."""

import numpy as np
import pytest
from PIL import Image
from samples.recordings import write_recording

from gva_mi.core.errors import InputError
from gva_mi.stage1.pictures import even_pictures

HEIGHT, WIDTH = 48, 64


def shown(k):
    """A picture whose grey tells its number."""
    return np.full((HEIGHT, WIDTH, 3), 8 + 4 * k, np.uint8)


def number(picture):
    return round((float(picture.mean()) - 8) / 4)


def recording(path, moments, codec="libx264", tick=1000, kind="yuv420p"):
    """Write pictures shown at moments, seconds."""
    options = {"crf": "1", "x265-params": "log-level=none:lossless=1"}
    times, shots = [round(x * tick) for x in moments], map(shown, range(len(moments)))
    return write_recording(path, shots, codec, kind, options, rate=30, times=times, tick=tick)


def numbers(found):
    return [number(picture) for picture in found.pictures]


@pytest.mark.parametrize("name, codec, kind",
    [("a.mp4", "libx264", "yuv420p"), ("a.mov", "libx265", "yuv420p10le"),
    ("a.avi", "mjpeg", "yuvj420p"), ("a.webm", "libvpx-vp9", "yuv420p"),
    ("a.gif", "gif", "gray")])  # fmt: skip
def test_every_picture_of_an_even_video_in_order(name, codec, kind, tmp_path):
    tick = 25 if name.endswith("avi") else 100
    found = even_pictures(
        recording(tmp_path / name, np.arange(20) / 25, codec, tick=tick, kind=kind)
    )
    assert numbers(found) == list(range(20))
    assert found.fps == pytest.approx(25, rel=0.01) and found.notes == ()
    assert found.focal35 is None and found.pictures[0].shape == (HEIGHT, WIDTH, 3)


def test_a_fast_video_is_thinned(tmp_path):
    path = recording(tmp_path / "a.mp4", np.arange(60) / 60, tick=60)
    found = even_pictures(path)
    assert found.fps == pytest.approx(30) and numbers(found) == list(range(0, 60, 2))
    assert found.numbers == tuple(range(0, 60, 2)) and found.scale == 1
    assert found.notes == ("of 60 pictures a second one in 2 is used",)
    small = even_pictures(path, side=24)
    assert small.pictures[1].shape == (24, 32, 3) and small.scale == 0.5
    assert numbers(even_pictures(path, fps=15)) == list(range(0, 60, 4))
    assert numbers(even_pictures(path, fps=60, end=0.5)) == list(range(31))


def test_a_varying_rate_becomes_even(tmp_path):
    """30 a second in good light, 15 in the dark: the time of a picture counts, not its number."""
    moments = [*(np.arange(30) / 30), *(1 + np.arange(15) / 15)]
    found = even_pictures(recording(tmp_path / "a.mp4", moments, tick=600))
    assert found.fps == pytest.approx(30) and len(found.notes) == 1 and "varies" in found.notes[0]
    assert 57 <= len(found.pictures) <= 59
    at = np.array(moments)[numbers(found)]
    assert np.abs(at - np.arange(len(at)) / 30).max() <= 1 / 30 + 1e-6
    # Moments in whole milliseconds are not a rate that varies.
    even = even_pictures(recording(tmp_path / "b.mp4", np.round(np.arange(30) / 30, 3)))
    assert even.notes == () and len(even.pictures) == 30


def test_a_folder_in_natural_order_turned_upright(tmp_path):
    for k in (10, 2, 1):
        picture = Image.fromarray(shown(k)[:, :32])
        tags = picture.getexif()
        tags[0x0112] = 6
        tags.get_ifd(0x8769)[41989] = 26
        picture.save(tmp_path / f"frame_{k}.png", exif=tags)
    found = even_pictures(tmp_path, fps=12)
    assert numbers(found) == [1, 2, 10] and found.fps == pytest.approx(12)
    assert found.pictures[0].shape == (32, HEIGHT, 3) and found.focal35 == 26
    assert "no times" in even_pictures(tmp_path).notes[0]
    Image.fromarray(shown(3)).save(tmp_path / "frame_3.png")
    with pytest.raises(InputError, match="several sizes"):
        even_pictures(tmp_path)


def test_what_is_no_video_is_refused_in_a_sentence(tmp_path):
    good = recording(tmp_path / "a.mp4", np.arange(20) / 25)
    (tmp_path / "cut.mp4").write_bytes(good.read_bytes()[:-200])
    (tmp_path / "words.mp4").write_text("no video at all")
    (tmp_path / "empty").mkdir()
    for name, words in {
        "cut.mp4": "cannot be decoded as a video", "words.mp4": "cannot be decoded as a video",
        "empty": "holds no pictures",
        "missing.mp4": "no such file",
    }.items():  # fmt: skip
        with pytest.raises(InputError, match=words) as caught:
            even_pictures(tmp_path / name)
        assert name in str(caught.value)
