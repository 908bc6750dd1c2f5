"""Avatars for other programs, and an avatar without its body.

Gaussians in one pose are written by :mod:`gva_mi.splat.formats`.

=================  ===============================================================
``gltf``           the surface with skeleton, skin, colours, and a motion (.glb)
``glb``            the container of that: numbers and their description
``amass``          poses as AMASS has them
``without_body``   the avatar without what it holds of a licensed body
=================  ===============================================================
"""
