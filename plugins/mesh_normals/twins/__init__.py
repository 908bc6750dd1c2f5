"""What ``mesh_normals`` is checked with: slow, in float64, no code shared with it."""
