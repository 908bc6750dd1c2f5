"""The .ply of 3DGS: the layout that viewers expect, and reading back without loss."""

import numpy as np
import pytest
import torch
from samples.scenes import some_gaussians

from gva_mi import InputError
from gva_mi.splat import Gaussians
from gva_mi.splat.formats.ply import load_ply, save_ply
from gva_mi.splat.formats.stored import with_degree

FIELDS = ("means", "quats", "scales", "opacities", "sh")


@pytest.mark.parametrize("coefficients", [1, 16])
def test_what_is_read_is_what_was_written(tmp_path, coefficients):
    written = some_gaussians(coefficients)
    save_ply(tmp_path / "a.ply", written)
    read = load_ply(tmp_path / "a.ply")
    for name in FIELDS:
        one, two = getattr(read, name), getattr(written, name)
        assert one.shape == two.shape and torch.allclose(one, two, rtol=1e-5, atol=1e-6), name
    assert [file.name for file in tmp_path.iterdir()] == ["a.ply"]


def test_layout_equals_3dgs(tmp_path):
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


def test_other_files_raise_an_explanation(tmp_path):
    path = tmp_path / "a.ply"
    with pytest.raises(InputError, match="no such file"):
        load_ply(path)
    with pytest.raises(InputError, match="is a folder"):
        load_ply(tmp_path)
    save_ply(path, some_gaussians())
    whole = path.read_bytes()
    change = whole.replace
    for content, match in (
        (b"hello", "not a .ply"),
        (whole[:-8], "cut short"),
        (change(b"scale_1", b"scale_x"), "'scale_1' is missing"),
        (change(b"binary_little_endian", b"binary_big_endian"), "format binary_little_endian"),
        (change(b"binary_little_endian", b"ascii"), "format binary_little_endian 1.0"),
        (change(b"element vertex 20", b"element vertex many"), "'vertex' is missing"),
        (change(b"element vertex", b"element points"), "'vertex' is missing"),
        (change(b"float nx", b"list uchar int nx"), "a number's property"),
        (change(b"float ny", b"float nx"), "'nx' is named twice"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\n"
            b"end_header\n" + bytes(4),
            "points or a mesh; expected Gaussians",
        ),
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


def test_flat_gaussians_have_no_thickness(tmp_path):
    """As 2D Gaussian Splatting writes its discs: without ``scale_2``."""
    g = some_gaussians(coefficients=1)
    save_ply(tmp_path / "a.ply", g)
    head, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    table = np.frombuffer(body, "<f4").reshape(20, -1)
    kept = [k for k in range(table.shape[1]) if k != 12]
    head = head.replace(b"property float scale_2\n", b"")
    (tmp_path / "b.ply").write_bytes(head + b"end_header\n" + table[:, kept].tobytes())
    flat = load_ply(tmp_path / "b.ply")
    assert torch.equal(flat.scales[:, :2], load_ply(tmp_path / "a.ply").scales[:, :2])
    assert (flat.scales[:, 2] == 0).all()
    save_ply(tmp_path / "c.ply", flat)
    assert torch.allclose(load_ply(tmp_path / "c.ply").scales, flat.scales, atol=1e-11)


def test_harmonics_of_a_degree_that_an_engine_demands(tmp_path):
    """Degree 3 makes rows of 248 bytes; what is added is zero, what is cut was the highest."""
    for coefficients in (1, 4, 25):
        given = some_gaussians(coefficients)
        save_ply(tmp_path / "a.ply", with_degree(given, 3))
        body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)[1]
        assert len(body) == 248 * len(given)
        found, kept = load_ply(tmp_path / "a.ply").sh, min(coefficients, 16)
        assert torch.equal(found[:, :kept], given.sh[:, :kept]) and not found[:, kept:].any()
