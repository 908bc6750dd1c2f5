"""Gradient checks: the renderer, your own renderer, an avatar, the rendered normals.

Every check returns a ``Report``, a list of comparisons with errors and tolerances::

    from gva_mi.gradcheck import gradcheck, random_scene

    report = gradcheck(my_render, random_scene(torch.Generator().manual_seed(0)))
    assert report.passed, report.table()

An adjoint is right if <w, J v> = <Jᵀ w, v> for all v and w (the dot-product test: Claerbout, "Earth
Soundings Analysis", 1992). The checks compare it with tangents, differences and other programs.

===============  ===================================================================
``engine``       comparisons by all methods, a report, its table and JSON
``probes``       directions, tangents and finite differences
``causes``       guesses why a renderer is wrong
``splat``        a renderer against the reference implementation; its pictures
``avatar``       an avatar from pose to picture
``normals``      ``mesh_normals`` by the body's pose, against the next two
``scanlines``    reference of the boundary
``moving_mesh``  reference of the interior
===============  ===================================================================

Importing this package needs only drjit, numpy and torch; import ``avatar`` and ``normals`` by name.
"""

from gva_mi.gradcheck.probes import difference_image, tangent_image
from gva_mi.gradcheck.splat import gradcheck
from gva_mi.splat.scene import random_scene

__all__ = ["difference_image", "gradcheck", "random_scene", "tangent_image"]
