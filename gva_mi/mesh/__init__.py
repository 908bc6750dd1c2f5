"""Meshes in Mitsuba: normals and silhouettes, differentiable in torch.

* ``surface.py``: normals and Laplacian of a surface, a body with fewer faces, in torch;
* ``mesh_scene.py``: render vertices through a camera, by the plugin ``mesh_normals``; which
  vertices are visible from given places;
* ``overlay.py``: pictures of a mesh, alone or over a photograph.
"""
