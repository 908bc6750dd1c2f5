"""The folder of a run: options, video, checkpoints and trained poses."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Shape, save_poses
from gva_mi.core.errors import InputError
from gva_mi.core.files import write_arrays
from gva_mi.fit import run_folder


def test_a_folder_is_prepared_once(video, tmp_path):
    run_folder.prepare(tmp_path / "run", {"steps": 3}, video, resume=False)
    with pytest.raises(InputError, match="already holds a run"):
        run_folder.prepare(tmp_path / "run", {"steps": 3}, video, resume=False)
    run_folder.prepare(tmp_path / "run", {"steps": 3}, video, resume=True)


def test_a_run_is_resumed_with_its_own_options(video, tmp_path):
    run_folder.prepare(tmp_path, {"steps": 3, "rates": {"sh": 0.1}}, video, resume=True)
    with pytest.raises(InputError, match="steps = 3, not 4"):
        run_folder.prepare(tmp_path, {"steps": 4, "rates": {"sh": 0.1}}, video, resume=True)


def test_a_folder_with_a_foreign_avatar_is_left_alone(video, tmp_path):
    (tmp_path / run_folder.AVATAR).write_bytes(b"something precious")
    with pytest.raises(InputError, match="choose another folder"):
        run_folder.prepare(tmp_path, {}, video, resume=True)


def test_a_run_is_resumed_with_its_own_video(video, tmp_path):
    run_folder.prepare(tmp_path, {}, video, resume=True)
    moved = replace(video, pose=video.pose.map(lambda x: x + 0.01))
    assert run_folder.other_parts(tmp_path, video) == []
    assert run_folder.other_parts(tmp_path, moved) == ["poses"]
    with pytest.raises(InputError, match="fitted to another video than .* which has other poses;"):
        run_folder.prepare(tmp_path, {}, moved, resume=True)


def test_trained_poses_stay_with_their_video(video, tmp_path):
    run_folder.prepare(tmp_path, {}, video, resume=True)
    trained = video.pose.map(lambda x: x + 0.01)
    save_poses(tmp_path / run_folder.TRAINED_POSES, trained, video.shape, stage=2)
    assert torch.equal(run_folder.under_trained_poses(video, tmp_path).pose.transl, trained.transl)
    other = replace(video, cameras=[c.zoomed(1.1) for c in video.cameras])
    with pytest.raises(InputError, match="which has other cameras;"):
        run_folder.under_trained_poses(other, tmp_path)


def test_trained_poses_that_got_lost_or_are_of_another_person_are_refused(video, tmp_path):
    run_folder.prepare(tmp_path, {"poses": {"trained": True}}, video, resume=True)
    with pytest.raises(InputError, match="poses.npz: no such file; restore the run's trained"):
        run_folder.under_trained_poses(video, tmp_path)
    path, other = tmp_path / run_folder.TRAINED_POSES, Shape(video.shape.betas + 0.1)
    save_poses(path, video.pose, other, stage=2)
    with pytest.raises(InputError, match="its betas are of another person"):
        run_folder.under_trained_poses(video, tmp_path)
    save_poses(path, video.pose[:4], video.shape, stage=2)
    with pytest.raises(InputError, match="holds 4 frames, but the video has 6"):
        run_folder.under_trained_poses(video, tmp_path)
    path.unlink()
    run_folder.prepare(tmp_path / "as_given", {"poses": {"trained": False}}, video, resume=True)
    assert run_folder.under_trained_poses(video, tmp_path / "as_given") is video


def test_a_run_without_its_record_says_nothing_of_its_video(video, tmp_path):
    with pytest.raises(InputError, match="options.json: no such file; expected the options of a"):
        run_folder.other_pictures(tmp_path, video)


def test_a_run_names_the_files_of_its_poses_and_body(video, tmp_path):
    """Poses of the subject's folder are named without it, so that it may be moved."""
    body, run = tmp_path / "b.npz", tmp_path / "run"
    sources = run_folder.sources_of(video.folder / "poses.npz", body, video.folder)
    run_folder.prepare(run, {}, video, resume=False, sources=sources)
    assert run_folder.load_options(run)["sources"]["poses"] == "poses.npz"
    found = run_folder.source_of(run, "poses", video.folder)
    assert found == video.folder / "poses.npz"
    with pytest.raises(InputError, match=r"b.npz, which does not exist any more; .* --body$"):
        run_folder.source_of(run, "body", video.folder)
    assert run_folder.sources_of(body, None, video.folder) == {"poses": str(body), "body": None}
    assert run_folder.source_of(tmp_path, "poses", video.folder) is None  # an older run
    inside = run_folder.sources_of(video.folder / "b/p.npz", video.folder / "b.npz", video.folder)
    assert inside == {"poses": "b/p.npz", "body": "b.npz"}
    assert run_folder.body_of_run(run, None) is None  # it is gone
    body.touch()
    assert run_folder.body_of_run(run, None) == body
    assert run_folder.body_of_run(run, video.folder) == video.folder


def test_a_state_comes_back_to_the_bit(tmp_path):
    state = {"step": 7, "avatar": {"x": torch.randn(4)}, "history": {"loss": [0.1, 0.2]}}
    assert run_folder.load_state(tmp_path) is None
    run_folder.save_state(tmp_path, state)
    found = run_folder.load_state(tmp_path)
    assert torch.equal(found["avatar"]["x"], state["avatar"]["x"])
    assert found["history"] == state["history"] and found["step"] == 7


def _rewritten(folder):
    path = folder / run_folder.CHECKPOINT
    state = torch.load(path, weights_only=True)
    torch.save(state | {"step": -5}, path)


@pytest.mark.parametrize("change", [
    lambda folder: (folder / run_folder.CHECKPOINT).write_bytes(b"cut short"), _rewritten,
    lambda folder: (folder / run_folder.OPTIONS).write_text('{"options": {"steps": 3}}'),
])  # fmt: skip
def test_a_checkpoint_that_this_run_did_not_save_is_refused(change, tmp_path):
    (tmp_path / run_folder.OPTIONS).write_text('{"options": {"steps": 12}}')
    run_folder.save_state(tmp_path, {"step": 7})
    assert run_folder.load_state(tmp_path) == {"step": 7}
    change(tmp_path)
    with pytest.raises(InputError, match="not as this run saved it"):
        run_folder.load_state(tmp_path)


def test_steps_and_seconds_are_those_of_both_fits(tmp_path):
    for folder, milliseconds in ((tmp_path, [500.0, 1500.0]), (tmp_path / "first", [250.0] * 4)):
        assert folder == tmp_path or run_folder.steps_and_seconds(tmp_path) == (2, 2.0)
        write_arrays(folder / run_folder.HISTORY, milliseconds=np.array(milliseconds))
    assert run_folder.steps_and_seconds(tmp_path) == (6, 3.0)
