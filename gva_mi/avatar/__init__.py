"""What is learned: canonical Gaussians on a skeleton, and how they grow and keep to a surface."""

from gva_mi.avatar.avatar import Animated, Avatar, AvatarOptions, Rig, seed_avatar
from gva_mi.avatar.canonical import CanonicalGaussians, SeedOptions, seed_on_surface
from gva_mi.avatar.residual import PoseResidual, ResidualOptions

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
