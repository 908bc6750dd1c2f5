"""The .spz format: reading back within each bound, and files that others write."""

import gzip
import struct
from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.splat import Gaussians
from gva_mi.splat.formats.spz import load_spz, save_spz

ANGLE = 0.28  # degrees


def some_gaussians(degree=3, count=400, reach=1.0):
    generator = torch.Generator().manual_seed(0)
    draw = lambda *size: torch.randn(count, *size, generator=generator)
    sh = (0.3 * draw((degree + 1) ** 2, 3)).clamp(-0.9, 0.9)
    return Gaussians(
        reach * draw(3), draw(4), (draw(3) - 4).exp(), torch.sigmoid(2 * draw()), sh=sh
    )


def degrees(a, b):
    """Angle between rotations, of quaternions of any length."""
    a, b = (torch.nn.functional.normalize(q.double(), dim=1) for q in (a, b))
    # from the chord: an arc cosine is inexact for small angles
    chord = torch.minimum((a - b).norm(dim=1), (a + b).norm(dim=1))
    return torch.rad2deg(4 * torch.asin(chord / 2))


@pytest.mark.parametrize("degree", [0, 3])
def test_what_is_read_is_what_was_written_within_the_bounds(degree, tmp_path):
    g = some_gaussians(degree)
    save_spz(tmp_path / "a.spz", g)
    read = load_spz(tmp_path / "a.spz")
    slack = 1 + 1e-5
    assert (read.means - g.means).abs().max() <= 0.5 / 2**16 * slack
    assert (read.opacities - g.opacities).abs().max() <= 0.5 / 255 * slack
    assert (read.scales / g.scales).log().abs().max() <= 0.5 / 16 * slack
    assert degrees(read.quats, g.quats).max() <= ANGLE
    assert torch.allclose(read.quats.norm(dim=1), torch.ones(400), atol=1e-5)
    assert (read.sh[:, 0] - g.sh[:, 0]).abs().max() <= 0.5 / 38.25 * slack
    if degree:
        assert (read.sh[:, 1:] - g.sh[:, 1:]).abs().max() <= 0.5 / 128 * slack
    assert [file.name for file in tmp_path.iterdir()] == ["a.spz"]


def test_written_again_it_is_the_same_file(tmp_path):
    """Also the flag of Gaussians that are to be drawn antialiased."""
    save_spz(tmp_path / "a.spz", replace(some_gaussians(), antialiased=True))
    save_spz(tmp_path / "b.spz", load_spz(tmp_path / "a.spz"))
    assert gzip.decompress((tmp_path / "a.spz").read_bytes())[14] == 1
    a, b = ((tmp_path / name).read_bytes() for name in ("a.spz", "b.spz"))
    assert gzip.decompress(a) == gzip.decompress(b) and a == b


def test_numbers_beyond_the_ranges_are_clipped(tmp_path):
    g = some_gaussians(1, 3, reach=1000.0)
    sh = torch.tensor([[[9.0, -9.0, 0.0]] * 4] * 3)
    scales = torch.tensor([[1e-9, 1e4, 1.0]] * 3)
    save_spz(tmp_path / "a.spz", Gaussians(g.means, g.quats, scales, g.opacities, sh=sh))
    read = load_spz(tmp_path / "a.spz")
    step = 2.0 ** -np.floor(np.log2(0x7FFFFF / g.means.abs().max().item()))
    assert step > 2**-16 and (read.means - g.means).abs().max() <= step / 2 * 1.01
    assert torch.allclose(
        read.scales[0], torch.tensor([np.exp(-10.0), np.exp(5.9375), 1.0]).float()
    )
    assert torch.allclose(read.sh[0, 0, :2], torch.tensor([1, -1]) * 0.5 / 0.15)
    assert torch.allclose(read.sh[0, 1], torch.tensor([1.0, -127 / 128, 0.0]))


def test_the_layout_byte_by_byte(tmp_path):
    """What is stored with y up and z backward is read with y down and z forward."""
    streams = [
        bytes([0x00, 0x10, 0x00, 0x00, 0xF0, 0xFF, 0x01, 0x00, 0x00]),  # 1, −1, 1/4096 m
        bytes([51]), bytes([255, 128, 0]), bytes([160, 144, 96]),
        struct.pack("<I", 3 << 30 | 511 << 20 | (512 | 255) << 10),
        bytes([0, 128, 255] + [128] * 6),
    ]  # fmt: skip
    header = struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 1, 12, 0, 0)
    (tmp_path / "a.spz").write_bytes(gzip.compress(header + b"".join(streams)))
    g = load_spz(tmp_path / "a.spz")
    assert torch.equal(g.means[0], torch.tensor([1.0, 1.0, -1 / 4096]))
    assert torch.allclose(g.opacities, torch.tensor([0.2]))
    assert torch.allclose(g.scales[0], torch.tensor([1.0, np.exp(-1.0), np.exp(-4.0)]).float())
    assert torch.allclose(g.sh[0, 0], torch.tensor([3.3333, 0.01307, -3.3333]), atol=1e-4)
    assert torch.equal(g.sh[0, 1], torch.tensor([1.0, 0.0, -127 / 128]))
    unit = np.array([0.6128, 0.7071, 0.3529, 0.0])
    assert np.abs(g.quats[0].numpy() - unit / np.linalg.norm(unit)).max() < 0.005


def test_other_files_are_explained(tmp_path):
    path = tmp_path / "a.spz"

    def refused(content, words):
        path.write_bytes(content)
        with pytest.raises(InputError, match=words) as error:
            load_spz(path)
        assert "\n" not in str(error.value)

    head = lambda *numbers: gzip.compress(struct.pack("<IIIBBBB", *numbers))
    with pytest.raises(InputError, match="no such file"):
        load_spz(tmp_path / "none.spz")
    refused(b"", "something else; expected a .spz")
    refused(b"ply\n" * 20, "points or a mesh; expected a .spz")
    refused(b"\x1f\x8b" + bytes(40), "damaged")
    refused(head(0x5053474E, 2, 1, 0, 12, 0, 0), "version 2; expected a .spz of version 3")
    refused(head(0x5053474E, 3, 1, 0, 12, 2, 0), "with extensions; expected a .spz")
    refused(head(0x5053474E, 3, 1, 9, 12, 0, 0), "of degree 9")
    refused(head(0x5053474E, 3, 3_000_000_000, 0, 12, 0, 0), "announces 3000000000 Gaussians")
    refused(head(0x5053474E, 3, 10, 0, 12, 0, 0), "cut short")
    save_spz(path, some_gaussians())
    refused(path.read_bytes()[:-3000], "cut short")
    with pytest.raises(InputError, match="up to degree 3, got 4"):
        save_spz(path, some_gaussians(4))
