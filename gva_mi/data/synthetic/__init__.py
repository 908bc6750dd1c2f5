"""Synthetic subjects: a clothed person from a seed, its video, and what is true about both."""

from gva_mi.data.synthetic.dataset import SynthOptions, describe_noise, make_subject
from gva_mi.data.synthetic.people import STUDY

__all__ = ["STUDY", "SynthOptions", "describe_noise", "make_subject"]
