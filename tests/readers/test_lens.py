"""The lens of a recording: read from its file or given, and used by ``prepare``."""

import struct

import av
import numpy as np
import pytest
import roma
import torch
from PIL import Image

from gva_mi import InputError
from gva_mi.body.smplx import load_body
from gva_mi.readers.track import Track, through_lens
from gva_mi.subject.lens import asked_for, centred, in_pixels, quicktime_numbers, recorded
from gva_mi.subject.video import load_video

KEY = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
SIZE = (64, 48)  # W, H


def box(kind, *held):
    held = b"".join(held)
    return struct.pack(">I4s", len(held) + 8, kind) + held


def meta(kind, value, key=KEY, mpeg4=False):
    """One key and its value, as a phone writes them."""
    handler = box(b"hdlr", bytes(8), b"mdta", bytes(13))
    keys = box(b"keys", bytes(4), struct.pack(">I", 1), box(b"mdta", key.encode()))
    data = box(b"data", struct.pack(">II", kind, 0), value)
    return box(
        b"meta", bytes(4 if mpeg4 else 0), handler, keys, box(b"ilst", box(b"\0\0\0\1", data))
    )


def recording(path, *, of_video=b"", of_track=b"", size=SIZE):
    """Three pictures, with a ``meta`` at the ends of the video's and of the track's own boxes."""
    with av.open(str(path), "w", format="mov") as container:
        stream = container.add_stream("libx264rgb", rate=25)
        (stream.width, stream.height), stream.pix_fmt = size, "rgb24"
        for k in range(3):
            picture = np.full((size[1], size[0], 3), 40 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "rgb24")))
        container.mux(stream.encode())
    whole = path.read_bytes()
    start = whole.index(b"moov") - 4
    moov = whole[start + 8 : start + struct.unpack_from(">I", whole, start)[0]]
    at = moov.index(b"trak") - 4
    end = at + struct.unpack_from(">I", moov, at)[0]
    track = box(b"trak", moov[at + 8 : end], of_track)
    path.write_bytes(whole[:start] + box(b"moov", moov[:at], track, moov[end:], of_video))
    return path


TYPES = {"text": (1, b"27"), "signed": (21, struct.pack(">i", 27)), "byte": (22, b"\x1b"),
    "short": (66, struct.pack(">h", 27)), "long": (78, struct.pack(">Q", 27)),
    "single": (23, struct.pack(">f", 27)), "double": (24, struct.pack(">d", 27))}  # fmt: skip


@pytest.mark.parametrize("kind", TYPES)
def test_the_lens_is_read_from_the_video_or_its_track(tmp_path, kind):
    said = meta(*TYPES[kind], mpeg4=kind in ("text", "short"))
    for place in ("of_video", "of_track"):
        path = recording(tmp_path / "a.mov", **{place: said})
        assert quicktime_numbers(path) == {KEY: 27}
        assert recorded(path, SIZE) == pytest.approx(27 / 43.27 * 80)
    both = recording(tmp_path / "b.mov", of_video=said, of_track=meta(1, b"50"))
    assert quicktime_numbers(both)[KEY] == 27


def test_other_videos_record_no_lens(tmp_path):
    others = [(1, b"wide"), (1, b"27", "com.apple.make"), (13, b"27"), (1, b"0"), (1, b"nan"),
              (1, b"1e9"), (21, struct.pack(">i", -27))]  # fmt: skip
    for said in (b"", *(meta(*other) for other in others)):
        assert recorded(recording(tmp_path / "a.mov", of_track=said), SIZE) is None


def photograph(path, size=SIZE, **tags):
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({int(number[1:]): value for number, value in tags.items()})
    Image.new("RGB", size).save(path, exif=exif)
    return path


def test_the_lens_is_read_from_a_photograph_that_records_one(tmp_path):
    path = photograph(tmp_path / "0.jpg", _41989=26)
    assert recorded(tmp_path, SIZE) == pytest.approx(26 / 43.27 * 80)
    assert recorded((path,), SIZE) == recorded(tmp_path, SIZE)
    for tags in ({}, {"_41989": 0}, {"_41989": "wide"}):
        assert recorded((photograph(path, **tags),), SIZE) is None
    Image.new("RGB", SIZE).save(path, exif=b"Exif\0\0MM\0*\0\0\0\x08\xff\xff")  # broken tags
    assert recorded(tmp_path, SIZE) is None


def test_wide_pictures_are_cut_from_a_sensor_of_4_to_3():
    """So a video of 1920 x 1080 has the focal length of the photograph that is as wide."""
    assert in_pixels(26, (1920, 1080)) == pytest.approx(in_pixels(26, (1920, 1440)))
    assert in_pixels(26, (1080, 1920)) == in_pixels(26, (1920, 1080))
    assert in_pixels(43.27, (3000, 2000)) == pytest.approx(np.hypot(3000, 2000))


def test_a_user_gives_pixels_millimetres_or_what_is_recorded():
    assert asked_for("1450", None, SIZE) == 1450
    assert asked_for("recorded", 77.0, SIZE) == 77
    assert asked_for("26mm", None, SIZE) == asked_for("26 mm", 50.0, SIZE) == in_pixels(26, SIZE)
    with pytest.raises(InputError, match="no focal length is recorded.*--lens 26mm"):
        asked_for("recorded", None, SIZE)
    low, high = in_pixels(7, SIZE), in_pixels(1200, SIZE)
    beyond = ("1mm", "2000mm", str(0.99 * low), str(1.01 * high))
    for wrong in ("", "0mm", "-26mm", "nan", "26cm", *beyond):
        with pytest.raises(InputError, match="--lens must be a focal length in pixels"):
            asked_for(wrong, 77.0, SIZE)


@pytest.fixture
def track(seen):
    rotations, transl = seen
    n = len(transl)
    transl = transl + np.linspace((-1.5, 0, 0), (1.5, 0.4, 1), n)
    K = np.tile(centred(900, (640, 480)), (n, 1, 1))
    return Track("0", np.arange(n), rotations, transl, None, K, "SMPL-X", has_hands=True)


def projected(track, points):
    seen = points @ track.K.swapaxes(-1, -2)
    return seen[..., :2] / seen[..., 2:]


def pelvises(track):
    return track.places[:, None]


def test_another_lens_keeps_place_size_and_side_in_the_picture(track):
    """The pelvis in the picture, how many pixels a metre there has, and where the eye is."""
    track.K[:, 0, 0] *= 1.1  # pixels that are not square become so
    other = through_lens(track, centred(400.0, (700, 500)))
    places = [projected(t, pelvises(t)) for t in (track, other)]
    assert np.abs(places[0] - places[1]).max() < 1e-9
    a_metre = lambda t: np.sqrt(t.K[:, 0, 0] * t.K[:, 1, 1]) / pelvises(t)[:, 0, 2]
    assert np.abs(a_metre(track) / a_metre(other) - 1).max() < 1e-12
    sides = []
    for t in (track, other):
        ray = pelvises(t)[:, 0] / np.linalg.norm(pelvises(t)[:, 0], axis=1, keepdims=True)
        R = roma.rotvec_to_rotmat(torch.from_numpy(t.rotations[:, 0])).numpy()
        sides.append(np.einsum("nji,nj->ni", R, ray))  # of the eye, in the axes of the person
    assert np.abs(sides[0] - sides[1]).max() < 1e-9
    assert np.array_equal(track.rotations[:, 1:], other.rotations[:, 1:])


def test_prepare_reports_the_recorded_lens_and_takes_it(tmp_path, cli, seen, footage):
    rotations, transl = seen
    body = rotations[:, 1:22].reshape(len(transl), -1)
    named = {"global_orient": rotations[:, 0], "body_pose": body, "transl": transl}
    np.savez(tmp_path / "poses.npz", **named, betas=np.zeros(10), focal=np.array(200.0))
    (tmp_path / "photos").mkdir()
    for k in range(len(transl)):
        photograph(tmp_path / f"photos/{k}.jpg", _41989=26)
    given = ("prepare", "parameters", tmp_path / "poses.npz", tmp_path / "s", *footage, "--frames",
             tmp_path / "photos", "--overwrite")  # fmt: skip
    said = cli.works(*given)
    assert "the poses are for a focal length of 200 pixels; the video file records 48" in said
    far = load_video(tmp_path / "s")
    said = cli.works(*given, "--lens", "recorded")
    assert "the focal length is 48 pixels, the estimator assumed 200" in said
    near, body = load_video(tmp_path / "s"), load_body()
    assert near.cameras[0].fx == pytest.approx(26 / 43.27 * 80)
    a, b = (body(v.pose, v.shape).joints[:, 0].double().numpy() for v in (far, near))
    assert np.allclose(b[:, 2] / a[:, 2], near.cameras[0].fx / 200, rtol=1e-5)
    for k in range(len(near)):
        assert np.abs(far.cameras[k].project(a[k]) - near.cameras[k].project(b[k])).max() < 1e-3
