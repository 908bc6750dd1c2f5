"""Synthetic subjects: a clothed person from a seed, its video, and their ground truth.

==================  ================================================================
``options``         all options
``subject_folder``  writes a subject's folder
``provenance``      an existing folder: its options, its person, other errors
``people, look``    the person: shape, colours, cut of the clothes; lamps
``rest_body``       the body below the clothes
``clothes/``        clothes and hair, and how they follow the body
``texture``         colours of skin, cloth and hair
``subject``         body, clothes and hair as one surface
``surface``         normals and smooth steps that such surfaces are made with
``stretched``       a body of other proportions than the fitted one
``closest``         ground truth on the fitted body for such a person
``motion/``         motions of the video, and held-out poses
``cameras``         cameras on white, and of a phone in a room
``staging``         poses, cameras and exposures of the video
``rooms/``          rooms, and the film of a phone
``render, rays``    rays and light; rays of a picture's samples
``pictures``        files of one picture, by one process or several
``error_models/``   error models of poses, masks and normals
``estimates``       estimates of a pipeline with such errors
==================  ================================================================
"""

from gva_mi.synthetic.estimates import describe_errors
from gva_mi.synthetic.options import SynthOptions
from gva_mi.synthetic.provenance import degrade, remake_subject
from gva_mi.synthetic.subject_folder import make_subject

__all__ = ["SynthOptions", "degrade", "describe_errors", "remake_subject", "make_subject"]
