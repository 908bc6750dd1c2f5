"""Stage 1: a phone's video becomes a subject with poses, shape, camera and masks.

========================  ============================================================
``prepare``               the whole stage, from a video to a subject's folder: start here
``pictures``              the video's pictures at an even rate
``vertical_lines``        how the camera is tilted, by lines of the room
``solver``                poses, one shape and the camera, of all frames together
``unknowns``              the unknowns of the solver
``evidence``              residuals of landmarks, depths, soles and upright people
``posed_points``          points on the body and their derivatives
``leaning``               trunk and centre of mass against the direction up
``body_prior``            residuals of the prior
``normal_equations``      Levenberg-Marquardt steps on block-banded equations
``arm_depths``            how far arms reach toward the camera
``face``                  head, jaw and expression
``video_check``           how to film the person better
========================  ============================================================
"""
