"""``mesh_normals``: normals and silhouettes of meshes with right gradients.

The files, in the order in which they build on one another:

* ``segment_sums.py``: sums in an order that never changes;
* ``topology.py``: corners, points, normals and edges, which stay as vertices move;
* ``surface.py``: shading normals and depths from positions;
* ``projection.py``: from a sensor to pixels and back;
* ``channels.py``: what an image holds;
* ``pixel_filter.py``: from samples to pixels; ``mosaic.py``: to those of several pictures;
* ``rays.py``: what rays meet and see there;
* ``interior.py``, ``contours.py``, ``intersections.py`` (by ``triangle_cuts.py``): the three terms
  of the derivative;
* ``sensor_motion.py``: the derivative by the sensor's pose;
* ``mesh_view.py``: all of it, the image with its tangent and adjoint;
* ``integrator.py``: the plugin.

To understand the method, read ``mesh_view.py``, then ``contours.py``. ``twins/`` is what it is
checked with.
"""
