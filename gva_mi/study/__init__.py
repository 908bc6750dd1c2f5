"""Studies: many synthetic subjects, and real videos before several cameras.

* ``cases.py``: tuning and held-out cases; ``videos.py``: their videos;
* ``variants.py``: the ways to make an avatar that are compared;
* ``engine.py``: cases x variants -> figures (:mod:`gva_mi.evaluate.figures`), one resumable file;
  ``refine_study.py``, ``avatar_study.py``: the two studies;
* ``report.py``: a study's tables and page;
* ``multiview.py``: stage 1 of one camera against what several calibrated cameras see.

No step that refines or fits reads anything from here.
"""
