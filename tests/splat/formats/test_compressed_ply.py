"""SuperSplat's compressed .ply: single bits, damaged files, and reading back within half a step."""

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.splat.formats.ply import CHUNK, load_ply, save_compressed_ply
from gva_mi.splat.formats.ply_elements import read_elements
from gva_mi.splat.gaussians import Gaussians

BOUNDS = [
    f"{end}_{kind}{axis}" for kind in ("", "scale_") for end in ("min", "max") for axis in "xyz"
]
COLORS = [f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"]
PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
C0 = 0.28209479177387814


def write(path, chunk, vertex, sh=None):
    """Write tables: chunk (M, 12 or 18) float, vertex (N, 4) uint, sh (N, K) uchar."""
    tables = [("chunk", chunk, "float", (BOUNDS + COLORS)[: chunk.shape[1]], "<f4")]
    tables.append(("vertex", vertex, "uint", PACKED, "<u4"))
    if sh is not None:
        tables.append(("sh", sh, "uchar", [f"f_rest_{i}" for i in range(sh.shape[1])], "u1"))
    lines = ["ply", "format binary_little_endian 1.0", "comment made by a test"]
    for name, table, kind, names, _ in tables:
        lines.append(f"element {name} {len(table)}")
        lines += [f"property {kind} {x}" for x in names]
    body = b"".join(np.asarray(table).astype(kind).tobytes() for _, table, _, _, kind in tables)
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + body)
    return path


def one(position=0, rotation=0, scale=0, color=0):
    return np.array([[position, rotation, scale, color]], dtype=np.uint32)


def bounds(count=1, colors=True):
    row = [-1, -2, -3, 1, 2, 3, -5, -4, -3, -2, -1, 0, *([0.1, 0.2, 0.3, 0.9, 0.8, 0.7] * colors)]
    return np.array([row] * count, dtype=np.float32)


def test_every_bit_is_where_splat_transform_puts_it(tmp_path):
    last_x, last_y, last_z = 2047 << 21, 1023 << 11, 2047
    for packed, expected in ((0, [-1, -2, -3]), (last_x, [1, -2, -3]), (last_y, [-1, 2, -3]),
                             (last_z, [-1, -2, 3])):  # fmt: skip
        g = load_ply(write(tmp_path / "a.ply", bounds(), one(position=packed)))
        assert torch.allclose(g.means, torch.tensor([expected]).float())
    g = load_ply(write(tmp_path / "a.ply", bounds(), one(scale=last_x | last_z)))
    assert torch.allclose(g.scales.log(), torch.tensor([[-2.0, -4.0, 0.0]]))
    g = load_ply(write(tmp_path / "a.ply", bounds(), one(color=0xFF00FF33)))
    assert torch.allclose(g.sh[:, 0] * C0 + 0.5, torch.tensor([[0.9, 0.2, 0.7]]))
    assert g.opacities.item() == pytest.approx(0x33 / 255)


@pytest.mark.parametrize("largest", range(4))
def test_the_largest_of_a_quaternion_follows_from_the_others(tmp_path, largest):
    others = [1023, 512, 0]  # sqrt(1/2), nearly 0, -sqrt(1/2)
    packed = largest << 30 | others[0] << 20 | others[1] << 10 | others[2]
    g = load_ply(write(tmp_path / "a.ply", bounds(), one(rotation=packed)))
    expected = [0.5**0.5, (2 * 512 / 1023 - 1) * 0.5**0.5, -(0.5**0.5)]
    expected.insert(largest, 0.0)
    assert torch.allclose(g.quats, torch.tensor([expected]), atol=1e-6)


def test_older_files_without_bounds_of_colours(tmp_path):
    g = load_ply(write(tmp_path / "a.ply", bounds(colors=False), one(color=0xFF8000FF)))
    assert torch.allclose(g.sh[:, 0] * C0 + 0.5, torch.tensor([[1, 0x80 / 255, 0]]), atol=1e-6)


def test_a_chunk_holds_256_and_each_has_its_own_bounds(tmp_path):
    chunk = bounds(2)
    chunk[1, :3] += 10
    chunk[1, 3:6] += 10
    g = load_ply(write(tmp_path / "a.ply", chunk, np.zeros((300, 4))))
    expected = torch.tensor([[-1.0, -2, -3]]).repeat(300, 1)
    expected[256:] += 10
    assert torch.equal(g.means, expected)


@pytest.mark.parametrize("count", [9, 45])
def test_higher_coefficients_are_a_byte_each_channel_by_channel(tmp_path, count):
    sh = np.random.default_rng(0).integers(0, 256, (3, count), dtype=np.uint8)
    sh[0, :3] = 0, 255, 128
    g = load_ply(write(tmp_path / "a.ply", bounds(), np.zeros((3, 4)), sh))
    assert g.sh.shape == (3, 1 + count // 3, 3)
    assert torch.allclose(g.sh[0, 1:4, 0], torch.tensor([-4.0, 4.0, 8 * 128.5 / 256 - 4]))
    red, green = torch.tensor(sh[1, 0]), torch.tensor(sh[1, count // 3])
    assert torch.allclose(
        g.sh[1, 1, :2], 8 * (torch.stack([red, green]) + 0.5) / 256 - 4, atol=0.02
    )


def test_damaged_files_are_explained(tmp_path):
    path = tmp_path / "a.ply"

    def refused(match, *tables):
        with pytest.raises(InputError, match=match):
            load_ply(write(path, *tables))

    refused("1 chunks of 257 Gaussians; expected 2", bounds(), np.zeros((257, 4)))
    refused("'max_scale_z' of 'chunk' is missing", bounds()[:, :11], one())
    refused("2 rows of 9 in 'sh'; expected 1", bounds(), one(), np.zeros((2, 9)))
    refused("1 rows of 8 in 'sh'; expected 1 of 9, 24 or 45", bounds(), one(), np.zeros((1, 8)))
    refused("bounds are not finite", bounds() * np.nan, one())
    refused("bounds are not finite, or too large", bounds() * -1e3, one())
    whole = write(path, bounds(), one()).read_bytes()
    for change, match in (
        (lambda x: x[:-1], "cut short, 1 rows of 'vertex'"),
        (lambda x: x.replace(b"element chunk", b"element hunks"), "'chunk' is missing"),
        (lambda x: x.replace(b"uint packed_color", b"float packed_color"), "expected it as uint"),
        (lambda x: x.replace(b"min_y", b"min_x"), "named twice"),
        (lambda x: x.replace(b"element vertex 1", b"element vertex -1"), "'element vertex -1'"),
        (
            lambda x: x.replace(b"uint packed_color", b"list uchar int packed_color"),
            "'vertex' of plain numbers is missing",
        ),
    ):
        path.write_bytes(change(whole))
        with pytest.raises(InputError, match=match):
            load_ply(path)


def cloud(count, coefficients, seed=0):
    """Make random Gaussians."""
    draw = torch.Generator().manual_seed(seed)
    normal = lambda *shape: torch.randn(*shape, generator=draw)
    return Gaussians(
        means=normal(count, 3) * torch.tensor([3.0, 1.0, 0.1]),
        quats=normal(count, 4) * 3,
        scales=torch.exp(normal(count, 3) - 4),
        opacities=torch.rand(count, generator=draw),
        sh=torch.cat([normal(count, 1, 3), normal(count, coefficients - 1, 3)], dim=1),
    )


def matched(given, tmp_path):
    """Write and read; return what was read, the order of what was given, chunks and extents."""
    path = tmp_path / "a.compressed.ply"
    save_compressed_ply(path, given)
    found, chunk = load_ply(path), read_elements(path)["chunk"]
    assert len(found) == len(given) and len(chunk) == -(-len(given) // CHUNK)
    low, high = (torch.from_numpy(np.stack([chunk[e + a] for a in "xyz"], 1)) for e in
                 ("min_", "max_"))  # fmt: skip
    # Nearest by place and colour, which differ by much more than they are rounded.
    key = lambda g: torch.cat([g.means, g.sh[:, 0]], dim=1).double()
    order = torch.cdist(key(given), key(found)).argmin(1)
    assert len(order.unique()) == len(given)
    return found, order, chunk[order.numpy() // CHUNK], (high - low)[order // CHUNK]


@pytest.mark.parametrize("coefficients", [1, 16])
def test_all_comes_back_within_half_a_step(coefficients, tmp_path):
    given = cloud(700, coefficients)
    found, order, chunk, extent = matched(given, tmp_path)
    steps = torch.tensor([2047.0, 1023.0, 2047.0])
    off = (found.means[order] - given.means).abs()
    assert (off <= 0.5 * extent / steps + 1e-6).all()
    spread = lambda kind, axes: torch.from_numpy(
        np.stack([chunk[f"max_{kind}{a}"] - chunk[f"min_{kind}{a}"] for a in axes], 1)
    )
    off = (found.scales[order].log() - given.scales.log()).abs()
    assert (off <= 0.5 * spread("scale_", "xyz") / steps + 1e-5).all()
    off = (found.sh[order, 0] - given.sh[:, 0]).abs() * C0
    assert (off <= 0.5 * spread("", "rgb") / 255 + 1e-6).all()
    assert (found.opacities[order] - given.opacities).abs().max() <= 0.5 / 255 + 1e-6
    unit = torch.nn.functional.normalize(given.quats)
    unit = unit * torch.sign((unit * found.quats[order]).sum(1, keepdim=True))
    off = (found.quats[order] - unit).abs()
    stored = torch.ones_like(off).scatter_(1, unit.abs().argmax(1, keepdim=True), 0).bool()
    assert off[stored].max() <= 0.5 * 2 * 0.5**0.5 / 1023 + 1e-6
    rest = given.sh[:, 1:].clamp(-4, 4)  # beyond, they are cut off
    assert ((found.sh[order, 1:] - rest).abs() <= 1 / 32 + 1e-6).all()


def test_chunks_hold_neighbours(tmp_path):
    given = cloud(4096, 1)
    path = tmp_path / "a.ply"
    save_compressed_ply(path, given)
    chunk = read_elements(path)["chunk"]
    whole = (given.means.amax(0) - given.means.amin(0)).prod()
    volume = np.prod([chunk[f"max_{a}"] - chunk[f"min_{a}"] for a in "xyz"], axis=0)
    assert np.median(volume) < float(whole) / 8
    again = path.read_bytes()
    save_compressed_ply(path, given)
    assert path.read_bytes() == again
