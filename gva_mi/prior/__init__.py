"""Prior of poses: how stage 1 errs, how people move, what bodies and the ground allow.

====================  ================================================================
``stage1_poses``      stage-1 poses, and the axes in which they err
``error_model``       sizes and correlations of stage 1's errors
``process``           the Gaussian process of errors and motion
``frame_matrices``    fast products with its matrices over frames
``inference``         estimates both models from one video; the camera-locked tilt
``anatomy``           angles that joints do not reach
``ground``            feet that stand do not slide
``stature``           a measured height sets the body's size
====================  ================================================================

Both stages use it. A prior term implements :class:`gva_mi.prior.inference.PriorTerm`.
"""
