"""Avatars: canonical Gaussians on a skeleton, their density control and re-initialisation."""

from gva_mi.avatar.avatar import seed_avatar

__all__ = ["seed_avatar"]
