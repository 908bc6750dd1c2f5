"""The articulated body in torch: Eq. 4, and the skinning of Eq. 5 and 6.

==================  ================================================================
``pose``            ``Pose`` and ``Shape``, and their files
``smplx``           the parametric body: from shape and pose to vertices and joints
``body_file``       body files of SMPL-X, SMPL+H and SMPL, and the built-in one
``anny``            a realistic body that needs no licence
``kinematics``      from joint rotations to rigid transforms
``rotations``       conversions of rotations, in numpy
``so3``             composition of rotations
``skinning``        LBS of points and Gaussians
``polar``           the rotation nearest to a blend of rotations
``gestures``        hand poses
==================  ================================================================
"""
