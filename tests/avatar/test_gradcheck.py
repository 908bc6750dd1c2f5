"""The avatar's gradients are right, and a fault in any link is named by it."""

import gva_mi  # noqa: F401  (chooses libLLVM before Dr.Jit is imported)

import json  # isort: skip
from dataclasses import replace  # isort: skip

import pytest
import torch

from gva_mi.avatar import carry, stretch
from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.canonical import CanonicalGaussians
from gva_mi.avatar.gradcheck import Scene, Tolerances, chain, gradcheck
from gva_mi.body import kinematics
from gva_mi.body.smplx import BodyModel
from gva_mi.splat.kernels.frozen import Frozen

SMALL = {"gaussians": 60, "size": 16}
GAUSSIANS = {"means", "quats", "log_scales", "logit_opacities", "sh"}
INPUTS = {"rotations", "transl", "expression", "betas", "light"} | GAUSSIANS


class Slanted(torch.autograd.Function):
    """The identity with a gradient that is 0.1 % too long."""

    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, g):
        return 1.001 * g

    @staticmethod
    def jvp(ctx, t):
        return t.clone()


@pytest.fixture(scope="module")
def scene():
    return Scene.random(**SMALL)


@pytest.fixture(scope="module")
def report(scene):
    return gradcheck(scene, entries=2)


def test_every_gradient_is_right(report):
    assert report.passed, report.table()
    assert "comparisons pass" in report.verdict and report.band < 0.05 * report.pixels


def test_every_input_is_compared_by_every_method(scene, report):
    avatar = scene.models[torch.float64][1]
    network = {f"residual.{name}" for name, _ in avatar.residual.named_parameters()}
    found = {}
    for row in report.rows:
        found.setdefault(row.method, set()).add(row.name)
    pictures = {"color", "alpha", "depth"}
    for method in ("tangent f64", "tangent f32", "differences"):
        assert found[method] == INPUTS | network, method
    for method in ("adjoint f64", "adjoint f32"):
        assert found[method] == INPUTS | network | pictures, method


def test_no_comparison_is_of_nothing(scene):
    """Every input moves the picture, so that no gradient is right by being zero."""
    leaves = {k: v.clone().requires_grad_() for k, v in scene.values.items()}
    picture = scene.animated(leaves)
    found = torch.autograd.grad(picture.color.square().sum(), list(leaves.values()))
    for name, g in zip(leaves, found, strict=True):
        assert g.norm() > 0, name


def test_says_which_link_loses_digits(report):
    shares = {link.name: link.alone32 for link in report.links}
    assert set(shares) == set(LINKS)
    assert shares[report.coarsest.name] == max(shares.values())
    assert all(0 < share < 1e-5 for share in shares.values()), shares


def _plant(monkeypatch, link):
    """A small fault in the avatar's own code of one link."""
    bend = Slanted.apply
    if link == "shape":
        rest = BodyModel.rest
        bent = lambda self, shape: rest(self, type(shape)(bend(shape.betas)))
        monkeypatch.setattr(BodyModel, "rest", bent)
    elif link == "skeleton":
        vee = kinematics._vee
        monkeypatch.setattr(kinematics, "_vee", lambda x: 1.001 * vee(x))
    elif link == "blend shapes":
        found = Avatar.coefficients
        monkeypatch.setattr(Avatar, "coefficients", lambda self, R, psi: bend(found(self, R, psi)))
    elif link == "residual":
        monkeypatch.setattr(torch, "tanh", lambda x: bend(x.tanh()))
    elif link == "blend":
        blended = CanonicalGaussians.blended
        bent = lambda self, T, means: blended(self, bend(T), means)
        monkeypatch.setattr(CanonicalGaussians, "blended", bent)
    elif link == "stretch":
        adjoint = stretch.adjoint
        bent = lambda *lane: [[1.001 * g for g in grads] for grads in adjoint(*lane)]
        monkeypatch.setattr(stretch, "adjoint", bent)
        monkeypatch.setattr(carry, "_adjoint", Frozen(carry._adjoint.function))  # records it
    elif link == "activations":
        scales = lambda self: torch.exp(bend(self.log_scales))
        monkeypatch.setattr(CanonicalGaussians, "scales", property(scales))
    elif link == "colours":
        lit = chain.lit
        monkeypatch.setattr(chain, "lit", lambda sh, *args: lit(bend(sh), *args))
    else:
        render = chain.render
        monkeypatch.setattr(chain, "render", lambda g, *a, **k: render(
            replace(g, covars=bend(g.covars)), *a, **k))  # fmt: skip


LINKS = (
    "shape", "skeleton", "blend shapes", "residual", "blend", "activations", "stretch",
    "colours", "splatting",
)  # fmt: skip


@pytest.mark.parametrize("link", LINKS)
def test_a_fault_is_named_by_its_link(scene, monkeypatch, link):
    _plant(monkeypatch, link)
    report = gradcheck(scene, entries=0)
    assert [part.name for part in report.links if not part.passed] == [link]
    assert f"WRONG in {link} (" in report.verdict


def test_links_that_are_put_together_wrongly_are_told_from_wrong_links(scene, monkeypatch):
    animate = Avatar.animate

    def forgets(self, pose):
        return animate(self, type(pose)(pose.rotations.detach(), pose.transl, pose.expression))

    monkeypatch.setattr(Avatar, "forward", lambda self, pose: forgets(self, pose).gaussians)
    report = gradcheck(scene, entries=0)
    assert not report.passed and all(link.passed for link in report.links)
    assert "every link is right alone" in report.verdict and "rotations" in report.verdict


def test_too_few_digits_are_no_fault(scene):
    report = gradcheck(scene, Tolerances(f32=1e-9), entries=2)
    assert not report.passed
    assert report.verdict.startswith("less accurate than allowed, most by ")


def test_figures_as_json(report):
    figures = json.loads(json.dumps(report.to_dict()))
    assert figures["passed"] and set(figures["links"]) == set(LINKS)
    assert figures["links"]["skeleton"]["alone32"] == next(
        link.alone32 for link in report.links if link.name == "skeleton"
    )
