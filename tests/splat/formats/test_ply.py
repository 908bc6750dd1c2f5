"""The .ply of 3DGS: the layout that viewers expect, and reading back without loss."""

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.splat import Gaussians
from gva_mi.splat.formats.ply import load_ply, save_ply

FIELDS = ("means", "quats", "scales", "opacities", "sh")


def some_gaussians(coefficients=4, count=20):
    generator = torch.Generator().manual_seed(0)
    draw = lambda *size: torch.randn(count, *size, generator=generator)
    return Gaussians(
        draw(3), draw(4), draw(3).exp(), torch.sigmoid(draw()), sh=draw(coefficients, 3)
    )


@pytest.mark.parametrize("coefficients", [1, 16])
def test_what_is_read_is_what_was_written(tmp_path, coefficients):
    written = some_gaussians(coefficients)
    save_ply(tmp_path / "a.ply", written)
    read = load_ply(tmp_path / "a.ply")
    for name in FIELDS:
        one, two = getattr(read, name), getattr(written, name)
        assert one.shape == two.shape and torch.allclose(one, two, rtol=1e-5, atol=1e-6), name
    assert [file.name for file in tmp_path.iterdir()] == ["a.ply"]


def test_layout_is_that_of_3dgs(tmp_path):
    g = some_gaussians()
    save_ply(tmp_path / "a.ply", g)
    head, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    names = [line.split()[-1] for line in head.decode().split("\n") if line.startswith("property")]
    assert (
        names
        == (
            "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 "
            "f_rest_0 f_rest_1 f_rest_2 f_rest_3 f_rest_4 f_rest_5 f_rest_6 f_rest_7 f_rest_8 "
            "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
        ).split()
    )
    table = np.frombuffer(body, "<f4").reshape(20, 26)
    assert np.allclose(table[:, 9:12], g.sh[:, 1:, 0])  # all of red first
    assert np.allclose(table[:, 18], torch.logit(g.opacities), atol=1e-5)
    assert np.allclose(table[:, 19:22], g.scales.log(), atol=1e-5)
    assert np.allclose(table[:, 22:], g.quats)
    assert (table[:, 3:6] == 0).all()


def test_opaque_and_invisible_gaussians_stay_finite(tmp_path):
    g = some_gaussians()
    opacities = torch.tensor([0.0, 1.0] * 10)
    save_ply(tmp_path / "a.ply", Gaussians(g.means, g.quats, g.scales, opacities, sh=g.sh))
    assert torch.allclose(load_ply(tmp_path / "a.ply").opacities, opacities, atol=1e-6)


def test_other_files_are_explained(tmp_path):
    path = tmp_path / "a.ply"
    with pytest.raises(InputError, match="no such file"):
        load_ply(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_ply(tmp_path)
    save_ply(path, some_gaussians())
    whole = path.read_bytes()
    change = whole.replace
    for content, match in (
        (b"hello", "not a .ply"),
        (whole[:-8], "cut short"),
        (change(b"scale_1", b"scale_x"), "'scale_1' is missing"),
        (change(b"binary_little_endian", b"ascii"), "binary_little_endian"),
        (change(b"element vertex 20", b"element vertex many"), "vertex many"),
        (change(b"element vertex", b"element points"), "'vertex' is missing"),
        (change(b"float f_rest_8", b"float f_past_8"), "8 properties f_rest"),
        (change(b"property float nx", b"property nx"), "'property nx'"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=match):
            load_ply(path)


def test_other_properties_types_and_elements_are_ignored(tmp_path):
    """Doubles, bytes beside them, and a table of something else at the end."""
    save_ply(tmp_path / "a.ply", some_gaussians(coefficients=1))
    head, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    names = [line.split()[-1] for line in head.decode().split("\n") if line.startswith("property")]
    table = np.frombuffer(body, "<f4").reshape(20, -1)
    wide = np.zeros(20, [("label", "u1"), *((name, "<f8") for name in names)])
    for name, column in zip(names, table.T, strict=True):
        wide[name] = column
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 20", "property uchar label"]
    lines += [*(f"property double {name}" for name in names), "element camera 2"]
    lines += ["property int id", "end_header\n"]
    content = "\n".join(lines).encode() + wide.tobytes() + np.zeros(2, "<i4").tobytes()
    (tmp_path / "b.ply").write_bytes(content)
    one, two = load_ply(tmp_path / "a.ply"), load_ply(tmp_path / "b.ply")
    assert all(torch.equal(getattr(one, name), getattr(two, name)) for name in FIELDS)
