"""Colours of videos: each form that phones, webcams and programs write gives the same greys."""

from fractions import Fraction

import av
import numpy as np
import pytest

from gva_mi.subject.video_file import TO_BT709, VideoFile, decoded, open_stream, picture_of

RAMP = np.array([16, 40, 90, 128, 180, 220, 250])  # greys of sRGB
COLORS = np.array([(200, 60, 30), (40, 170, 60), (30, 60, 190)])
LUMA = {601: (0.299, 0.114), 709: (0.2126, 0.0722), 2020: (0.2627, 0.0593)}
H273 = {601: 6, 709: 1, 2020: 9}  # numbers of matrix and primaries


def write(path, codec, colors, matrix=709, full=False, bits=8, transfer=1, tagged=True,
    size=(32, 128), primaries=None):  # fmt: skip
    """Write two frames of vertical bars of R'G'B' in [0, 1], without any converter of colours."""
    height, width = size
    kr, kb = LUMA[matrix]
    red, green, blue = np.repeat(colors, width // len(colors) + 1, axis=0)[:width].T
    y = kr * red + (1 - kr - kb) * green + kb * blue
    chroma = ((blue - y) / (2 - 2 * kb), (red - y) / (2 - 2 * kr))
    top, unit = 2**bits - 1, 2 ** (bits - 8)
    planes = [y * top if full else (16 + 219 * y) * unit]
    planes += [c * top + 128 * unit if full else (128 + 224 * c) * unit for c in chroma]
    kind = "yuv444p" if bits == 8 else "yuv444p10le"
    with av.open(str(path), "w") as out:
        stream = out.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = width, height, kind
        stream.options = {"crf": "1", "x265-params": "log-level=none:bframes=0", "b": "8000000"}
        context = stream.codec_context
        if tagged:
            context.colorspace, context.color_primaries = H273[matrix], primaries or H273[matrix]
            context.color_trc, context.color_range = transfer, 2 if full else 1
        for k in range(2):
            frame = av.VideoFrame(width, height, kind)
            for plane, values in zip(frame.planes, planes, strict=True):
                row = np.round(values).astype("<u2" if bits > 8 else "u1")
                row = np.pad(row, (0, plane.line_size // row.itemsize - width))
                plane.update(np.tile(row, (height, 1)).tobytes())
            if tagged:
                frame.colorspace, frame.color_range = H273[matrix], 2 if full else 1
            frame.pts, frame.time_base = k, Fraction(1, 25)
            out.mux(stream.encode(frame))
        out.mux(stream.encode())
    return path


def seen(path, count):
    """Return the colours of the bars, (count, 3), read in both ways."""
    picture = VideoFile(path)[1]
    (other,) = [picture_of(frame) for frame in decoded(open_stream(path))][1:]
    assert np.array_equal(picture, other)
    width = picture.shape[1]
    wide = width // count + 1
    return np.stack([picture[:, k * wide + 3 : min(width, (k + 1) * wide) - 3].mean((0, 1))
                     for k in range(count)])  # fmt: skip


@pytest.mark.parametrize("name, codec, more",
    [("a.mp4", "libx264", {}), ("a.mp4", "libx264", {"matrix": 601}),
    ("a.mp4", "libx264", {"full": True}), ("a.mov", "libx265", {"bits": 10}),
    ("a.mkv", "libx265", {"bits": 10, "full": True}), ("a.webm", "libvpx-vp9", {}),
    ("a.mp4", "libx264", {"matrix": 601, "tagged": False}),
    ("a.mp4", "libx264", {"matrix": 709, "tagged": False, "size": (32, 1280)})])  # fmt: skip
def test_greys_and_colours_are_right_in_every_form(name, codec, more, tmp_path):
    true = np.concatenate([np.repeat(RAMP[:, None], 3, axis=1), COLORS])
    found = seen(write(tmp_path / name, codec, true / 255, **more), len(true))
    assert np.abs(found - true).max() <= 3


def pq(nits):
    x = (np.asarray(nits) / 1e4) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * x) / (1 + 18.6875 * x)) ** 78.84375


def hlg(nits):
    scene = (np.asarray(nits) / 1000) ** (1 / 1.2)  # of greys
    bright = 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), bright)


@pytest.mark.parametrize("curve, transfer, name", [(pq, 16, "PQ"), (hlg, 18, "HLG")])
def test_hdr_is_mapped_to_srgb(curve, transfer, name, tmp_path):
    """Greys below the knee as in an SDR video, white bright, highlights not clipped flat."""
    linear = np.where(RAMP < 11, RAMP / 255 / 12.92, ((RAMP / 255 + 0.055) / 1.055) ** 2.4)
    nits = np.concatenate([203 * linear, [203, 400, 1000]])
    codes = np.repeat(curve(nits)[:, None], 3, axis=1)
    path = write(tmp_path / "a.mov", "libx265", codes, 2020, bits=10, transfer=transfer)
    assert f"the video is HDR ({name})" in VideoFile(path).notes[0]
    found = seen(path, len(nits))
    assert np.ptp(found, axis=1).max() <= 3  # grey stays grey
    below = linear < 0.7
    assert np.abs(found[: len(RAMP)][below] - RAMP[below, None]).max() <= 3
    brightness = found.mean(1)
    assert brightness[-3] > 235 and (np.diff(brightness) > -0.5).all()


# x and y of red, green and blue (ITU-T H.273), and of D65.
CHROMATICITIES = {1: [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06)],
    9: [(0.708, 0.292), (0.170, 0.797), (0.131, 0.046)],
    12: [(0.680, 0.320), (0.265, 0.690), (0.150, 0.060)]}  # fmt: skip
D65 = (0.3127, 0.3290)


def to_xyz(primaries):
    """Return the matrix (3, 3) of linear light to CIE XYZ: all primaries together are D65."""
    xyz = lambda x, y: np.array([x / y, 1, (1 - x - y) / y])
    columns = np.stack([xyz(*at) for at in CHROMATICITIES[primaries]], axis=1)
    return columns * np.linalg.solve(columns, xyz(*D65))


@pytest.mark.parametrize("primaries", [9, 12])
def test_primaries_of_phones_become_those_of_srgb(primaries, tmp_path):
    """Colours of sRGB, stored in the primaries of BT.2020 or Display P3, come back."""
    decode = lambda v: np.where(v < 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    encode = lambda v: np.where(v < 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)
    change = np.linalg.solve(to_xyz(primaries), to_xyz(1))
    stored = encode(np.maximum(decode(COLORS / 255) @ change.T, 0))
    assert np.abs(stored * 255 - COLORS).max() > 15
    path = write(
        tmp_path / "a.mov", "libx265", stored, 2020, bits=10, transfer=14, primaries=primaries
    )
    assert np.abs(seen(path, 3) - COLORS).max() <= 4
    assert np.allclose(TO_BT709[primaries], np.linalg.inv(change), atol=2e-4)
