"""Errors of the data that a real pipeline has in place of the truth; level 1 is usual, 0 is exact.

``families`` says what goes wrong and draws how far; ``poses`` with ``camera_bias`` and
``outliers``, ``masks`` and ``normals`` do it; ``pictures`` is one frame's; ``processes`` are the
random curves and fields that errors follow; ``errors`` measures what came of it.
"""
