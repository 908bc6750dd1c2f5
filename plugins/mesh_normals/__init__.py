"""``mesh_normals``: normals and silhouettes of meshes with right gradients."""
