"""Avatars: canonical Gaussians on a skeleton, their density control and re-initialisation.

===================  ===================================================================
``avatar``           ``Avatar``: from a pose to plain Gaussians; start here
``canonical``        canonical Gaussians: the learned surface in the rest pose
``rig``              the rest body, and the skin that clothes and hair follow
``residual``         the residual that depends on the pose (Sec. 4.1)
``skin_gaussians``   Gaussians skinned by LBS, with their light: one kernel each way
``lbs_transforms``   LBS transforms and their spatial derivatives, as kernel functions
``lbs_reference``    reference implementation of skinned Gaussians, in torch
``densify``          clones, splits and prunes Gaussians, as 3DGS does
``surface``          a closed surface around the Gaussians
``reinit``           Gaussians put back on this surface (Sec. 4.3)
``held``             Gaussians kept near the body and its clothes
``stage``            ``Stage``: an avatar in a Mitsuba scene, with shadows and the scene's light
``export``           surface and poses for other programs
``without_body``     an avatar's file without the licensed body model
===================  ===================================================================
"""

from gva_mi.avatar.avatar import seed_avatar

__all__ = ["seed_avatar"]
