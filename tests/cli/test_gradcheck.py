"""``gva-mi gradcheck``: what it writes, what it refuses, and that it fails on a wrong gradient."""

import importlib
import json
from dataclasses import replace

import pytest

from gva_mi.cli.gradcheck import PICTURE, REPORT, GradcheckOptions, gradcheck
from gva_mi.core.errors import InputError
from gva_mi.gradcheck.engine import Comparison, Report

command = importlib.import_module("gva_mi.cli.gradcheck")


def test_splat_writes_figures_and_a_picture(scene, tmp_path, capsys):
    gradcheck("splat", GradcheckOptions(2, window=8), scene=scene, out=tmp_path / "out")
    figures = json.loads((tmp_path / "out" / REPORT).read_text())
    assert figures["passed"] and len(figures["scenes"]) == 2
    assert (tmp_path / "out" / PICTURE).stat().st_size > 1000
    assert "gradcheck splat: all gradients are right" in capsys.readouterr().out


def test_splat_looks_through_other_cameras(scene, capsys):
    changes = {"camera_model": "fisheye", "antialiased": True}
    gradcheck("splat", GradcheckOptions(1, window=8, **changes), scene=scene)
    out = capsys.readouterr().out
    assert "all gradients are right" in out


def test_it_fails_where_a_gradient_is_wrong(scene, monkeypatch):
    def wrong(gaussians, camera, options, background):
        image = render(gaussians, camera, options, background)
        return type(image)(1.01 * image.color, image.alpha, image.depth)

    render = command.render
    monkeypatch.setattr(command, "render", wrong)
    with pytest.raises(InputError, match="WRONG"):
        gradcheck("splat", GradcheckOptions(1, window=8), scene=scene)


def test_avatar_and_normals_write_one_table_each(monkeypatch, tmp_path, capsys):
    right = Comparison("tangent f32", "a limb: mask", 1e-3, 1e-4, (), 1e-2)
    wrong = replace(right, error=0.1, name="a limb: boundary")
    monkeypatch.setattr(command.PosedAvatar, "random", lambda seed, body: None)
    monkeypatch.setattr(command, "check_avatar", lambda *a, **k: Report((right,), "an avatar"))
    gradcheck("avatar", GradcheckOptions(2, seed=3), out=tmp_path)
    figures = json.loads((tmp_path / REPORT).read_text())
    assert figures["passed"] and list(figures["scenes"]) == ["pose 3", "pose 4"]
    monkeypatch.setattr(command, "check_normals", lambda count: count * [[right, wrong]])
    with pytest.raises(InputError, match="WRONG: tangent f32 of a limb: boundary"):
        gradcheck("normals", GradcheckOptions(2), out=tmp_path)
    figures = json.loads((tmp_path / REPORT).read_text())
    assert not figures["passed"] and len(figures["scenes"]["mesh_normals"]["rows"]) == 4
    assert "a limb: boundary" in capsys.readouterr().out
    assert not (tmp_path / PICTURE).exists()


def test_an_option_of_another_check_is_refused_with_its_name(cli):
    for what, option, value, of in (
        ("avatar", "--window", 8, "splat"), ("normals", "--seed", 8, "splat"),
        ("normals", "--scene", "x.npz", "splat"), ("splat", "--body", "body.npz", "avatar"),
    ):  # fmt: skip
        code, _, err = cli("gradcheck", what, option, value)
        expected = f"there is no {option}; it is an option of `gva-mi gradcheck {of}`"
        assert code == 2 and expected in err
