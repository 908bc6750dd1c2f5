"""Readers and writers of other programs' files of Gaussians.

Readers return, and writers take, Gaussians in the axes of the .ply of 3DGS: x right, y down, z
forward. :func:`gva_mi.splat.axes.half_turned` turns them to this program's world and back.

==================  =======================================================
``ply``             the .ply of 3D Gaussian Splatting and its viewers
``spz``             Niantic's, about 20 bytes a Gaussian before compression, and
                    the .splat, 32 bytes a Gaussian, for viewers in a browser
``stored``          numbers to store, and Gaussians read back, for all formats
==================  =======================================================
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gva_mi.splat.formats.ply import load_ply
from gva_mi.splat.formats.spz import load_splat, load_spz
from gva_mi.splat.gaussians import Gaussians

LOAD: dict[str, Callable[[Path], Gaussians]] = {
    ".ply": load_ply, ".splat": load_splat, ".spz": load_spz,
}  # fmt: skip
