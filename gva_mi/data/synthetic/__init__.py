"""Synthetic subjects: a clothed person from a seed, its video, and what is true about both."""

from gva_mi.data.synthetic.dataset import SynthOptions, make_subject

__all__ = ["SynthOptions", "make_subject"]
