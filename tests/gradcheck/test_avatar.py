"""The avatar's gradients are right, and an error planted in any part of the chain is found."""

from dataclasses import replace

import pytest
import torch
from samples.bent import bent

from gva_mi.avatar import skin_gaussians
from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.canonical import CanonicalGaussians
from gva_mi.body import kinematics
from gva_mi.body.smplx import BodyModel
from gva_mi.gradcheck import avatar as checked
from gva_mi.gradcheck.avatar import NETWORK, PosedAvatar, check_avatar
from gva_mi.jit.frozen import Frozen

SMALL = {"gaussians": 150, "size": 24}
GAUSSIANS = {"means", "quats", "log_scales", "logit_opacities", "sh"}
INPUTS = {"rotations", "transl", "expression", "betas", "light"} | GAUSSIANS


@pytest.fixture(scope="module")
def scene():
    return PosedAvatar.random(**SMALL)


@pytest.fixture(scope="module")
def report(scene):
    return check_avatar(scene, entries=1)


def test_every_gradient_is_right(report):
    assert report.passed, report.table()
    assert "comparisons pass" in report.verdict


def test_every_input_is_compared_by_every_method(scene, report):
    inputs = INPUTS | {name for name in scene.values if name.startswith(NETWORK)}
    assert len(inputs) > len(INPUTS) + 4
    found = {}
    for row in report.rows:
        found.setdefault(row.method, set()).add(row.name)
    pictures = {"color", "alpha", "depth"}
    assert found.pop("adjoint f32") == inputs | pictures
    assert found == dict.fromkeys(("tangent f64", "tangent f32", "differences"), inputs)


def test_no_comparison_is_of_nothing(scene):
    """Every input moves the picture, so that no gradient is right by being zero."""
    leaves = {k: v.clone().requires_grad_() for k, v in scene.values.items()}
    color, *_ = checked._images(scene, leaves)
    found = torch.autograd.grad(color.square().sum(), list(leaves.values()))
    for name, g in zip(leaves, found, strict=True):
        assert g.norm() > 0, name


def _plant(monkeypatch, link):
    """Plant a small error in the avatar's own code of one part of the chain."""
    bend = bent(gradient=1.001)
    if link == "shape":
        rest = BodyModel.rest
        planted = lambda self, shape: rest(self, type(shape)(bend(shape.betas)))
        monkeypatch.setattr(BodyModel, "rest", planted)
    elif link == "skeleton":
        vee = kinematics._vee
        monkeypatch.setattr(kinematics, "_vee", lambda x: 1.001 * vee(x))
    elif link == "blend shapes":
        found = Avatar.coefficients
        monkeypatch.setattr(Avatar, "coefficients", lambda self, R, psi: bend(found(self, R, psi)))
    elif link == "residual":
        monkeypatch.setattr(torch, "tanh", lambda x: bend(x.tanh()))
    elif link == "skinning":
        adjoint = skin_gaussians.stretch_adjoint
        planted = lambda *lane: [[1.001 * g for g in grads] for grads in adjoint(*lane)]
        monkeypatch.setattr(skin_gaussians, "stretch_adjoint", planted)
        again = Frozen(skin_gaussians._adjoint.function)  # records the planted one
        monkeypatch.setattr(skin_gaussians, "_adjoint", again)
    elif link == "activations":
        scales = lambda self: torch.exp(bend(self.log_scales))
        monkeypatch.setattr(CanonicalGaussians, "scales", property(scales))
    else:
        render = checked.render
        monkeypatch.setattr(checked, "render", lambda g, *a, **k: render(
            replace(g, covars=bend(g.covars)), *a, **k))  # fmt: skip


FOUND = {  # an input by which the gradient is wrong
    "shape": "betas", "skeleton": "rotations", "blend shapes": "expression",
    "residual": f"{NETWORK}codes", "activations": "log_scales", "skinning": "quats",
    "splatting": "log_scales",
}  # fmt: skip
QUICK = ("skeleton", "skinning")  # whose adjoints are written by hand


@pytest.mark.parametrize(
    "link", [pytest.param(k, marks=() if k in QUICK else pytest.mark.slow) for k in FOUND]
)
def test_an_error_is_found(scene, monkeypatch, link):
    _plant(monkeypatch, link)
    report = check_avatar(scene, entries=1)
    assert "WRONG" in report.verdict
    failed = {row.name for row in report.rows if not row.passed and row.method == "differences"}
    assert FOUND[link] in failed and "color" not in failed, report.table()


def test_a_forgotten_input_is_named(scene, monkeypatch):
    animate = Avatar.animate

    def forgets(self, pose):
        return animate(self, type(pose)(pose.rotations.detach(), pose.transl, pose.expression))

    monkeypatch.setattr(Avatar, "forward", lambda self, pose: forgets(self, pose).gaussians)
    report = check_avatar(scene, entries=1)
    assert {row.name for row in report.rows if not row.passed} == {"rotations"}
    assert "WRONG: differences of rotations" in report.verdict


@pytest.mark.slow
def test_too_few_digits_are_no_error(scene):
    report = check_avatar(scene, tolerances=(1e-8, 1e-9), entries=1)
    assert not report.passed
    assert report.verdict.startswith("less accurate than allowed: ")
