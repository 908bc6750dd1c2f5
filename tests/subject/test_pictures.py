"""Pictures of phones and programs: colours become sRGB; data that end early are refused."""

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image, ImageCms

from gva_mi.core.errors import InputError
from gva_mi.subject.footage import pictures
from gva_mi.subject.normals import read_map
from gva_mi.subject.pictures import read_image

P3 = np.array(
    [[0.680, 0.265, 0.150], [0.320, 0.690, 0.060], [0, 0.045, 0.790]]
)  # x, y, z of R, G, B
REC709 = np.array([[0.64, 0.30, 0.15], [0.33, 0.60, 0.06], [0.03, 0.10, 0.79]])
D65 = np.array([0.3127, 0.3290, 0.3583]) / 0.3290
D50 = np.array([0.9642, 1.0, 0.8249])
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
ORANGE = (220, 90, 60)  # in Display P3


def to_xyz(primaries):
    """Return the matrix of linear light to CIE XYZ, where all three together are D65."""
    return primaries * np.linalg.solve(primaries, D65)


def in_srgb(color):
    """Convert a colour (3,) 8-bit of Display P3."""
    x = np.array(color) / 255
    linear = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    x = np.clip(np.linalg.solve(to_xyz(REC709), to_xyz(P3) @ linear), 0, 1)
    return 255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def profile(primaries):
    """Return a profile (ICC) with the curve of sRGB and other primaries, which refer to D50."""
    data = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    cones = np.diag((BRADFORD @ D50) / (BRADFORD @ D65))
    columns = np.linalg.solve(BRADFORD, cones @ BRADFORD) @ to_xyz(primaries)
    for k in range(struct.unpack_from(">I", data, 128)[0]):
        kind, at, _ = struct.unpack_from(">4sII", data, 132 + 12 * k)
        if kind in (b"rXYZ", b"gXYZ", b"bXYZ"):
            column = columns[:, b"rgb".index(kind[:1])]
            struct.pack_into(">3i", data, at + 8, *np.round(column * 65536).astype(int).tolist())
    return bytes(data)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.webp", "alpha.png", "palette.png"])
def test_a_picture_in_display_p3_becomes_srgb(name, tmp_path):
    assert np.round(in_srgb(ORANGE)).tolist() == [238, 78, 46]
    picture = Image.new("RGB", (16, 16), ORANGE)
    if name == "alpha.png":
        picture.putalpha(100)
    picture = picture.quantize(4) if name == "palette.png" else picture
    more = {"a.jpg": {"quality": 100, "subsampling": 0}, "a.webp": {"lossless": True}}.get(name, {})
    picture.save(tmp_path / name, icc_profile=profile(P3), **more)
    for found in (read_image(tmp_path / name, 3), *pictures(tmp_path, 3)):
        assert np.abs(found - in_srgb(ORANGE)).max() <= (3 if name == "a.jpg" else 1)
    if name == "alpha.png":
        assert (read_image(tmp_path / name, 4)[..., 3] == 100).all()


def test_values_that_are_no_colours_stay_as_they_are(tmp_path):
    values = np.random.default_rng(0).integers(0, 255, (16, 16, 3), dtype=np.uint8)
    Image.fromarray(values).save(tmp_path / "normals.png", icc_profile=profile(P3))
    assert np.array_equal(read_map(tmp_path / "normals.png"), values)
    Image.fromarray(values[..., 0]).save(tmp_path / "mask.png", icc_profile=profile(P3))
    assert np.array_equal(read_image(tmp_path / "mask.png", 1), values[..., 0])


@pytest.mark.parametrize("embedded", [profile(REC709), b"no profile at all" * 20])
def test_a_profile_of_srgb_and_one_that_is_none_move_no_value(embedded, tmp_path):
    values = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(values).save(tmp_path / "a.png", icc_profile=embedded)
    assert np.array_equal(read_image(tmp_path / "a.png", 3), values)


def png(values, rows, interlaced=False):
    """Write a PNG by hand, whose data hold so many rows."""
    chunk = lambda kind, data: (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    )
    height, width, channels = values.shape
    grid = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2),
            (1, 0, 2, 1)] if interlaced else [(0, 0, 1, 1)]  # fmt: skip
    parts = [values[y::dy, x::dx] for y, x, dy, dx in grid]
    data = b"".join([b"\0" + row.tobytes() for part in parts for row in part][:rows])
    kind = {1: 0, 3: 2, 4: 6}[channels]
    head = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, interlaced)
    parts = chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(data)), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("dark", [False, True])
def test_a_png_whose_data_end_early_is_refused(channels, dark, interlaced, tmp_path):
    path, most = tmp_path / "a.png", 2 if dark else 256  # dark: a black picture may be whole
    values = np.random.default_rng(0).integers(
        most // 2 - 1, most - 1, (64, 48, channels), np.uint8
    )
    rows = 64 + interlaced * (8 + 8 + 8 + 16 + 16 + 32 + 32 - 64)
    for count in (1, rows // 2, rows - 1):
        path.write_bytes(png(values, count, interlaced))
        for read in (lambda: read_image(path, 3), lambda: read_image(path, 1)):
            with pytest.raises(InputError, match=r"a\.png: its data end before the last row"):
                read()
    path.write_bytes(png(values, 1000, interlaced))
    whole = np.broadcast_to(values[..., :3], (64, 48, 3))
    assert np.array_equal(read_image(path, 3), whole)


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_a_jpeg_whose_data_end_early_is_refused(mode, progressive, tmp_path):
    path, whole = tmp_path / "a.jpg", io.BytesIO()
    values = (
        np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    )
    Image.fromarray(values).convert(mode).save(whole, "JPEG", progressive=progressive)
    for share in (0.4, 0.9):  # with the mark of the end, as programs write it that repair files
        data = whole.getvalue()
        path.write_bytes(data[: int(share * len(data))] + b"\xff\xd9")
        with pytest.raises(InputError, match=r"a\.jpg: its data end before the last row"):
            read_image(path, 3)
    path.write_bytes(whole.getvalue() + b"more that a phone appends")
    with Image.open(whole) as stored:
        assert np.array_equal(read_image(path, 3), np.asarray(stored.convert("RGB")))
    Image.new("RGB", (32, 32), (128, 128, 128)).save(path, progressive=progressive)
    assert (read_image(path, 3) == 128).all()
