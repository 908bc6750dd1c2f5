"""What the tests of several commands share."""

import numpy as np
import pytest
from samples.scenes import few_gaussians

from gva_mi.body.pose import load_poses, save_poses
from gva_mi.body.smplx import load_body
from gva_mi.subject.video import load_video
from gva_mi.subject.video_file import write_video

FRAMES = 12  # of the video below


@pytest.fixture
def scene(tmp_path):
    """A file with 8 Gaussians before a camera."""
    return few_gaussians(tmp_path / "scene.ply")


@pytest.fixture
def run(known, turning, tmp_path):
    """A run's folder: the avatar, and the poses that were trained with it."""
    known.save(tmp_path / "run/avatar.npz")
    save_poses(tmp_path / "run/poses.npz", *turning(3), stage=2)
    return tmp_path / "run"


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A folder with a short video of a synthetic subject, and its height."""
    from gva_mi.prior.body_height import Stature
    from gva_mi.synthetic import SynthOptions, make_subject

    folder, body = tmp_path_factory.mktemp("filmed") / "subject", load_body()
    options = SynthOptions(seed=150, frames=FRAMES, size=256, samples=4, novel_poses=0,
        novel_views=0, error_model="none")  # fmt: skip
    make_subject(folder, options, body)
    video = load_video(folder)
    images = [np.round(frame.image * 255).astype(np.uint8) for frame in video.frames()]
    write_video(folder / "video.mp4", images, fps=10, way="playable")
    shape = load_poses(folder / "truth/poses.npz")[1]
    return folder / "video.mp4", round(float(Stature.of(body).height(shape)), 2)
