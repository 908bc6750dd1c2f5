"""Evaluation, reports and studies. No step that refines or fits reads anything from here.

* ``scores.py``, ``regions.py``: metrics of one render, and the pixels they use;
* ``evaluate.py``: their means over the splits of a video; ``similarity.py``: the alignment;
* ``surface.py``: how Gaussians lie on the true surface;
* ``metrics.py``: ``metrics.json`` of a run; ``report.py``: its page;
* ``pictures.py``: avatars beside the ground truth, for the page of a run and of a study;
* ``measure.py``: pose errors before and after refinement;
* ``refinement.py``: ``refinement.json`` of a subject; ``pose_tables.py``: its figures on a page;
* ``cases.py``, ``subjects.py``: tuning and held-out cases, and their videos;
* ``engine.py``: cases x variants -> figures, one resumable file; ``refine_study.py`` and
  ``avatar_study.py`` (with ``variants.py``) define the two studies;
* ``tables.py``: their tables and pages;
* ``page.py``: the one writer of HTML pages.
"""
