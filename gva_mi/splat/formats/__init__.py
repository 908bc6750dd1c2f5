"""Gaussians in files of other programs.

=========================  =======================================================
``ply``                    as 3D Gaussian Splatting and its viewers have them
``compressed_ply``         the .ply of PlayCanvas' SuperSplat, 16 bytes a Gaussian and up
``compressed_ply_writer``  how Gaussians are rounded to it
``ply_elements``           what is common to both: a .ply's header, and its tables
``splat``                  32 bytes a Gaussian, for viewers in a browser
``spz``                    Niantic's, about 20 bytes a Gaussian before they are packed
=========================  =======================================================
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gva_mi.splat.formats.ply import load_ply
from gva_mi.splat.formats.splat import load_splat
from gva_mi.splat.formats.spz import load_spz
from gva_mi.splat.gaussians import Gaussians

LOAD: dict[str, Callable[[Path], Gaussians]] = {
    ".ply": load_ply, ".splat": load_splat, ".spz": load_spz,
}  # fmt: skip
