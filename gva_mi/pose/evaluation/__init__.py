"""How well refined poses fit: nothing here is read by a step that refines or fits.

* ``errors.py``: distances to the truth, frame by frame; ``surface_distance.py`` of foreign bodies;
* ``silhouette.py``: agreement with masks;
* ``measure.py``: both, of stage 1 and of refined poses; ``figures.py``: their means;
* ``record.py``: what a refinement leaves in a subject's folder;
* ``ablation.py``: the same with a term of the loss left out in turn;
* ``refinement_report.py``: a page with all of it;
* ``cases.py``: people, bodies and noise by which choices are made, and others by which they are
  judged; ``subjects.py`` makes their folders, ``study.py`` refines them, ``summary.py`` sums up by
  family of noise, ``study_file.py`` keeps what is done.
"""
