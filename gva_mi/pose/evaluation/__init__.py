"""How well refined poses fit: nothing here is read by a step that refines or fits.

* ``measure.py``: distances to the truth and to the masks, frame by frame and in the mean;
* ``record.py``: what a refinement leaves in a subject's folder;
* ``ablation.py``: the same with a term of the loss left out in turn;
* ``refinement_report.py``: a page with all of it;
* ``study.py``: people that no setting was chosen on.
"""
