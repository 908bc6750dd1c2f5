"""``mesh_normals``: normals and silhouettes of meshes with right gradients.

The files, in the order in which they build on one another:

* ``segment_sums.py``: sums in a fixed order;
* ``topology.py``: corners, points, normals and edges, which do not change as vertices move;
* ``surface.py``: shading normals and depths from positions;
* ``projection.py``: projection of a sensor, from the world to pixels and back;
* ``pixel_filter.py``: samples to pixels, of a picture or of several crops of it;
* ``rays.py``: the channels of an image, the faces that rays meet, and the channels there;
* ``interior.py``, ``contours.py``, ``intersections.py``: the three terms of the derivative;
* ``mesh_view.py``: the image with its tangent and adjoint, from all of these;
* ``integrator.py``: the plugin.

To understand the method, read ``mesh_view.py``, then ``contours.py``. ``gva-mi gradcheck normals``
checks the derivative.
"""
