"""The articulated body in torch: Eq. 4, and the skinning of Eq. 5 and 6.

==================  ================================================================
``pose``            ``Pose`` and ``Shape``, and their files
``smplx``           the parametric body: from shape and pose to vertices and joints
``body_file``       body files of SMPL-X, SMPL+H and SMPL
``smpl``            body files of the older formats on SMPL-X's joints
``built_in, anny``  the two bodies that need no licence
``kinematics``      from joint rotations to rigid transforms
``rotations``       conversions of rotations, in numpy
``so3``             composition of rotations
``blend_shapes``    a surface plus a weighted sum of directions
``skinning``        LBS of points and Gaussians
``polar``           the rotation nearest to a blend of rotations
``gestures``        hand poses
==================  ================================================================
"""
