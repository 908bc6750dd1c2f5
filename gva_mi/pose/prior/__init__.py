"""Prior of corrected poses: how stage 1 errs, how people move, what bodies and the ground allow.

``inference.py`` estimates the error model and the motion model of one video; ``process.py`` makes
the Gaussian process of both, with matrices over frames from ``frame_matrices.py``. ``anatomy.py``,
``ground.py`` and ``camera_tilt.py`` are further terms.
"""
