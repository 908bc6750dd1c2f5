"""How close an avatar comes to pictures: nothing here is read by a step that refines or fits.

* ``scores.py``: PSNR, SSIM, LPIPS, ``rand_vgg`` of two pictures; ``regions.py``: on which pixels;
* ``evaluate.py``: their means over the splits of a video;
* ``similarity.py``: the same where the truth's world is laid over the avatar's;
* ``true_surface.py``, ``surface_figures.py``: how its Gaussians lie on the person's surface;
* ``metrics.py``: all figures of a run, and its file; ``report.py``: a page with all of it;
* ``rows.py``: the method, and the same without a part; ``row_run.py`` fits one of them to one
  person, ``study.py`` all of them to several; ``summary.py`` sums up over people, ``study_file.py``
  keeps what is done, ``study_report.py`` shows it beside the paper's tables (``paper.py``).
"""
