"""``mesh_normals``: normals and silhouettes of meshes with correct gradients.

The files, in the order in which they build on one another:

====================  ==============================================================
``segment_sums``      sums in a fixed order
``topology``          corners, points, normals and edges, which do not change as
                      vertices move
``surface``           shading normals and depths from positions
``projection``        projection of a sensor, from the world to pixels and back
``pixel_filter``      samples to pixels, of a picture or of several crops of it
``rays``              the channels of an image, the faces that rays meet, and the
                      channels there
``interior``          the first term of the derivative: points that stay on a face
``contours``          the second: contours
``intersections``     the third: lines in which surfaces intersect
``mesh_view``         the image with its tangent and adjoint, from all of these
``integrator``        the plugin
====================  ==============================================================

To understand the method, read ``mesh_view``, then ``contours``. ``gva-mi gradcheck normals``
checks the derivative.
"""
