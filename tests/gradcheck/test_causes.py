"""What is wrong with a renderer is named; the renderer is that of docs/gradients.md."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gva_mi.core.errors import InputError
from gva_mi.gradcheck import gradcheck, random_scene
from gva_mi.gradcheck.causes import causes
from gva_mi.splat import Image, SplatOptions, render

PAGE = (Path(__file__).parents[2] / "docs/gradients.md").read_text()
SOURCE = re.search(r"def rotations.*?(?=\n\n\noptions = )", PAGE, re.DOTALL)[0]
SMOOTH = SplatOptions(alpha_min=0, alpha_max=1, transmittance_min=0, hold_jacobian=False)


def scene(options=SMOOTH, seed=0, **kwargs):
    size = {"gaussians": 10, "width": 16, "height": 16} | kwargs
    return replace(random_scene(torch.Generator().manual_seed(seed), **size), options=options)


def renderer(line="", fault=""):
    """The page's renderer, with one line changed."""
    assert line in SOURCE
    made = {"torch": torch, "Image": Image}
    exec(SOURCE.replace(line, fault), made)
    return made["my_render"]


def beyond_the_border(options):
    """Gaussians on wide rays: most are further from the picture than the Jacobian's bound."""
    made = scene(options, gaussians=8)
    camera = replace(made.camera, fx=3 * made.camera.fx, fy=3 * made.camera.fy)
    wide = made.with_inputs(made.inputs() | {"scales": made.gaussians.scales + 0.1})
    return replace(wide, camera=camera)


@pytest.mark.parametrize("made", [
    scene(), scene(seed=5, gaussians=25), scene(channels=1), scene(gaussians=1),
    beyond_the_border(SMOOTH), scene(replace(SMOOTH, blur=1.0)),
], ids=["small", "crowded", "grey", "one", "beyond the border", "blurred"])  # fmt: skip
def test_a_right_renderer_without_cut_offs_and_depth_passes(made):
    report = gradcheck(renderer(), made)
    assert report.passed and not report.causes, report.table()
    assert len(report.rows) == 34 and any("no depth" in note for note in report.notes)


@pytest.mark.parametrize(("made", "named"), [
    (scene(SplatOptions()), ["alpha_min=0"]),
    (scene(replace(SMOOTH, antialiased=True, blur=0.0)), []),  # without a blur they are the same
    (beyond_the_border(SplatOptions()), ["alpha_min=0", "hold_jacobian=False"]),
], ids=["cut-off", "same", "cut-off and bound"])  # fmt: skip
def test_a_cut_off_that_the_renderer_does_not_have_is_named(made, named):
    report = gradcheck(renderer(), made)
    assert report.passed == (not named)
    options = re.findall(r"SplatOptions\((.*?)\)", "\n".join(report.causes))
    assert set(named) <= set(options) and (named or not options)
    assert not named or report.causes[-1].startswith("gradients: all right"), report.causes
    assert len(report.causes) <= 10


FAULTS = {
    "conic": (
        "power = ", "conics = torch.tril(conics) + torch.triu(conics, 1).detach()\n    power = ",
        {"means", "quats", "scales"}, "off-diagonal entry counts twice",
    ),
    "Jacobian": (
        "J.unflatten(1, (2, 3))", "J.detach().unflatten(1, (2, 3))", {"means"},
        "derivative of the Jacobian",
    ),
    "normalisation": (
        "quats.norm(dim=1, keepdim=True)", "quats.norm(dim=1, keepdim=True).detach()", {"quats"},
        "normalisation is not differentiated",
    ),
    "behind": (
        "passed[:-1] * alpha", "passed[:-1].detach() * alpha", {"opacities"},
        "the part behind a Gaussian",
    ),
    "detached": ("g.colors[order]", "g.colors[order].detach()", {"colors"}, "zero: is it detached"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_named(name):
    line, fault, wrong, cause = FAULTS[name]
    report = gradcheck(renderer(line, fault), scene())
    assert not report.passed
    failed = {line.split(":")[0] for line in report.causes if " wrong" in line}
    assert wrong <= failed, report.causes
    assert cause in "\n".join(report.causes) and len(report.causes) <= 10


def test_a_wrong_picture_and_one_of_another_shape_are_told():
    def darker(*args):
        image = renderer()(*args)
        return Image(0.9 * image.color, image.alpha)

    report = gradcheck(darker, scene())
    assert "colors" in "".join(report.causes) and "0.9 times the true" in "".join(report.causes)
    flat = lambda *args: Image(renderer()(*args).color.permute(2, 0, 1), renderer()(*args).alpha)
    with pytest.raises(InputError, match=r"color must be \(16, 16, 3\), got \(3, 16, 16\)"):
        gradcheck(flat, scene())
    with pytest.raises(InputError, match="but in the reference"):
        render(scene().gaussians, scene().camera, SMOOTH)


def test_few_digits_are_no_missing_factor():
    def rounded(gaussians, *args):
        few = gaussians.opacities.half() - gaussians.opacities
        return renderer()(replace(gaussians, opacities=gaussians.opacities + few.detach()), *args)

    report = gradcheck(rounded, scene())
    assert not report.passed and "factor" not in "".join(report.causes), report.causes


def test_kernels_without_the_bound_of_the_jacobian_are_right_too():
    made = beyond_the_border(SplatOptions(hold_jacobian=False))
    report = gradcheck(render, made)
    assert report.passed and not report.notes, report.table()
    assert not gradcheck(lambda g, c, o, b: render(g, c, SplatOptions(), b), made).passed
    assert list(causes(render, made.rounded(), _weights(made), {})) == []


def _weights(made):
    size = made.camera.height, made.camera.width
    return {"color": torch.ones(*size, 3), "alpha": torch.ones(size), "depth": torch.ones(size)}
