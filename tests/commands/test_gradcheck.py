"""``gva-mi gradcheck``: what it writes, and what it refuses."""

import json

import pytest

from gva_mi.commands import gradcheck as command
from gva_mi.commands.gradcheck import PICTURE, REPORT, GradcheckOptions, gradcheck
from gva_mi.errors import InputError


def test_gradcheck_writes_figures_and_a_picture(scene, tmp_path, capsys):
    gradcheck("splat", GradcheckOptions(8, 2), scene=scene, out=tmp_path / "out")
    figures = json.loads((tmp_path / "out" / REPORT).read_text())
    assert figures["passed"] and len(figures["scenes"]) == 2
    assert (tmp_path / "out" / PICTURE).stat().st_size > 1000
    assert "gradients are right in all 2 windows" in capsys.readouterr().out


@pytest.mark.parametrize("model", ["pinhole", "ortho", "fisheye"])
def test_gradcheck_looks_through_other_cameras(model, scene, capsys):
    changes = {"camera_model": model, "antialiased": True, "channels": 5, "images": ("depth",)}
    gradcheck("splat", GradcheckOptions(8, 1, **changes), scene=scene)
    out = capsys.readouterr().out
    assert "gradients are right in all 1 windows" in out and " colors " in out


@pytest.mark.parametrize("wrong", [{"window": 0}, {"count": 0}, {"channels": -1}, {"images": ()}])
def test_gradcheck_refuses_what_shows_nothing(wrong):
    with pytest.raises(InputError, match="must be|1 or more"):
        GradcheckOptions(**wrong)


def test_gradcheck_fails_where_a_gradient_is_wrong(scene, monkeypatch):
    def wrong(gaussians, camera, options, background):
        image = render(gaussians, camera, options, background)
        return type(image)(1.01 * image.color, image.alpha, image.depth)

    render = command.render
    monkeypatch.setattr(command, "render", wrong)
    with pytest.raises(InputError, match="WRONG"):
        gradcheck("splat", GradcheckOptions(8, 1), scene=scene)


def test_an_avatar_is_checked_and_its_figures_written(monkeypatch, tmp_path, capsys):
    random = command.AvatarScene.random
    small = lambda seed, body: random(seed, gaussians=60, size=16, body=body)
    monkeypatch.setattr(command.AvatarScene, "random", small)
    gradcheck("avatar", GradcheckOptions(count=1), out=tmp_path)
    figures = json.loads((tmp_path / REPORT).read_text())
    assert figures["passed"] and list(figures["scenes"]) == ["pose 0"]
    assert "gradients are right in all 1 poses" in capsys.readouterr().out
    assert not (tmp_path / PICTURE).exists()


@pytest.mark.parametrize(
    ("what", "given", "says"),
    [
        ("avatar", {"options": GradcheckOptions(window=8)}, "it has --count, --seed and --body"),
        ("avatar", {"scene": "person.npz"}, "it has --count, --seed and --body"),
        ("splat", {"body": "body.npz"}, "there is no --body"),
    ],
)
def test_what_one_of_them_does_not_know_is_refused(what, given, says):
    with pytest.raises(InputError, match=says):
        gradcheck(what, **given)
