"""Whether an avatar's gradients are right, from a pose to a picture, link by link.

chain.py lists the links; twins.py is each link once more, slow and by autograd alone; check.py
compares them; verdict.py holds the figures.

    report = gradcheck(Scene.random(load_body()))
    assert report.passed, report.table()
"""

from gva_mi.avatar.gradcheck.chain import Scene
from gva_mi.avatar.gradcheck.check import Tolerances, gradcheck
from gva_mi.avatar.gradcheck.verdict import Report

__all__ = ["Report", "Scene", "Tolerances", "gradcheck"]
