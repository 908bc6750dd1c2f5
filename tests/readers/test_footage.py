"""Videos as phones and cameras write them, and masks that are refused."""

from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image

from gva_mi import InputError
from gva_mi.subject.footage import masks, pictures, uneven_pixels, uneven_rate
from gva_mi.subject.video_file import VideoFile

SIZE = (32, 48)  # H, W
MATRIX = {  # the first four numbers of a track's matrix, 16.16 fixed point: clockwise degrees
    0: (1, 0, 0, 1), 90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0),
}  # fmt: skip


def shown(k=0):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([x * 4 + k, y * 6 + k, 0 * x + 20 + 5 * k], axis=-1).astype(np.uint8)


def recording(path, count=4, codec="libx264rgb", form="rgb24", moments=None, key=12, aspect=1):
    """Pictures without loss, at so many milliseconds each."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = SIZE[1], SIZE[0], form
        stream.options = {"crf": "0", "g": str(key)}
        stream.codec_context.time_base = Fraction(1, 1000)
        stream.codec_context.sample_aspect_ratio = Fraction(aspect)
        for k in range(count):
            picture = av.VideoFrame.from_ndarray(shown(k), "rgb24")
            picture.pts = 40 * k if moments is None else moments[k]
            picture.time_base = stream.codec_context.time_base
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def turn(path, degrees):
    """Patch the matrix of the track's header (36 bytes), as a phone writes it that is held so."""
    data = bytearray(path.read_bytes())
    start = data.index(b"tkhd") + 4 + 40  # version 0: 40 bytes come before
    assert data[start - 40] == 0
    a, b, c, d = (x << 16 for x in MATRIX[degrees])
    rows = [(a, b, 0), (c, d, 0), (0, 0, 1 << 30)]
    data[start : start + 36] = b"".join(
        x.to_bytes(4, "big", signed=True) for row in rows for x in row
    )
    path.write_bytes(data)


@pytest.mark.parametrize("degrees", MATRIX)
def test_a_video_is_turned_as_its_metadata_say(degrees, tmp_path):
    path = recording(tmp_path / "video.mp4")
    turn(path, degrees)
    expected = [np.rot90(shown(k), -degrees // 90) for k in range(4)]
    for found in (list(pictures(path, 3)), list(VideoFile(path)), list(VideoFile(path, kept=0))):
        assert len(found) == 4
        for image, wanted in zip(found, expected, strict=True):
            assert image.shape == wanted.shape and np.array_equal(image, wanted)
    bare = VideoFile(path, kept=0)
    assert bare.sizes == [expected[0].shape[1::-1]] * 4
    assert np.array_equal(bare[2], expected[2]) and np.array_equal(bare[1], expected[1])
    mask = next(masks(recording(tmp_path / "plain.mp4", codec="libx264", form="gray")))
    turn(tmp_path / "plain.mp4", degrees)
    assert np.array_equal(next(masks(tmp_path / "plain.mp4")), np.rot90(mask, -degrees // 90))


def test_ten_bits_are_read_as_eight(tmp_path):
    path = recording(tmp_path / "video.mp4", codec="libx264", form="yuv420p10le")
    with av.open(str(path)) as container:
        assert container.streams.video[0].pix_fmt == "yuv420p10le"
    for found in (list(pictures(path, 3)), list(VideoFile(path))):
        assert [image.dtype for image in found] == [np.uint8] * 4
        for k, image in enumerate(found):  # 4:2:0 halves the colour's resolution
            off = np.abs(image[2:-2, 2:-2].astype(int) - shown(k)[2:-2, 2:-2])
            assert off.max() <= 8 and off.mean() < 3


def test_pixels_that_are_not_square_are_said(tmp_path):
    squeezed = recording(tmp_path / "wide.mp4", 2, codec="libx264", form="yuv420p", aspect="4/3")
    assert "pixels are 1.33 times as wide as high" in uneven_pixels(squeezed)
    assert (
        uneven_pixels(recording(tmp_path / "a.mp4", 2)) is None and uneven_pixels(tmp_path) is None
    )


def test_a_varying_rate_is_reported_and_every_picture_is_a_frame(tmp_path):
    moments = [0, 33, 66, 100, 250, 283]
    uneven = recording(tmp_path / "uneven.mp4", 6, moments=moments)
    for found in (list(pictures(uneven, 3)), list(VideoFile(uneven))):
        assert len(found) == 6
        assert all(np.array_equal(image, shown(k)) for k, image in enumerate(found))
    assert "rate varies: its pictures are 33 to 150 ms apart" in uneven_rate(uneven)
    even = recording(tmp_path / "even.mkv", 6, moments=[0, 33, 67, 100, 133, 167])  # 30 a second
    assert uneven_rate(even) is None
    between = recording(
        tmp_path / "b.mp4", 12, codec="libx264", form="yuv420p"
    )  # decoded out of order
    assert uneven_rate(between) is None and uneven_rate(recording(tmp_path / "a.mp4", 1)) is None
    (tmp_path / "a.mp4").write_bytes(b"none")
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        uneven_rate(tmp_path / "a.mp4")


@pytest.fixture
def estimate(tmp_path, wham, seen):
    """What of ``prepare`` is always given."""
    return ["prepare", "wham", wham(_0=seen), tmp_path / "s", "--body", "built-in"]


INSIDE = np.zeros((48, 64), np.uint8)
INSIDE[10:40, 20:40] = 1
NONE = {
    "labels of others": (
        INSIDE[:, ::-1] + 2 * INSIDE[::-1] * (1 - INSIDE[:, ::-1]) * (1 - INSIDE),
        "the masks hold the labels 0-2, and which one is the person is unknown",
    ),
    "dim": (np.add.outer(np.arange(48), np.arange(64)).astype("u1"), "the largest value is 110;"),
    "empty": (INSIDE * 0, "no pixel of any mask is above half, the largest value is 0"),
    "full": (INSIDE * 0 + 255, "every pixel of every mask is inside"),
}


@pytest.mark.parametrize("name", NONE)
def test_masks_of_labels_or_of_one_value_are_refused(name, tmp_path, cli, estimate, footage):
    values, words = NONE[name]
    (tmp_path / "labels").mkdir()
    for k in range(5):
        Image.fromarray(values).save(tmp_path / f"labels/{k}.png")
    np.save(tmp_path / "labels.npy", np.stack([values] * 5).astype(np.int64))
    for given in (tmp_path / "labels", tmp_path / "labels.npy"):
        err = cli.fails(*estimate, *footage[2:4], "--masks", given)
        assert f"{given}: " in err and words in err, err
        assert err.count("\n") <= 2 and not (tmp_path / "s").exists()
