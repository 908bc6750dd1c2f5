"""The .splat format: the rows that viewers expect, and reading back within 8 bits."""

import numpy as np
import pytest
import torch
from samples.scenes import some_gaussians

from gva_mi import InputError
from gva_mi.splat.formats.spz import load_splat, plain_colors, save_splat


def in_order(g):
    return torch.argsort(g.scales.double().prod(1) * g.opacities, descending=True, stable=True)


def test_what_is_read_is_what_was_written_to_8_bits(tmp_path):
    g = some_gaussians()
    save_splat(tmp_path / "a.splat", g)
    read, order = load_splat(tmp_path / "a.splat"), in_order(g)
    assert torch.equal(read.means, g.means[order]) and torch.equal(read.scales, g.scales[order])
    assert (read.opacities - g.opacities[order]).abs().max() <= 0.5 / 255 + 1e-6
    assert np.abs(read.colors.numpy() - plain_colors(g)[order]).max() <= 0.5 / 255 + 1e-6
    unit = torch.nn.functional.normalize(g.quats[order], dim=1)
    assert (read.quats - unit).abs().max() <= 1 / 128
    assert [file.name for file in tmp_path.iterdir()] == ["a.splat"]


def test_other_files_are_explained(tmp_path):
    path = tmp_path / "a.splat"
    with pytest.raises(InputError, match="no such file; expected a .splat"):
        load_splat(path)
    path.write_bytes(b"hello")
    with pytest.raises(InputError, match="5 bytes; expected a .splat, 32 bytes a Gaussian"):
        load_splat(path)
    path.write_bytes(b"\xff" * 64)
    with pytest.raises(InputError, match="not finite"):
        load_splat(path)
