"""``gaussian_splat``: the ``ellipsoids`` of a scene by splatting.

* ``integrator.py``: the plugin. Read it first.
* ``scene.py``: the scene's ellipsoids as Gaussians, its sensor as a camera, and the other shapes,
  which may hide ellipsoids.
"""
