"""Masks of a video that hold at the person's outline.

A network knows roughly where the person is; the pictures know exactly where the outline runs.

================  ==================================================================================
:mod:`.video`      masks of a video, and the smoothest outline with its soft pixels: start here
:mod:`.camera`    the part of the pictures that is looked at, and how the camera moved
:mod:`.plate`     the background without the person, gathered over the whole video
:mod:`.odds`      evidence of each pixel: person or background, by colours and shadows
================  ==================================================================================
"""
