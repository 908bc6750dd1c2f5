"""Avatar files for other programs, and avatars without their body.

:mod:`gva_mi.splat.formats` writes the Gaussians of one pose.

=================  ===============================================================
``gltf``           the surface with skeleton, skin, colours, and a motion (.glb)
``glb``            the container of gltf: numbers and their description
``amass``          poses in AMASS's format
``without_body``   the avatar without the licensed body model
=================  ===============================================================
"""
