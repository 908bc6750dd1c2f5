"""Prior of corrected poses: how stage 1 errs, how people move, what bodies and the ground allow.

``inference.py`` estimates the error model and the motion model of one video; ``process.py`` makes
the Gaussian process of both. ``anatomy.py``, ``ground.py`` and the camera-locked tilt of
``inference.py`` are further terms.
"""
