"""Avatars: canonical Gaussians on a skeleton, their density control and re-initialisation."""

from gva_mi.avatar.avatar import Animated, Avatar, AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import CanonicalGaussians, SeedOptions, seed_on_surface
from gva_mi.avatar.residual import PoseResidual, ResidualOptions
from gva_mi.avatar.rig import Rig

__all__ = [
    "Animated",
    "Avatar",
    "AvatarOptions",
    "CanonicalGaussians",
    "PoseResidual",
    "ResidualOptions",
    "Rig",
    "SeedOptions",
    "seed_avatar",
    "seed_on_surface",
]
