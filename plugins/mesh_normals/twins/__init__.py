"""What ``mesh_normals`` is checked with: other ways to the same numbers, slow ones.

The twins work in float64 and share no code with the integrator (a test reads their imports):

* ``moving_mesh.py``: what they look at, meshes of which each vertex has a speed;
* ``measured_sensor.py``: what they look through, a sensor as its own rays show it;
* ``differences.py``: the derivative by differences of images, and its interior part;
* ``scanlines.py``: its boundary part without step and without rays, exact on lines of the image.

``projective.py`` is the third way, and an integrator of its own: ``mesh_normals_projective``, with
Mitsuba's projective sampling at the boundary. It shares with ``mesh_normals`` what a shading normal
is, and nothing that concerns motion.
"""
