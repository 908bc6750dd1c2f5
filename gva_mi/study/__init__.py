"""Evaluation, reports and studies. No step that refines or fits reads anything from here.

* ``scores.py``, ``regions.py``: metrics of one render, and the pixels they use;
* ``score_pictures.py``, ``picture_pairs.py``: scores of any method's renders;
* ``evaluate.py``: their means over the splits of a video; ``similarity.py``: the alignment;
  ``fitted_poses.py``: under poses that are fitted to the very pictures;
* ``surface.py``: how Gaussians lie on the true surface;
* ``metrics.py``: ``metrics.json`` of a run; ``report.py``: its page; ``overview.py``: the first
  picture there; ``film_report.py``: the page of a film's avatar;
* ``pictures.py``: avatars beside the ground truth, for the page of a run and of a study;
* ``measure.py``: pose errors before and after refinement;
* ``refinement.py``: ``refinement.json`` of a subject; ``pose_tables.py``: its figures on a page;
* ``cases.py``, ``subjects.py``: tuning and held-out cases, and their videos; ``filmed.py``: those
  whose estimates are made from the pictures; ``film_errors.py``: what is learned from them;
* ``engine.py``: cases x variants -> figures, one resumable file; ``refine_study.py`` and
  ``avatar_study.py`` (with ``variants.py``) define the two studies;
* ``tables.py``: their tables and pages;
* ``multiview.py``, ``calibrated.py``: real films against what several cameras see;
* ``page.py``: the one writer of HTML pages.
"""
