"""A film gives the same pictures in any order, kept in memory or not."""

import pickle

import av
import numpy as np
import pytest

from gva_mi.core.errors import InputError
from gva_mi.data.film import Film, write_film

COUNT, SIZE = 40, (24, 32)
SOME = 1 << 15  # bytes: of some pictures, not of all


def shown(k):
    """A picture that no other is like."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([x * 4 + k, y * 5 + 2 * k, 0 * x + 6 * k], axis=-1).astype(np.uint8)


@pytest.fixture(params=["lossless", "between", "no moments"])
def path(request, tmp_path):
    """All pictures alone; pictures between others, and key pictures every twelve; a bare stream."""
    path = tmp_path / "film.mp4"
    if request.param == "lossless":
        write_film(path, (shown(k) for k in range(COUNT)))
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


def test_pictures_are_the_same_in_any_order_and_memory(path):
    whole = Film(path)
    assert len(whole) == COUNT and whole.sizes == [SIZE[::-1]] * COUNT
    images = list(whole)
    for k, image in enumerate(images):  # not the neighbours'
        off = [np.abs(image.astype(int) - shown(j)).mean() for j in range(COUNT)]
        assert int(np.argmin(off)) == k
    order = np.random.default_rng(0).permutation(COUNT).tolist()
    for kept in (0, SOME):
        film = Film(path, kept)
        assert len(film) == COUNT
        for k in [*range(COUNT), *order, 39, 39, 0, 0, 1, 13, 11, 12, -1]:
            assert np.array_equal(film[k], images[k]), (kept, k)
        again = pickle.loads(pickle.dumps(film))
        assert np.array_equal(again[17], images[17]) and np.array_equal(film[18], images[18])
        with pytest.raises(IndexError):
            film[COUNT]


def test_writing_into_a_picture_does_not_change_the_film(tmp_path):
    path = tmp_path / "film.mov"
    with av.open(str(path), "w") as container:  # decoded to RGB, so that nothing is converted
        stream = container.add_stream("png", rate=25)
        stream.width, stream.height, stream.pix_fmt = SIZE[1], SIZE[0], "rgb24"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(shown(3), "rgb24")))
        container.mux(stream.encode())
    film = Film(path)
    film[0][:] = 0
    assert np.array_equal(film[0], shown(3))


@pytest.fixture
def decoded(monkeypatch):
    """The moments of all pictures that are decoded, again and again."""
    moments, through = [], Film._decoded
    monkeypatch.setattr(
        Film, "_decoded",
        lambda self, c: (moments.append(f.pts) or f for f in through(self, c)),
    )  # fmt: skip
    return moments


def test_reading_forward_decodes_no_picture_twice(path, decoded):
    """In order, and in leaps between key pictures: at most those from one key picture on."""
    film = Film(path, kept=0)
    decoded.clear()
    list(film)
    assert len(decoded) == COUNT
    short = Film(path)  # all of it stays in memory
    decoded.clear()
    for k in np.random.default_rng(0).permutation(COUNT):
        short[k]
    assert not decoded
    if path.suffix == ".mp4":
        decoded.clear()
        film[30]
        assert len(decoded) <= 12 + 1


def test_a_damaged_film_is_refused(tmp_path):
    path = tmp_path / "film.mp4"
    write_film(path, (shown(k) for k in range(COUNT)))
    film = Film(path, kept=0)
    path.write_bytes(b"no film at all" * 10)
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        film[3]
    with pytest.raises(InputError, match="cannot be decoded as a video"):
        Film(path)


def litter(seed):
    """Freed memory of many sizes that is not zero: what an encoder must not look at."""
    rng = np.random.default_rng(seed)
    sizes = [50, 100, 200, 400, 800, 1500, 3000, 5000, 10_000, 20_000, 60_000, 100_000] * 60
    kept = [rng.integers(0, 256, size=size, dtype=np.uint8) for size in sizes]
    del kept[::2]
    return kept


@pytest.mark.parametrize("way", ["lossless", "playable"])
def test_equal_pictures_give_equal_films_to_the_bit(way, tmp_path):
    patch = np.random.default_rng(0).integers(0, 255, (20, 12, 3), dtype=np.uint8)
    pictures = np.full((4, 48, 32, 3), 255, np.uint8)
    for k, picture in enumerate(pictures):
        picture[14:34, 6 + 2 * k : 18 + 2 * k] = patch
    films = set()
    for seed in range(12):
        kept = litter(seed)
        write_film(tmp_path / "film", pictures, way=way)
        films.add((tmp_path / "film").read_bytes())
        del kept
    assert len(films) == 1
