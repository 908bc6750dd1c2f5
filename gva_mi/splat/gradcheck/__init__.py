"""Whether a renderer's gradients are right: independent answers side by side.

check.py compares them; directions.py moves one input at a time, by tangents and by differences;
autodiff.py is the picture by Dr.Jit's own autodiff; verdict.py holds the figures. What all are
compared with is the slow twin, :mod:`gva_mi.splat.reference`.

    report = gradcheck(render, random_scene(torch.Generator().manual_seed(0)))
    assert report.passed, report.table()
"""

from gva_mi.splat.gradcheck.check import Renderer, Tolerances, gradcheck
from gva_mi.splat.gradcheck.directions import difference_image, tangent_image
from gva_mi.splat.gradcheck.verdict import Report
from gva_mi.splat.scene import Scene, random_scene

__all__ = [
    "Renderer",
    "Report",
    "Scene",
    "Tolerances",
    "difference_image",
    "gradcheck",
    "random_scene",
    "tangent_image",
]
