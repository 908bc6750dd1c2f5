"""Prior of poses: how stage 1 errs, how people move, what bodies and the ground allow.

====================  ================================================================
``stage1_poses``      stage-1 poses, and the axes in which they are corrected
``error_model``       sizes and correlations of stage 1's errors
``process``           Gaussian process of errors and motion
``inference``         infers both models from one video
``camera_tilt``       limbs that tilt toward the camera whichever way the person faces
``anatomy``           hinge joints and their limits
``ground``            standing feet do not slide
``body_height``       a measured height sets the body's size
====================  ================================================================

Both stages use this package. A term implements :class:`gva_mi.prior.inference.PriorTerm`.
"""
