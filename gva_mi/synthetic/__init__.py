"""Synthetic subjects: a clothed person from a seed, its video, and their ground truth.

The packages follow the way of a subject into its folder:

=============  =====================================================================
``person``     shape and outfit, the body below, clothes, hair and colours
``motion``     motions of the video and held-out poses, with feet that do not slide
``pictures``   cameras, a room, rays and light, and the video of a phone
``errors``     error models, and the estimates of a pipeline that errs by them
``options``    all options, and the streams of random numbers
``staging``    the video before it is rendered: surfaces and cameras of every frame
``folder``     the subject's folder: written, and copied with other errors
=============  =====================================================================
"""

from gva_mi.synthetic.folder import degrade, make_subject, relit_pictures, remake_subject
from gva_mi.synthetic.options import SynthOptions

__all__ = ["SynthOptions", "degrade", "make_subject", "relit_pictures", "remake_subject"]
