"""The loop around it all: Eq. 9 minimised, and how close the avatar comes to pictures.

Nothing is imported here: ``gva-mi doctor`` asks :mod:`gva_mi.fit.perceptual` for weights, also on
machines where Dr.Jit cannot be imported yet.
"""
