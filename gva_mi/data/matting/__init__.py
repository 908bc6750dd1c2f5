"""Masks of a film that hold at the person's outline.

A network knows roughly where the person is; the pictures know exactly where the outline runs.

===============  ===============================================================================
:mod:`.grid`     the part of the pictures that is looked at, and its resolution
:mod:`.camera`   how the camera moved between pictures
:mod:`.plate`    the background without the person, gathered over the whole film
:mod:`.colors`   the person's colours, by height
:mod:`.shadows`  how dark the person's shadows are
:mod:`.odds`     evidence of each pixel: person or background
:mod:`.cut`      the smoothest outline that agrees with the evidence
:mod:`.alpha`    how much of each outline pixel is the person
:mod:`.scene`    what a film shows as a whole, and the mask of one picture
:mod:`.film`     all of it for a film: start here
===============  ===============================================================================
"""
