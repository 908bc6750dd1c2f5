"""``gaussian_splat``: the ``ellipsoids`` of a scene by splatting.

==============  ====================================================================
``integrator``  the plugin: start here
``scene``       the scene's ellipsoids as Gaussians, its sensor as a camera, and the
                other shapes, which may hide ellipsoids
==============  ====================================================================
"""
