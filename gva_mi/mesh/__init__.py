"""Meshes as Mitsuba sees them: normals and silhouettes, differentiable in torch.

* ``surface.py``: normals and Laplacian of a surface, in torch alone;
* ``sensor.py``: a camera as a Mitsuba sensor;
* ``mesh_scene.py``: from vertices and a camera to an image, around the plugin ``mesh_normals``;
* ``overlay.py``: pictures of a mesh, alone or over a photograph;
* ``visibility.py``: which vertices are seen from some places.
"""
