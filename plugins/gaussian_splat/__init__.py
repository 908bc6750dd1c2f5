"""``gaussian_splat``: the ``ellipsoids`` of a scene by splatting.

==============  ====================================================================
``integrator``  the plugin: start here
``scene``       the scene's ellipsoids as Gaussians, its sensor as a camera, and the
                other shapes, which may hide ellipsoids
``lighting``    the scene's light on ellipsoids, measured on a mesh that stands for them,
                by a sensor that looks past this mesh and one that looks at it
==============  ====================================================================
"""
