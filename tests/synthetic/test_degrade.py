"""Degrading a recording gives the folder that these errors would have made."""

import os
from dataclasses import replace

import pytest

from gva_mi import InputError
from gva_mi.data.cameras import load_cameras
from gva_mi.data.video import load_video
from gva_mi.synthetic import degrade, describe_errors, make_subject
from gva_mi.synthetic.error_models.models import ERROR_MODELS, draw_errors


@pytest.fixture(scope="module")
def degraded(noisy, body, tmp_path_factory):
    """Return a function that degrades the recording by an error model, once."""
    folder = tmp_path_factory.mktemp("degraded")

    def made(error_model):
        if not (folder / error_model).exists():
            degrade(noisy, folder / error_model, error_model, 7, body)
        return folder / error_model

    return made


@pytest.mark.parametrize("error_model", ["normals", pytest.param("masks", marks=pytest.mark.slow)])
def test_it_equals_make_subject(degraded, body, bare, files, tmp_path, error_model):
    make_subject(tmp_path / "made", replace(bare, error_model=error_model, noise_seed=7), body)
    assert files(tmp_path / "made") == files(degraded(error_model))


def test_frames_and_ground_truth_are_linked(noisy, degraded):
    for path in sorted(noisy.rglob("*")):
        name = path.relative_to(noisy)
        if path.is_file() and name.parts[0] in ("frames", "truth", "video.mp4"):
            assert os.path.samefile(path, degraded("focal") / name), name


@pytest.mark.slow
@pytest.mark.parametrize("error_model", ERROR_MODELS)
def test_every_error_model_opens_as_a_video_and_is_described(degraded, error_model):
    video = load_video(degraded(error_model))
    assert len(video) == 3 and not video.absent
    assert describe_errors(degraded(error_model))[0].startswith(
        f"noise: error model {error_model}, seed 7"
    )


def test_the_estimated_and_the_true_camera_are_written(noisy, degraded):
    factor = 1 + draw_errors("focal", 7).pose.focal
    paths = (degraded("focal") / "truth", degraded("focal"), noisy)
    (true,), (estimated,), (before,) = (load_cameras(path / "cameras.npz") for path in paths)
    assert (true.K == before.K).all() and factor != 1
    assert (true.T_camera_world == estimated.T_camera_world).all()
    assert estimated.fx == pytest.approx(factor * true.fx)
    assert estimated.fy == pytest.approx(factor * true.fy)


def test_other_folders_are_refused(noisy, body, tmp_path):
    with pytest.raises(InputError, match="synth.json: no such file; expected a folder that gva-mi"):
        degrade(tmp_path, tmp_path / "out", "white", 0, body)
    with pytest.raises(InputError, match="already there"):
        degrade(noisy, noisy, "white", 0, body)
    (tmp_path / "synth.json").write_text('{"options": {"colour": 1}}')
    with pytest.raises(InputError, match="synth.json: of another form"):
        degrade(tmp_path, tmp_path / "out", "white", 0, body)
    assert not (tmp_path / "out").exists()
