"""Videos as phones and cameras write them, and masks that are refused."""

import json
import shutil
import zipfile

import av
import numpy as np
import pytest
from PIL import Image
from samples.data_sets import MASK, shots
from samples.estimates import dumped, named
from samples.recordings import write_recording

from gva_mi import InputError
from gva_mi.core.files import read_arrays
from gva_mi.core.pickles import read_objects
from gva_mi.core.stamp import stamp
from gva_mi.evaluate.scores import numbered
from gva_mi.readers.estimators import VideoInfo, read_estimator
from gva_mi.readers.keypoints import read_keypoints
from gva_mi.stage1.pictures import even_pictures
from gva_mi.subject.footage import count_of, masks, notes_of, pictures
from gva_mi.subject.masks import read_mask
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video
from gva_mi.subject.video_file import VideoFile

SIZE = (32, 48)  # H, W
# The first four numbers of a track's matrix, 16.16 fixed point: x' = a x + c y, y' = b x + d y.
# The rotations of a phone, and the same mirrored, as front cameras write them.
MATRICES = [(1, 0, 0, 1), (0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0), (-1, 0, 0, 1),
    (1, 0, 0, -1), (0, 1, 1, 0), (0, -1, -1, 0)]  # fmt: skip


def shown(k=0):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([x * 4 + k, y * 6 + k, 0 * x + 20 + 5 * k], axis=-1).astype(np.uint8)


def recording(path, count=4, codec="libx264rgb", form="rgb24", moments=None, aspect=1):
    """Pictures without loss, at so many milliseconds each."""
    times, options = moments or range(0, 40 * count, 40), {"crf": "0", "g": "12"}
    shots = map(shown, range(count))
    return write_recording(path, shots, codec, form, options, times=times, aspect=aspect)


def turn(path, matrix):
    """Patch the matrix of the track's header (36 bytes), as a phone writes it that is held so."""
    data = bytearray(path.read_bytes())
    start = data.index(b"tkhd") + 4 + 40  # version 0: 40 bytes come before
    assert data[start - 40] == 0
    a, b, c, d = (x << 16 for x in matrix)
    rows = [(a, b, 0), (c, d, 0), (0, 0, 1 << 30)]
    data[start : start + 36] = b"".join(
        x.to_bytes(4, "big", signed=True) for row in rows for x in row
    )
    path.write_bytes(data)


def moved(image, matrix):
    """Move each pixel by the matrix, one by one."""
    a, b, c, d = matrix
    height, width = image.shape[:2]
    at = [(a * x + c * y, b * x + d * y) for y in range(height) for x in range(width)]
    x, y = (np.array(at) - np.min(at, axis=0)).T
    result = np.zeros((y.max() + 1, x.max() + 1, *image.shape[2:]), image.dtype)
    result[y, x] = image.reshape(height * width, *image.shape[2:])
    return result


@pytest.mark.parametrize("matrix", MATRICES)
def test_a_video_is_rotated_and_mirrored_as_its_metadata_say(matrix, tmp_path):
    path = recording(tmp_path / "video.mp4")
    turn(path, matrix)
    expected = [moved(shown(k), matrix) for k in range(4)]
    for found in (list(pictures(path, 3)), list(VideoFile(path)), even_pictures(path).pictures):
        assert len(found) == 4
        for image, wanted in zip(found, expected, strict=True):
            assert image.shape == wanted.shape and np.array_equal(image, wanted)
    bare = VideoFile(path, kept=0)
    assert bare.sizes == [expected[0].shape[1::-1]] * 4
    assert np.array_equal(bare[2], expected[2]) and np.array_equal(bare[1], expected[1])
    mask = next(masks(recording(tmp_path / "plain.mp4", codec="libx264", form="gray")))
    turn(tmp_path / "plain.mp4", matrix)
    assert np.array_equal(next(masks(tmp_path / "plain.mp4")), moved(mask, matrix))


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
    (note,) = notes_of(squeezed)
    assert "pixels are 1.33 times as wide as high" in note
    assert notes_of(recording(tmp_path / "a.mp4", 2)) == notes_of((tmp_path / "a.png",)) == []


@pytest.mark.parametrize("codec", ["libx264", "mpeg2video"])
def test_an_interlaced_video_is_said(codec, tmp_path):
    """Cameras of broadcast write two moments into each picture."""
    options = {"x264-params": "tff=1:interlaced=1", "flags": "+ildct+ilme", "top": "1"}
    path = write_recording(tmp_path / "a.mkv", map(shown, range(4)), codec, options=options)
    (note,) = notes_of(path)
    assert "interlaced (4 of 4 pictures)" in note and "bwdif" in note


def test_a_varying_rate_is_reported_and_every_picture_is_a_frame(tmp_path):
    moments = [0, 33, 66, 100, 250, 283]
    uneven = recording(tmp_path / "uneven.mp4", 6, moments=moments)
    for found in (list(pictures(uneven, 3)), list(VideoFile(uneven))):
        assert len(found) == 6
        assert all(np.array_equal(image, shown(k)) for k, image in enumerate(found))
    assert "rate varies: its pictures are 33 to 150 ms apart" in notes_of(uneven)[0]
    even = recording(tmp_path / "even.mkv", 6, moments=[0, 33, 67, 100, 133, 167])  # 30 a second
    assert notes_of(even) == []
    between = recording(tmp_path / "b.mp4", 12, "libx264", "yuv420p")  # decoded out of order
    assert notes_of(between) == notes_of(recording(tmp_path / "a.mp4", 1)) == []
    (tmp_path / "a.mp4").write_bytes(b"none")
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        notes_of(tmp_path / "a.mp4")


@pytest.mark.parametrize("names, number",
    [(["frame_1.png", "frame_01.jpg", "frame_2.png"], 1),
    (["1_color.png", "1_mask.png", "2_color.png"], 1),
    (["shot 7 (copy 2).png", "shot 8.png", "shot 2.png"], 2)])  # fmt: skip
def test_two_pictures_of_one_frame_are_refused(names, number, tmp_path):
    for name in names:
        Image.fromarray(shown()).save(tmp_path / name)
    for read in (count_of, lambda folder: list(pictures(folder, 3)), even_pictures, numbered):
        with pytest.raises(InputError, match=rf"has the number {number}, as .*; expected one file"):
            read(tmp_path)


def test_pictures_are_in_the_order_of_the_number_that_differs(tmp_path):
    """The last one that does: a version, or a camera, has the same number in all names."""
    for k in (10, 9, 11):
        Image.fromarray(shown(k)).save(tmp_path / f"walk{k}_v3.png")
    found = list(pictures(tmp_path, 3))
    assert all(np.array_equal(image, shown(k)) for image, k in zip(found, (9, 10, 11), strict=True))
    assert list(numbered(tmp_path)) == [9, 10, 11]


MACS = bytes.fromhex("00051607")  # the beginning of a file that macOS writes beside each of ours


def test_hidden_files_are_no_pictures_masks_poses_or_parts(tmp_path, seen, subject):
    """``._NAME`` in a folder that was copied from a Mac changes nothing, wherever it lies."""
    shutil.copytree(subject, tmp_path / "subject")
    for k, shot in enumerate(shots()):
        write_image(tmp_path / f"shots/{k:04d}.png", shot)
        write_image(tmp_path / f"masks/{k:06d}.png", MASK)
        (tmp_path / "arrays").mkdir(exist_ok=True)
        np.save(tmp_path / f"arrays/{k}.npy", MASK > 0)
        person = {name: x[min(k, len(x) - 1)] for name, x in named(*seen).items()}
        dumped(tmp_path / f"poses/{k}.pkl", person | {"focal": 70.0})
        (tmp_path / "keypoints").mkdir(exist_ok=True)
        points = {"people": [{"pose_keypoints_2d": [1.0] * 75}]}
        (tmp_path / f"keypoints/{k}.json").write_text(json.dumps(points))
    read = {
        "pictures": lambda: list(pictures(tmp_path / "shots", 3)),
        "masks": lambda: [*masks(tmp_path / "masks"), *masks(tmp_path / "arrays")],
        "mask": lambda: read_mask(tmp_path / "masks", 2),
        "poses": lambda: read_estimator("auto", tmp_path / "poses", VideoInfo((64, 48)))[1][0].K,
        "keypoints": lambda: sorted(read_keypoints(tmp_path / "keypoints")),
        "subject": lambda: len(load_video(tmp_path / "subject")),
        "stamp": lambda: [stamp([tmp_path / "subject"])],
    }
    before = {name: reading() for name, reading in read.items()}
    for path in [path for path in tmp_path.rglob("*") if path.is_file()]:
        path.with_name(f"._{path.name}").write_bytes(MACS)
    for name, reading in read.items():
        assert np.array_equal(reading(), before[name]), name
    np.savez(tmp_path / "a.npz", x=np.ones(2))
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive:
        archive.writestr("__MACOSX/._x.npy", MACS)
    for found in (read_arrays(tmp_path / "a.npz", "x"), read_objects(tmp_path / "a.npz", "x")):
        assert list(found) == ["x"]


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
