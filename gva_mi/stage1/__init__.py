"""Stage 1: a phone's video becomes a subject with poses, shape, camera and masks.

========================  ============================================================
``prepare``               all of it: video in, subject's folder out: start here
``pictures``              the video's pictures at an even rate
``solver``                poses, one shape and the camera, of all frames together
``evidence``              residuals of landmarks (:mod:`gva_mi.observe.rig`)
``body_prior``            residuals of the prior
``normal_equations``      Levenberg-Marquardt on block-banded equations
``arm_depths``            how far arms reach toward the camera
``upright``               how far the camera looks down
``face``                  head, jaw and expression
``video_check``           how to film the person better
========================  ============================================================
"""
