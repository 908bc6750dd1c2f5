"""Generator of the built-in body.

``python -m gva_mi.synthetic.body_generator`` rebuilds its file bit by bit.

==================  ================================================================
``solids``          ellipsoids, cones, lofts, and their smooth union as a surface
``anatomy``         joint positions, and the solids of the left half
``mirror``          from the left half to a closed, symmetric surface
``rig``             skinning weights and joint regressor
``shapes``          directions of shape, expression and pose
``generate``        all of it in order, to the arrays of an SMPL-X file
==================  ================================================================
"""
