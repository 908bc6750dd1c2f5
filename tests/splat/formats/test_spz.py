"""The .spz and .splat formats: the bytes that viewers expect, within the bounds of each number."""

import gzip
import struct

import numpy as np
import pytest
import torch
from samples.scenes import some_gaussians

from gva_mi.core.errors import InputError
from gva_mi.splat import Gaussians
from gva_mi.splat.formats.spz import plain_colors, save_splat, save_spz


def rows_of(path):
    """The header of a .spz, and the bytes of each stream, (N, n)."""
    content = gzip.decompress(path.read_bytes())
    *head, count, degree, bits, _, _ = struct.unpack("<IIIBBBB", content[:16])
    assert head == [0x5053474E, 3]
    widths = (9, 1, 3, 3, 4, 3 * (degree + 1) ** 2 - 3)
    body = np.frombuffer(content, "u1", offset=16)
    ends = np.cumsum([count * width for width in widths])
    assert ends[-1] == len(body)
    parts = np.split(body, ends[:-1])
    return bits, [part.reshape(count, width) for part, width in zip(parts, widths, strict=True)]


@pytest.mark.parametrize("coefficients", [1, 16])
def test_a_spz_holds_each_number_within_its_bound(coefficients, tmp_path):
    """y is up and z points to the viewer: both have the other sign than in a .ply."""
    g = some_gaussians(coefficients)
    save_spz(tmp_path / "a.spz", g)
    bits, (means, opacities, colors, scales, quats, sh) = rows_of(tmp_path / "a.spz")
    fixed = np.zeros((len(means), 3, 4), "u1")
    fixed[..., 1:] = means.reshape(-1, 3, 3)
    found = (fixed.view("<i4")[..., 0] >> 8) / 2.0**bits
    assert np.abs(found - g.means.numpy() * (1, -1, -1)).max() <= 0.51 / 2.0**bits
    assert np.abs(opacities[:, 0] / 255 - g.opacities.numpy()).max() <= 0.51 / 255
    assert np.abs(np.log(g.scales.numpy()) - (scales / 16 - 10)).max() <= 0.51 / 16
    dc = g.sh[:, 0].numpy()
    assert np.abs((colors / 255 - 0.5) / 0.15 - dc).max() <= 0.51 / 38.25
    packed = quats.copy().view("<u4")[:, 0]
    unit = torch.nn.functional.normalize(g.quats, dim=1).numpy() * (1, 1, -1, -1)
    for word, (w, *xyz) in zip(packed.tolist(), unit.tolist(), strict=True):
        q, largest = np.array([*xyz, w]), word >> 30
        assert abs(q[largest]) == np.abs(q).max()
        others = np.delete(q * np.sign(q[largest]), largest)
        for k, value in enumerate(others):
            stored = word >> (20 - 10 * k) & 1023
            sign = -1 if stored >> 9 else 1
            assert abs(sign * (stored & 511) / 511 * 0.5**0.5 - value) < 0.51 / 511
    assert sh.shape[1] == 3 * (coefficients - 1)
    save_spz(tmp_path / "b.spz", g)
    assert (tmp_path / "a.spz").read_bytes() == (tmp_path / "b.spz").read_bytes()


def test_numbers_beyond_the_ranges_of_a_spz_are_clipped_or_refused(tmp_path):
    g = some_gaussians(4)
    path, far = tmp_path / "a.spz", 1000 * g.means
    save_spz(path, Gaussians(far, g.quats, 1e9 * g.scales, g.opacities, sh=100 * g.sh))
    bits, (_, _, _, scales, _, sh) = rows_of(path)
    assert bits < 16 and (scales == 255).all() and sh.min() == 0 and sh.max() == 255
    with pytest.raises(InputError, match="up to degree 3, got 4"):
        save_spz(path, some_gaussians(25))
    with pytest.raises(InputError, match="means up to 8388607 m"):
        save_spz(path, Gaussians(1e8 * g.means, g.quats, g.scales, g.opacities, sh=g.sh))


def test_a_splat_has_32_bytes_a_gaussian_the_largest_first(tmp_path):
    g = some_gaussians()
    save_splat(tmp_path / "a.splat", g)
    rows = np.frombuffer((tmp_path / "a.splat").read_bytes(), "<f4").reshape(len(g), 8)
    order = torch.argsort(g.scales.double().prod(1) * g.opacities, descending=True, stable=True)
    assert np.array_equal(rows[:, :3], g.means[order]) and np.array_equal(
        rows[:, 3:6], g.scales[order]
    )
    bytes_ = rows.view("u1")[:, 24:] / 255.0
    exact = np.column_stack([plain_colors(g), g.opacities])[order]
    assert np.abs(bytes_[:, :4] - exact).max() <= 0.51 / 255
    unit = torch.nn.functional.normalize(g.quats[order], dim=1).numpy()
    assert np.abs((bytes_[:, 4:] * 255 - 128) / 128 - unit).max() <= 1 / 128
