"""The film of a phone: the pictures, with noise, at a phone's bit rate."""

from fractions import Fraction

import numpy as np

from gva_mi.data.film import Film
from gva_mi.synthetic.rooms.phone import BITS, write_phone_film


def test_a_film_shows_the_pictures_with_noise_and_always_the_same(tmp_path):
    y, x = np.mgrid[:96, :64]
    pictures = [
        np.stack([2 * x + 3 * k, 2 * y, 250 - 2 * y], axis=-1).astype(np.uint8) for k in range(20)
    ]
    files = []
    for name in ("a.mp4", "b.mp4"):
        write_phone_film(tmp_path / name, pictures, Fraction(40, 3), np.random.default_rng(0))
        files.append((tmp_path / name).read_bytes())
    assert files[0] == files[1]
    assert len(files[0]) < 3 * BITS / 8 * 96 * 64 * 20
    film = Film(tmp_path / "a.mp4")
    assert len(film) == 20
    for seen, true in zip(film, pictures, strict=True):
        off = seen.astype(int) - true
        assert np.abs(off.mean((0, 1))).max() < 3 and off.std() < 8
