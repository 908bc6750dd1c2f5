"""Avatars for other programs, and an avatar without its body.

=================  ===============================================================
``ply``            Gaussians in one pose as 3D Gaussian Splatting has them
``splat``          the same in 32 bytes each, for viewers in a browser
``gltf``           the surface with skeleton, skin, colours, and a motion (.glb)
``glb``            the container of that: numbers and their description
``amass``          poses as AMASS has them
``without_body``   the avatar without what it holds of a licensed body
=================  ===============================================================
"""
