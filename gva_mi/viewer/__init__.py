"""An avatar in the browser: turned, posed and played, by the same kernels that trained it.

* ``state.py``: what is shown, as a value; and how a motion plays;
* ``cameras.py``: a browser's camera, and where it starts;
* ``keyframes.py``: interpolate views to the cameras of a film;
* ``surface.py``, ``skeleton.py``: pose and draw what lies under the Gaussians;
* ``drawing.py``: from a state and a camera to a picture;
* ``session.py``: the one thread that draws the newest state, coarse first and then whole;
* ``controls.py``: the panel and its state; ``server.py``: the browsers. Only these two use viser.
"""
