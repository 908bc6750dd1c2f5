"""``gaussian_splat``: the ``ellipsoids`` of a scene by splatting.

* ``integrator.py``: the plugin. Read it first.
* ``ellipsoids.py``: converts the shapes' parameters to the Gaussians of ``gva_mi.splat``.
* ``sensor.py``: converts Mitsuba's sensor to a camera.
* ``other_shapes.py``: picture and depth of the shapes that may hide ellipsoids.
"""
