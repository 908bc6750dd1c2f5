import pytest
import torch

from gva_mi.errors import InputError
from gva_mi.fit import run_folder


def test_a_folder_is_prepared_once(tmp_path):
    run_folder.prepare(tmp_path / "run", {"steps": 3}, resume=False)
    with pytest.raises(InputError, match="already holds a run"):
        run_folder.prepare(tmp_path / "run", {"steps": 3}, resume=False)
    run_folder.prepare(tmp_path / "run", {"steps": 3}, resume=True)


def test_a_run_is_resumed_with_its_own_options(tmp_path):
    run_folder.prepare(tmp_path, {"steps": 3, "rates": {"sh": 0.1}}, resume=True)
    with pytest.raises(InputError, match="steps = 3, not 4"):
        run_folder.prepare(tmp_path, {"steps": 4, "rates": {"sh": 0.1}}, resume=True)


def test_a_folder_with_a_foreign_avatar_is_left_alone(tmp_path):
    (tmp_path / run_folder.AVATAR).write_bytes(b"something precious")
    with pytest.raises(InputError, match="choose another folder"):
        run_folder.prepare(tmp_path, {}, resume=True)


def test_a_state_comes_back_to_the_bit(tmp_path):
    state = {"step": 7, "avatar": {"x": torch.randn(4)}, "history": {"loss": [0.1, 0.2]}}
    assert run_folder.load_state(tmp_path) is None
    run_folder.save_state(tmp_path, state)
    found = run_folder.load_state(tmp_path)
    assert torch.equal(found["avatar"]["x"], state["avatar"]["x"])
    assert found["history"] == state["history"] and found["step"] == 7


def test_a_write_that_fails_leaves_the_old_file(tmp_path):
    run_folder.save_state(tmp_path, {"step": 1})
    with pytest.raises(Exception, match="pickle"):
        run_folder.save_state(tmp_path, {"step": lambda: 2})
    assert run_folder.load_state(tmp_path) == {"step": 1}


def test_a_broken_checkpoint_is_named(tmp_path):
    (tmp_path / run_folder.CHECKPOINT).write_bytes(b"cut short")
    with pytest.raises(InputError, match="not a readable checkpoint"):
        run_folder.load_state(tmp_path)
