"""A film's pictures in any order, kept in memory or not: the same ones."""

import pickle

import av
import numpy as np
import pytest

from gva_mi.data.film import Film
from gva_mi.data.pictures import write_movie
from gva_mi.errors import InputError

COUNT, SIZE = 40, (24, 32)


def shown(k):
    """A picture that no other is like."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([x * 4 + k, y * 5 + 2 * k, 0 * x + 6 * k], axis=-1).astype(np.uint8)


@pytest.fixture(params=["lossless", "between", "no moments"])
def path(request, tmp_path):
    """All pictures alone; pictures between others, and key pictures every twelve; a bare stream."""
    path = tmp_path / "film.mp4"
    if request.param == "lossless":
        write_movie(path, (shown(k) for k in range(COUNT)))
        return path
    path = path if request.param == "between" else tmp_path / "film.h264"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = SIZE[1], SIZE[0], "yuv420p"
        stream.options = {"g": "12", "bf": "3", "crf": "5"}
        for k in range(COUNT):
            picture = av.VideoFrame.from_ndarray(shown(k), "rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def test_in_any_order_and_with_any_memory_the_pictures_are_the_same(path):
    whole = Film(path)
    assert len(whole) == COUNT and whole.sizes == [SIZE[::-1]] * COUNT
    images = list(whole)
    for k, image in enumerate(images):  # not the neighbours'
        off = [np.abs(image.astype(int) - shown(j)).mean() for j in range(COUNT)]
        assert int(np.argmin(off)) == k
    bare = Film(path, kept=0)
    assert bare._images is None and len(bare) == COUNT
    order = np.random.default_rng(0).permutation(COUNT).tolist()
    for k in [*range(COUNT), *order, 39, 39, 0, 0, 1, 13, 11, 12, -1]:
        assert np.array_equal(bare[k], images[k]), k
    again = pickle.loads(pickle.dumps(bare))
    assert np.array_equal(again[17], images[17]) and np.array_equal(bare[18], images[18])
    with pytest.raises(IndexError):
        bare[COUNT]


def test_going_on_decodes_no_picture_twice(path, monkeypatch):
    """In order, and in leaps between key pictures: at most those from one key picture on."""
    film, decoded = Film(path, kept=0), []
    through = Film._decoded
    monkeypatch.setattr(
        Film, "_decoded",
        lambda self, c: (decoded.append(f.pts) or f for f in through(self, c)),
    )  # fmt: skip
    list(film)
    assert len(decoded) == COUNT
    if path.suffix == ".mp4":
        decoded.clear()
        film[30]
        assert len(decoded) <= 12 + 1


def test_a_film_that_is_cut_short_or_none_is_refused(tmp_path):
    path = tmp_path / "film.mp4"
    write_movie(path, (shown(k) for k in range(COUNT)))
    film = Film(path, kept=0)
    path.write_bytes(b"no film at all" * 10)
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        film[3]
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        Film(path)
