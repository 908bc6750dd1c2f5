"""``gaussian_splat``: the ``ellipsoids`` of a scene by splatting."""
