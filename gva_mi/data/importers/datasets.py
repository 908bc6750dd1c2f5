"""Data sets that come with their own pictures and masks; each is told by its files.

``people_snapshot``, ``multi_view``, ``neuman`` and ``exavatar`` hold the readers, and what each
expects.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gva_mi.data.importers import exavatar, multi_view, neuman, people_snapshot
from gva_mi.data.importers.estimators import told
from gva_mi.data.importers.recordings import Recording, Wanted
from gva_mi.errors import InputError


def dataset_of(folder: Path) -> str | None:
    """The kind of a folder that is a data set; None of anything else."""
    return next((kind for kind, (fits, _, _) in DATASETS.items() if fits(folder)), None)


def read_dataset(kind: str, folder: Path, wanted: Wanted) -> Recording:
    """A data set's people, pictures and masks.

    Args:
        kind: one of :data:`DATASETS`.
        folder: of one subject.
        wanted: of it.

    Raises:
        InputError: the folder is of another kind, or not of its form.
    """
    fits, read, what = DATASETS[kind]
    if not fits(folder):
        raise InputError(f"{folder}: not of the kind {kind}; expected a folder with {what}")
    return told(folder, kind, what, read, folder, wanted)


Reader = Callable[[str, Path, Wanted], Recording]
DATASETS: dict[str, tuple[Callable[[Path], bool], Reader, str]] = {
    "snapshot": (
        people_snapshot.is_snapshot, people_snapshot.read_snapshot,
        "camera.pkl, masks.hdf5, reconstructed_poses.hdf5 and a film",
    ),
    "instantavatar": (
        people_snapshot.is_instantavatar, people_snapshot.read_instantavatar,
        "cameras.npz, images/, masks/ and poses.npz",
    ),
    "zju": (multi_view.is_zju, multi_view.read_zju, "annots.npy, new_params/ and mask_cihp/"),
    "easymocap": (
        multi_view.is_easymocap, multi_view.read_easymocap,
        "intri.yml, extri.yml, images/ and smpl/ with a .json a frame",
    ),
    "avatarrex": (
        multi_view.is_avatarrex, multi_view.read_avatarrex,
        "calibration_full.json, smpl_params.npz and a folder a camera",
    ),
    "neuman": (
        neuman.is_neuman, neuman.read_neuman,
        "images/, segmentations/, sparse/, alignments.npy and smpl_output_romp.pkl",
    ),
    "exavatar": (
        exavatar.is_exavatar, exavatar.read_exavatar,
        "frames/, masks/, cam_params/ and smplx_optimized/",
    ),
}  # fmt: skip
