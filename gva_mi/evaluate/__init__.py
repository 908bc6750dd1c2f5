"""Metrics and reports of a run. No step that refines or fits reads anything from here.

Metrics, each a row of one long table:

===============  ===================================================================
``figures``      the table, and the pivot that makes every page of it
``scores``       metrics of one render; scores of renders of any method
``regions``      the pixels that these metrics use
``measure``      means over the splits of a video, and ``metrics.json`` of a run
``similarity``   the alignment to the ground truth
``surface``      how Gaussians lie on the true surface
``pose_errors``  pose errors before and after refinement
``refinement``   ``refinement.json`` of a subject
===============  ===================================================================

Pages:

===============  ===================================================================
``page``         the one writer of HTML pages
``pictures``     avatars beside the ground truth
``report``       the pages of a run and of a phone video's avatar
===============  ===================================================================
"""
