"""Data sets that come with their own pictures and masks; each is told by its files.

``people_snapshot``, ``multi_view`` and ``neuman`` hold the readers, and what each expects.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gva_mi.data.importers import multi_view, neuman, people_snapshot
from gva_mi.data.importers.estimators import told
from gva_mi.data.importers.recordings import Recording
from gva_mi.errors import InputError


def dataset_of(folder: Path) -> str | None:
    """The kind of a folder that is a data set; None of anything else."""
    return next((kind for kind, (fits, _, _) in DATASETS.items() if fits(folder)), None)


def read_dataset(kind: str, folder: Path, camera: str | None) -> Recording:
    """A data set's people, pictures and masks.

    Args:
        kind: one of :data:`DATASETS`.
        folder: of one subject.
        camera: the name of the one that becomes the video; without it, the first.

    Raises:
        InputError: the folder is of another kind, or not of its form.
    """
    fits, read, what = DATASETS[kind]
    if not fits(folder):
        raise InputError(f"{folder}: not of the kind {kind}; expected a folder with {what}")
    return told(folder, kind, what, read, folder, camera)


Reader = Callable[[str, Path, str | None], Recording]
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
}  # fmt: skip
