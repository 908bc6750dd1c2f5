"""Studies: many synthetic subjects, and real videos before several cameras.

* ``cases.py``: tuning and held-out cases, and variants; ``filmed.py``: the videos of cases;
* ``engine.py``: cases x variants -> figures (:mod:`gva_mi.evaluate.figures`), one resumable file;
* ``report.py``: a study's tables and page;
* ``multiview.py``: stage 1 of one camera against what several calibrated cameras see.

No step that refines or fits reads anything from here.
"""
