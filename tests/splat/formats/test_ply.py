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
        (change(b"binary_little_endian", b"binary_middle_endian"), "ascii, binary_little_endian"),
        (change(b"binary_little_endian", b"ascii"), "cut short|cannot be read"),
        (change(b"element vertex 20", b"element vertex many"), "vertex many"),
        (change(b"element vertex", b"element points"), "'vertex' of plain numbers is missing"),
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


# One Gaussian as other programs write it: its table, and what the reader should find.
SPLAT = {"x": 1, "y": 2, "z": 3, "f_dc_0": 0.5, "f_dc_1": 0.25, "f_dc_2": -1, "opacity": 0,
         "scale_0": -3, "scale_1": -4, "scale_2": -5,
         "rot_0": 1, "rot_1": 0, "rot_2": 0, "rot_3": 0}  # fmt: skip
COLORED = {k: v for k, v in SPLAT.items() if not k.startswith("f_dc")} | {
    "red": 255, "green": 51, "blue": 0
}  # fmt: skip
FLAT = {k: v for k, v in SPLAT.items() if k != "scale_2"}
FACES = "element face 2", "property list uchar int vertex_indices", "property uchar flag"
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


def written(path, table, encoding="binary_little_endian", newline="\n", before=(), after=()):
    """Write a .ply of one row by hand; faces, a triangle and a square, before or after it."""
    kind = lambda name: "uchar" if name in ("red", "green", "blue") else "float"
    vertex = ["element vertex 1", *(f"property {kind(name)} {name}" for name in table)]
    order = ORDERS.get(encoding)
    if order is None:
        row = (" ".join(map(str, table.values())) + newline).encode()
        faces = f"3 0 1 2 9{newline}4 0 1 2 3 9{newline}".encode()
    else:
        dtypes = [(name, "u1" if kind(name) == "uchar" else f"{order}f4") for name in table]
        row = np.array([tuple(table.values())], dtypes).tobytes()
        corners = lambda n: bytes([n]) + np.arange(n).astype(f"{order}i4").tobytes() + b"\x09"
        faces = corners(3) + corners(4)
    lines = ["ply", f"format {encoding} 1.0", "comment of a test", *before, *vertex, *after]
    head = newline.join([*lines, "end_header", ""]).encode()
    path.write_bytes(head + faces * bool(before) + row + faces * bool(after))
    return path


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["ascii", *ORDERS])
@pytest.mark.parametrize("where", ["alone", "before", "after"])
def test_each_encoding_with_faces_beside_the_gaussians(tmp_path, encoding, newline, where):
    faces = {where: FACES} if where != "alone" else {}
    g = load_ply(written(tmp_path / "a.ply", SPLAT, encoding, newline, **faces))
    assert g.means.tolist() == [[1, 2, 3]] and g.sh[0, 0].tolist() == [0.5, 0.25, -1]
    assert torch.allclose(g.scales.log(), torch.tensor([[-3.0, -4, -5]]))


def test_plain_colours_and_flat_gaussians(tmp_path):
    """``red green blue`` in place of f_dc; 2D Gaussian Splatting's discs have no thickness."""
    for encoding in ("ascii", *ORDERS):
        g = load_ply(written(tmp_path / "a.ply", COLORED, encoding))
        assert g.sh is None and torch.allclose(g.colors, torch.tensor([[1, 0.2, 0]]))
    flat = load_ply(written(tmp_path / "a.ply", FLAT))
    assert torch.allclose(flat.scales, torch.tensor([[-3.0, -4, -torch.inf]]).exp())
    save_ply(tmp_path / "b.ply", flat)
    assert torch.allclose(load_ply(tmp_path / "b.ply").scales, flat.scales, atol=1e-11)


def test_other_tables_are_explained(tmp_path):
    path = tmp_path / "a.ply"
    points = {k: COLORED[k] for k in ("x", "y", "z", "red", "green", "blue")}
    with pytest.raises(InputError, match="points or a mesh; expected Gaussians"):
        load_ply(written(path, points))
    for encoding, cut in (("ascii", -3), ("ascii", -50), ("binary_big_endian", -70)):
        whole = written(path, SPLAT, encoding, before=FACES).read_bytes()
        path.write_bytes(whole[:cut])
        with pytest.raises(InputError, match="cut short, . rows of '(face|vertex)'"):
            load_ply(path)
    path.write_bytes(written(path, SPLAT, "ascii").read_bytes().replace(b"0.25", b"blue"))
    with pytest.raises(InputError, match="'vertex' cannot be read"):
        load_ply(path)


def test_harmonics_of_a_degree_that_an_engine_demands(tmp_path):
    """Degree 3 makes rows of 248 bytes; what is added is zero, what is cut was the highest."""
    for coefficients in (1, 4, 25):
        given = some_gaussians(coefficients)
        save_ply(tmp_path / "a.ply", with_degree(given, 3))
        body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)[1]
        assert len(body) == 248 * len(given)
        found, kept = load_ply(tmp_path / "a.ply").sh, min(coefficients, 16)
        assert torch.equal(found[:, :kept], given.sh[:, :kept]) and not found[:, kept:].any()
