"""What landmarks say of poses, for both stages.

``rig.py`` places landmarks on the body, ``landmark_noise.py`` infers how far off they are, and
``swaps.py`` finds frames in which left and right were exchanged.
"""
