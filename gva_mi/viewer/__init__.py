"""Viewer of an avatar in the browser, drawn by the kernels that trained it.

* ``state.py``: the viewer's state as a value; and how a motion plays;
* ``cameras.py``: a browser's camera, where it starts, and the cameras of a film between views;
* ``surface.py``: pose and draw the mesh and skeleton under the Gaussians;
* ``drawing.py``: draw the picture of a state and a camera;
* ``session.py``: the one thread that draws the newest state, coarse first and then whole;
* ``controls.py``: the panel and its state; ``server.py``: the browsers. Only these two use viser.
"""
