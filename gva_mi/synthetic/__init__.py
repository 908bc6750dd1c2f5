"""Synthetic subjects: a clothed person from a seed, its video, and their ground truth.

==================  ================================================================
``options``         all options
``subject_folder``  a subject's folder: its poses, cameras and exposures; copied with other errors
``people``          the person: shape, colours, cut of the clothes
``rest_body``       the body below the clothes, and closed surfaces around it
``garments, hair``  clothes and hair as such surfaces
``dressing``        how they follow the body
``subject``         body, clothes and hair as one surface, with folds
``texture``         colours of skin, cloth and hair
``foreign_body``    a body that the fitted one does not span, and its closest pose
``motion``          motions of the video, and held-out poses
``actions``         squats, steps, and gestures with the arms
``footwork``        feet that do not slide, legs that reach for them
``cameras``         cameras on white; the phone in a room, and its video
``furniture, room`` rooms
``render``          rays and light
``error_models``    distributions over the errors of a recording
``pose_errors``     errors of poses and camera
``picture_errors``  errors of masks and normals
``estimates``       estimates of a pipeline with such errors
==================  ================================================================
"""

from gva_mi.synthetic.options import SynthOptions
from gva_mi.synthetic.subject_folder import degrade, make_subject, remake_subject

__all__ = ["SynthOptions", "degrade", "make_subject", "remake_subject"]
