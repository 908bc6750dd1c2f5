"""Synthetic subjects: a clothed person from a seed, its video, and what is true about both.

==========================================  ====================================================
People       ``people``                     who it is: shape, colours, the cut of the clothes
             ``rest_body``                  the body below the clothes
             ``clothes/``                   what is worn, and how it moves with the body
             ``texture``, ``color``         colours of skin, cloth and hair
             ``subject``                    all of it as one surface
Figure       ``stretched``                  a body of other proportions than the fitted one
             ``closest``                    what a perfect estimator says of it with the fitted one
Motion       ``motion/``                    what the video shows, and poses that it does not show
Pictures     ``render``                     rays, light, and the camera
             ``camera_effects``             background, blur, noise of the sensor
             ``shots``                      the files of one picture, by one process or several
Noise        ``noise/``                     families of wrong poses, masks and normals
             ``estimates``                  what a pipeline makes of a recording, with such noise
The folder   ``options``                    all that can be chosen
             ``dataset``                    makes a subject's folder
             ``degrade``                    the same recording under another noise
             ``recorded``                   what a folder was made of, and its person drawn again
             ``contact_sheet``              a picture of all subjects and of one's folder
==========================================  ====================================================
"""

from gva_mi.data.synthetic.dataset import make_subject
from gva_mi.data.synthetic.degrade import degrade
from gva_mi.data.synthetic.estimates import describe_noise
from gva_mi.data.synthetic.options import SynthOptions
from gva_mi.data.synthetic.people import STUDY
from gva_mi.data.synthetic.recorded import drawn_again

__all__ = ["STUDY", "SynthOptions", "degrade", "describe_noise", "drawn_again", "make_subject"]
