"""Meshes in Mitsuba: normals and silhouettes, differentiable in torch.

==============  ====================================================================
``surface``     normals and Laplacian of a surface, a body with fewer faces, in torch
``mesh_scene``  vertices rendered through a camera, by the plugin ``mesh_normals``;
                which vertices are visible from given places
``overlay``     pictures of a mesh, alone or over a photograph
==============  ====================================================================
"""
