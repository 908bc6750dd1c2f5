"""Viewer of an avatar in the browser, drawn by the kernels that trained it.

===========  =======================================================================
``state``    what defines a picture: the panel's state and a browser's camera
``session``  the one thread that draws the newest state, coarse first
``panel``    viser's sliders and buttons, and the state they define
``server``   viser's server and its pages
===========  =======================================================================

Only ``panel`` and ``server`` use viser.
"""
