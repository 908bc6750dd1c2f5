"""An avatar in the browser: turned, posed and played, by the same kernels that trained it.

* ``state.py``: what is shown, as a value; and how a motion plays;
* ``eyes.py``: a browser's camera, and where it begins;
* ``keyframes.py``: some of them become the cameras of a film;
* ``surface.py``, ``skeleton.py``: what lies under the Gaussians, posed and drawn;
* ``drawing.py``: from a state and a camera to a picture;
* ``session.py``: the one thread that draws: the newest state only, coarse and then whole;
* ``controls.py``: the panel, and the state that it says; ``server.py``: the browsers. These two
  know viser, the rest works without it.
"""
