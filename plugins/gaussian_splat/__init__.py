"""``gaussian_splat``: the ``ellipsoids`` of a scene by splatting.

* ``ellipsoids.py``: the shapes' parameters as the Gaussians of ``gva_mi.splat``;
* ``sensor.py``: Mitsuba's sensor as its camera;
* ``other_shapes.py``: the shapes that may hide ellipsoids, and what they look like;
* ``integrator.py``: the plugin, which puts the three together. Read it first.
"""
