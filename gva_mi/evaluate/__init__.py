"""Metrics and reports of a run. No step that refines or fits reads anything from here.

Metrics, each a row of one long table:

* ``figures.py``: the table, and the pivot that makes every page of it;
* ``scores.py``, ``regions.py``: metrics of one render, and the pixels they use; scores of renders
  of any method;
* ``measure.py``: their means over the splits of a video, and ``metrics.json`` of a run;
  ``similarity.py``: the alignment to the ground truth;
* ``surface.py``: how Gaussians lie on the true surface;
* ``pose_errors.py``, ``refinement.py``: pose errors before and after refinement, and
  ``refinement.json`` of a subject.

Pages:

* ``page.py``: the one writer of HTML pages;
* ``pictures.py``: avatars beside the ground truth;
* ``report.py``: the pages of a run and of a phone video's avatar.
"""
