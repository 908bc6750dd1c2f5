"""Evaluation, reports and studies. No step that refines or fits reads anything from here.

Metrics, each a row of one long table:

* ``figures.py``: the table, and the pivot that makes every page of it;
* ``scores.py``, ``regions.py``: metrics of one render, and the pixels they use; scores of renders
  of any method;
* ``evaluate.py``: their means over the splits of a video, and ``metrics.json`` of a run;
  ``similarity.py``: the alignment to the ground truth;
* ``surface.py``: how Gaussians lie on the true surface;
* ``refinement.py``: pose errors before and after refinement, and ``refinement.json`` of a subject.

Pages:

* ``page.py``: the one writer of HTML pages;
* ``pictures.py``: avatars beside the ground truth;
* ``report.py``: the pages of a run, of a film's avatar, and of a study.

Studies:

* ``cases.py``: tuning and held-out cases, and variants; ``filmed.py``: the videos of cases;
* ``engine.py``: cases x variants -> figures, one resumable file;
* ``multiview.py``: real films against what several cameras see.
"""
