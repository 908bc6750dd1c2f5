"""What arguments mean that several commands have."""

from pathlib import Path

from gva_mi.commands.arguments import poses_of


def test_refined_poses_win_and_those_of_stage_1_are_said(tmp_path, capsys):
    assert poses_of(tmp_path) == tmp_path / "poses.npz"
    assert "no poses_refined.npz, the stage-1 poses are used as they are" in capsys.readouterr().out
    (tmp_path / "poses_refined.npz").touch()
    assert poses_of(tmp_path) == tmp_path / "poses_refined.npz"
    assert poses_of(tmp_path, Path("others.npz")) == Path("others.npz")
    assert capsys.readouterr().out == ""
