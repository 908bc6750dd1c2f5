"""Viewer of an avatar in the browser, drawn by the kernels that trained it.

* ``state.py``: what defines a picture: the panel's state and a browser's camera, as values;
* ``session.py``: the one thread that draws the newest state, coarse first, then all pixels;
* ``panel.py``: viser's sliders and buttons, and the state they define;
* ``server.py``: viser's server and its pages. Only these two use viser.
"""
