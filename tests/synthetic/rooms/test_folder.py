"""The folder of a subject in a room: a film, soft masks, held-out pictures on white."""

import json

import numpy as np
import pytest

from gva_mi.body.pose import load_poses
from gva_mi.data.cameras import load_cameras
from gva_mi.data.film import Film
from gva_mi.data.pictures import read_image
from gva_mi.data.video import load_video
from gva_mi.synthetic import SynthOptions, make_subject

pytest.importorskip("mitsuba")
OPTIONS = dict(
    frames=3, size=64, samples=16, clothes=False, hair=False, novel_poses=1, novel_views=0,
    noise=0.0, scene="room", camera="held", shutter=0.05,
)  # fmt: skip


@pytest.mark.slow
def test_a_folder_of_a_room(body, tmp_path):
    for name, workers in (("room", 1), ("again", 2)):
        make_subject(tmp_path / name, SynthOptions(workers=workers, **OPTIONS), body)
    room, again = tmp_path / "room", tmp_path / "again"
    names = {str(path.relative_to(room)) for path in room.rglob("*") if path.is_file()}
    assert all((room / name).read_bytes() == (again / name).read_bytes() for name in names)
    video, film = load_video(room), Film(room / "film.mp4")
    assert len(video) == len(film) == 3
    pose, shape = load_poses(room / "truth/poses.npz")
    for k, frame in enumerate(video.frames()):
        beside = frame.image[frame.mask < 0.01]
        assert (beside > 0.97).mean() < 0.5 and beside.std() > 0.03  # not white
        assert np.abs(film[k] / 255 - frame.image).mean() < 0.05
        # The true pose is that of the middle of the exposure, and no pixel of it is cut off.
        camera = load_cameras(room / "truth/cameras.npz")[k]
        column, row = camera.project(body(pose[k], shape).vertices[0].double().numpy()).T
        seen = frame.mask[row.astype(int), column.astype(int)]
        assert (seen > 0).mean() > 0.97
    held_out = read_image(room / "truth/novel_pose/frames/000000.png", 3)
    mask = read_image(room / "truth/novel_pose/masks/000000.png", 1)
    assert (held_out[mask == 0] == 255).all()
    about = json.loads((room / "truth/film.json").read_text())
    y = body.rest(shape).vertices[:, 1]
    assert about["height_m"] == pytest.approx(float(y.max() - y.min()), abs=1e-5)
    assert 0 <= about["tilt_deg"] <= 15 and 1.2 <= about["camera_height_m"] <= 1.7
