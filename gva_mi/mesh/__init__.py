"""Meshes in Mitsuba: normals and silhouettes, differentiable in torch.

* ``surface.py``: normals and Laplacian of a surface, in torch alone;
* ``coarse_body.py``: a body with fewer faces;
* ``sensor.py``: a camera as a Mitsuba sensor;
* ``mesh_scene.py``: render vertices through a camera, by the plugin ``mesh_normals``;
* ``overlay.py``: pictures of a mesh, alone or over a photograph;
* ``visibility.py``: normals where rays enter and leave a mesh; vertices visible from given places.
"""
