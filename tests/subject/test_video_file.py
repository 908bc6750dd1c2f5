"""A video gives the same pictures in any order, kept in memory or not."""

import pickle

import av
import numpy as np
import pytest

from gva_mi.core.errors import InputError
from gva_mi.subject.video_file import VideoFile, write_video

COUNT, SIZE = 40, (24, 32)
SOME = 1 << 15  # bytes: of some pictures, not of all


def shown(k):
    """A picture that no other is like."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([x * 4 + k, y * 5 + 2 * k, 0 * x + 6 * k], axis=-1).astype(np.uint8)


@pytest.fixture(params=["lossless", "between", "no moments"])
def path(request, tmp_path):
    """All pictures alone; pictures between others, and key pictures every twelve; a bare stream."""
    path = tmp_path / "video.mp4"
    if request.param == "lossless":
        write_video(path, (shown(k) for k in range(COUNT)))
        return path
    path = path if request.param == "between" else tmp_path / "video.h264"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = SIZE[1], SIZE[0], "yuv420p"
        stream.options = {"g": "12", "bf": "3", "crf": "5"}
        for k in range(COUNT):
            picture = av.VideoFrame.from_ndarray(shown(k), "rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def test_pictures_are_the_same_in_any_order_and_memory(path):
    whole = VideoFile(path)
    assert len(whole) == COUNT and whole.sizes == [SIZE[::-1]] * COUNT
    images = list(whole)
    for k, image in enumerate(images):  # not the neighbours'
        off = [np.abs(image.astype(int) - shown(j)).mean() for j in range(COUNT)]
        assert int(np.argmin(off)) == k
    order = np.random.default_rng(0).permutation(COUNT).tolist()
    for kept in (0, SOME):
        recording = VideoFile(path, kept)
        assert len(recording) == COUNT
        for k in [*range(COUNT), *order, 39, 39, 0, 0, 1, 13, 11, 12, -1]:
            assert np.array_equal(recording[k], images[k]), (kept, k)
        again = pickle.loads(pickle.dumps(recording))
        assert np.array_equal(again[17], images[17]) and np.array_equal(recording[18], images[18])
        with pytest.raises(IndexError):
            recording[COUNT]


def test_writing_into_a_picture_does_not_change_the_video(tmp_path):
    path = tmp_path / "video.mov"
    with av.open(str(path), "w") as container:  # decoded to RGB, so that nothing is converted
        stream = container.add_stream("png", rate=25)
        stream.width, stream.height, stream.pix_fmt = SIZE[1], SIZE[0], "rgb24"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(shown(3), "rgb24")))
        container.mux(stream.encode())
    recording = VideoFile(path)
    recording[0][:] = 0
    assert np.array_equal(recording[0], shown(3))


@pytest.fixture
def decoded(monkeypatch):
    """The moments of all pictures that are decoded, again and again."""
    moments, through = [], VideoFile._decoded
    monkeypatch.setattr(
        VideoFile, "_decoded",
        lambda self, c: (moments.append(f.pts) or f for f in through(self, c)),
    )  # fmt: skip
    return moments


def test_reading_forward_decodes_no_picture_twice(path, decoded):
    """In order, and in leaps between key pictures: at most those from one key picture on."""
    recording = VideoFile(path, kept=0)
    decoded.clear()
    list(recording)
    assert len(decoded) == COUNT
    short = VideoFile(path)  # all of it stays in memory
    decoded.clear()
    for k in np.random.default_rng(0).permutation(COUNT):
        short[k]
    assert not decoded
    if path.suffix == ".mp4":
        decoded.clear()
        recording[30]
        assert len(decoded) <= 12 + 1


def test_a_damaged_video_is_refused(tmp_path):
    path = tmp_path / "video.mp4"
    write_video(path, (shown(k) for k in range(COUNT)))
    recording = VideoFile(path, kept=0)
    path.write_bytes(b"no video at all" * 10)
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        recording[3]
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        VideoFile(path)


def litter(seed):
    """Freed memory of many sizes that is not zero: what an encoder must not look at."""
    rng = np.random.default_rng(seed)
    sizes = [50, 100, 200, 400, 800, 1500, 3000, 5000, 10_000, 20_000, 60_000, 100_000] * 60
    kept = [rng.integers(0, 256, size=size, dtype=np.uint8) for size in sizes]
    del kept[::2]
    return kept


@pytest.mark.parametrize("way", ["lossless", "playable"])
def test_equal_pictures_give_equal_videos_to_the_bit(way, tmp_path):
    patch = np.random.default_rng(0).integers(0, 255, (20, 12, 3), dtype=np.uint8)
    pictures = np.full((4, 48, 32, 3), 255, np.uint8)
    for k, picture in enumerate(pictures):
        picture[14:34, 6 + 2 * k : 18 + 2 * k] = patch
    recordings = set()
    for seed in range(12):
        kept = litter(seed)
        write_video(tmp_path / "video", pictures, way=way)
        recordings.add((tmp_path / "video").read_bytes())
        del kept
    assert len(recordings) == 1
