"""The fit: minimise Eq. 9, and track poses through an avatar.

Nothing is imported here: ``gva-mi doctor`` uses :mod:`gva_mi.fit.perceptual` also on machines where
Dr.Jit cannot be imported yet.
"""
