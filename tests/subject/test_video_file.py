"""Which pictures a video has; it gives the same ones in any order, kept in memory or not."""

import os
import pickle
import re
import struct

import av
import numpy as np
import pytest
from av.stream import Disposition
from PIL import Image
from samples.recordings import write_recording

from gva_mi.core.errors import InputError
from gva_mi.stage1.pictures import even_pictures
from gva_mi.subject import video_file
from gva_mi.subject.footage import count_of, pictures
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
    options = {"g": "12", "bf": "3", "crf": "5"}
    return write_recording(path, map(shown, range(COUNT)), options=options)


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
    path = write_recording(tmp_path / "video.mov", [shown(3)], "png", "rgb24")
    recording = VideoFile(path)  # decoded to RGB, so that nothing is converted
    recording[0][:] = 0
    assert np.array_equal(recording[0], shown(3))


@pytest.fixture
def decoded(monkeypatch):
    """The moments of all pictures that are decoded, again and again."""
    moments, through = [], video_file.decoded
    monkeypatch.setattr(
        video_file, "decoded",
        lambda *given, **named: (moments.append(f.pts) or f for f in through(*given, **named)),
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


def box(kind, *parts):
    """A box of QuickTime: its size, four letters, content."""
    return struct.pack(">I4s", 8 + sum(map(len, parts)), kind) + b"".join(parts)


def boxes(content):
    """The kind and the content of each box."""
    while content:
        size, kind = struct.unpack_from(">I4s", content)
        yield kind, content[8:size]
        content = content[size:]


def scrolled(path, codec, size, options, count=90):
    """Write a texture that moves, which no decoder can guess."""
    texture = np.random.default_rng(0).integers(0, 255, (size[0] // 8, 60, 3), dtype=np.uint8)
    texture = texture.repeat(8, axis=0).repeat(8, axis=1)
    shots = (np.ascontiguousarray(texture[:, 2 * k : 2 * k + size[1]]) for k in range(count))
    return write_recording(path, shots, codec, options=options, rate=30)


def indexed(path, count=12):
    """Write an .avi of greys by a palette, which decoders read at the start of the file alone."""
    height, width = SIZE
    palette = b"".join(struct.pack("4B", k, k, k, 0) for k in range(256))
    form = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 8, 0, width * height, 0, 0, 256, 0)
    head = struct.pack("<14I", 40_000, 0, 0, 16, count, 0, 1, 0, width, height, 0, 0, 0, 0)
    video = b"vidsDIB " + struct.pack(
        "<IHHIIIIIIII4H", *[0] * 4, 1, 25, 0, count, 0, 0, 0, *[0] * 4
    )
    part = lambda kind, data: kind + struct.pack("<I", len(data)) + data
    parts = lambda kind, *data: part(b"LIST", kind + b"".join(data))
    shots = [part(b"00db", bytes([20 * k + 10]) * (height * width)) for k in range(count)]
    at = np.cumsum([4, *map(len, shots[:-1])]).tolist()
    index = b"".join(b"00db" + struct.pack("<3I", 16, x, height * width) for x in at)
    lists = parts(b"strl", part(b"strh", video), part(b"strf", form + palette))
    lists = parts(b"hdrl", part(b"avih", head), lists), parts(b"movi", *shots), part(b"idx1", index)
    path.write_bytes(part(b"RIFF", b"AVI " + b"".join(lists)))
    return path


MISSED_BY_A_SEEK = {
    "refreshed block by block": lambda folder: scrolled(
        folder / "a.mp4", "libx264", (96, 128),
        {"x264-params": "intra-refresh=1:keyint=10:bframes=0"},
    ),
    "without an index": lambda folder: scrolled(
        folder / "a.mpg", "mpeg2video", (96, 128), {"g": "15", "bf": "2"}
    ),
    "palette": lambda folder: indexed(folder / "a.avi"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISSED_BY_A_SEEK)
def test_a_picture_is_the_same_where_a_seek_misses_what_its_decoder_needs(name, tmp_path):
    path = MISSED_BY_A_SEEK[name](tmp_path)
    with av.open(str(path)) as container:
        expected = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    if name == "palette":
        assert [picture.max() for picture in expected] == [20 * k + 10 for k in range(12)]
    found, count = VideoFile(path, kept=0), len(expected)
    order = np.random.default_rng(0).permutation(count).tolist()
    for k in [*range(count)[::-1], *order]:
        assert np.array_equal(found[k], expected[k]), k


def test_a_cover_picture_is_no_picture_of_the_video(tmp_path):
    """Tag editors write one; it may come before the video's own track."""
    written, first = tmp_path / "a.mp4", tmp_path / "first.mp4"
    with av.open(str(written), "w") as container:
        video, cover = (container.add_stream(x, rate=25) for x in ("libx264rgb", "mjpeg"))
        for stream, form in ((video, "rgb24"), (cover, "yuvj420p")):
            stream.height, stream.width, stream.pix_fmt = *SIZE, form
        video.options, cover.disposition = {"crf": "0"}, Disposition.attached_pic
        image = av.VideoFrame.from_ndarray(np.full((*SIZE, 3), 255, np.uint8), "rgb24")
        container.mux(cover.encode(image.reformat(format="yuvj420p")))
        container.mux(cover.encode())
        for k in range(COUNT):
            container.mux(video.encode(av.VideoFrame.from_ndarray(shown(k), "rgb24")))
        container.mux(video.encode())
    whole = b""
    for kind, content in boxes(written.read_bytes()):  # moov is the last: no offset moves
        if kind == b"moov":
            parts = sorted(boxes(content), key=lambda part: part[0] not in (b"mvhd", b"udta"))
            content = b"".join(box(*part) for part in parts)
        whole += box(kind, content)
    first.write_bytes(whole)
    for path, place in ((written, 1), (first, 0)):
        with av.open(str(path)) as container:
            assert container.streams.video[place].disposition & Disposition.attached_pic
        for found in (VideoFile(path), list(pictures(path, 3)), even_pictures(path).pictures):
            assert len(found) == COUNT == count_of(path)
            assert np.array_equal(found[3], shown(3))


def test_pictures_that_an_edit_list_hides_do_not_count(tmp_path):
    """As phones trim a video: pictures before the cut stay in the file, as others need them."""
    path, hidden = scrolled(tmp_path / "a.mp4", "libx264", SIZE, {"bf": "2"}, count=18), 6
    images = list(VideoFile(path))
    with av.open(str(path)) as container:
        step = round(1 / 30 / container.streams.video[0].time_base)
    data = bytearray(path.read_bytes())
    at = data.index(b"elst") + 12  # after version, flags and count: duration, first moment
    duration, begin = struct.unpack_from(">Ii", data, at)
    struct.pack_into(">Ii", data, at, duration * 12 // 18, begin + hidden * step)
    path.write_bytes(data)
    assert count_of(path) == len(VideoFile(path)) == 12
    for found in (list(pictures(path, 3)), even_pictures(path).pictures, VideoFile(path, kept=0)):
        for k in (11, 0, 5):
            assert np.array_equal(found[k], images[hidden + k])


def test_a_damaged_video_is_refused(tmp_path):
    path = tmp_path / "video.mp4"
    write_video(path, (shown(k) for k in range(COUNT)))
    recording = VideoFile(path, kept=0)
    path.write_bytes(b"no video at all" * 10)
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        recording[3]
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        VideoFile(path)


@pytest.mark.parametrize("options", [{"bf": "0"}, {"bf": "3"}])
def test_a_damaged_middle_is_named_and_may_be_left_out(options, tmp_path):
    path = scrolled(tmp_path / "a.mp4", "libx264", (96, 128), options, count=60)
    images = list(VideoFile(path))
    with av.open(str(path)) as container:  # from 1 s on
        packets = [packet for packet in container.demux(video=0) if packet.pts is not None]
        ticks = container.streams.video[0].time_base
        hit = next(packet for packet in packets if packet.pts * ticks >= 1)
        at, size, second = hit.pos, hit.size, float(hit.pts * ticks)
    data = bytearray(path.read_bytes())
    data[at : at + size] = bytes(size)
    path.write_bytes(data)
    words = (
        rf"a\.mp4: picture {round(second * 30)}, at {second:.2f} s, is damaged .*; --end (\S+) uses"
    )
    with pytest.raises(InputError, match=words) as caught:
        even_pictures(path)
    end = float(re.search(words, str(caught.value))[1])
    assert second - 0.3 < end < second
    found = even_pictures(path, end=end)
    assert len(found.pictures) == int(end * 30) + 1
    assert all(np.array_equal(x, y) for x, y in zip(found.pictures, images, strict=False))


@pytest.mark.parametrize("name, codec", [("a.mkv", "libx264"), ("a.webm", "libvpx")])
def test_a_file_that_ends_early_is_said(name, codec, tmp_path):
    """As a download that broke off: without an index, nothing in the file itself is damaged."""
    path = scrolled(tmp_path / name, codec, (96, 128), {}, count=60)
    assert VideoFile(path).notes == []
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
    (note,) = VideoFile(path).notes
    assert "the file lasts 2 s, but its pictures end at" in note


def test_a_last_picture_that_stays_is_no_file_that_ends_early(tmp_path):
    first, *others = (Image.fromarray(shown(k)) for k in range(4))
    times = [40, 40, 40, 3000]  # milliseconds
    first.save(tmp_path / "a.gif", save_all=True, append_images=others, duration=times)
    assert VideoFile(tmp_path / "a.gif").notes == []


def test_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "a.mp4")
    for read in (VideoFile, even_pictures, count_of, lambda path: next(pictures(path, 3))):
        with pytest.raises(InputError, match=r"a\.mp4: is a device or a pipe"):
            read(tmp_path / "a.mp4")


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
