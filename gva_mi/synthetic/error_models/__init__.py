"""Error models of stage-1 poses, masks and normals; level 1 is usual, 0 is exact.

``models`` draws the sizes of errors; ``poses`` with ``camera_bias`` and ``outliers``, ``masks``
and ``normals`` apply them; ``processes`` are random curves and fields.
"""
