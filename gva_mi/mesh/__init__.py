"""Meshes seen by Mitsuba: normals and silhouettes of a body, differentiable; pictures of them."""
