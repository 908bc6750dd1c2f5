"""Who makes the puppet: a body sculpted by a program, and pictures to judge any body by.

``python -m gva_mi.sculptor`` rebuilds ``gva_mi/body/puppet.npz``, to the bit. The way there:

==================  ================================================================
``solids``          balls, cones, lofts, and their smooth union as a surface
``anatomy``         where the joints are, and which solids make the left half
``mirror``          from the left half to a closed, symmetric surface
``rig``             skinning weights and the joint regressor
``shapes``          directions of shape, expression and pose
``sculpt``          all of it in order, to the arrays of an SMPL-X file
==================  ================================================================

Beside it, for any body in SMPL-X's format: ``portrait`` draws it, ``portrait_poses`` says in which
poses.
"""
