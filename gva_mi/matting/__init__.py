"""Masks of a video, exact at the person's outline.

A network knows roughly where the person is. The pictures show exactly where the outline runs.

==========  ========================================================================
``masks``   all masks of a video, by the smoothest outline and its soft pixels: start here
``camera``  the working grid around the person, and the camera's motion
``plate``   the background behind the person, and captions before, over the whole video
``odds``    log odds of each pixel, person against background, by colours and shadows
==========  ========================================================================
"""
