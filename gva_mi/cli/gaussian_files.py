"""Write Gaussians in files of other programs, and say what of them is left out."""

from __future__ import annotations

from pathlib import Path

from gva_mi.core.console import say
from gva_mi.splat import Gaussians
from gva_mi.splat.axes import half_turned
from gva_mi.splat.formats.compressed_ply import save_compressed_ply
from gva_mi.splat.formats.ply import save_ply
from gva_mi.splat.formats.splat import save_splat
from gva_mi.splat.formats.spz import save_spz
from gva_mi.splat.formats.stored import finite_ones, with_degree
from gva_mi.splat.principal_axes import with_axes

COMPRESSED = ".compressed.ply"  # the ending by which SuperSplat knows its files, too
SAVE = {
    ".ply": save_ply, COMPRESSED: save_compressed_ply, ".splat": save_splat, ".spz": save_spz,
}  # fmt: skip


def save_gaussians(
    path: Path,
    suffix: str,
    gaussians: Gaussians,
    source: Path,
    degree: int | None,
    in_world: bool = False,
) -> None:
    """Write Gaussians, without those that hold NaN or infinite numbers.

    Args:
        path: of the file.
        suffix: its kind, in :data:`SAVE`.
        gaussians: torch tensors, in the axes of files (:mod:`gva_mi.splat.axes`).
        source: of the Gaussians, for messages.
        degree: of their spherical harmonics; None: as they are.
        in_world: they are in the world's axes instead.
    """
    kept = finite_ones(source, gaussians)
    if len(kept) < len(gaussians):
        lost = len(gaussians) - len(kept)
        say(f"{path}: {lost} of {len(gaussians)} Gaussians hold NaN or infinite numbers: left out")
    if gaussians.antialiased and suffix != ".spz":
        say(f"{path}: {source} is to be drawn antialiased (Mip-Splatting), as only a .spz can say")
    kept = half_turned(with_axes(kept)) if in_world else kept
    SAVE[suffix](path, kept if degree is None else with_degree(kept, degree))
