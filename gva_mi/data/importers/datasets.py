"""Data sets with pictures and masks of their own: one record for each.

:mod:`.one_camera` and :mod:`.multi_view` hold the readers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gva_mi.core.errors import InputError, expecting
from gva_mi.data.importers import multi_view, one_camera
from gva_mi.data.importers.capture import Capture
from gva_mi.data.importers.target import TargetBody


@dataclass(frozen=True)
class DataSet:
    """Rules that recognise and read a data set's folder."""

    files: tuple[str, ...]  # all of them are there, each "a" or "a|b"
    read: Callable[[str, Path, str | None, TargetBody], Capture]  # where, folder, camera, body
    expects: str  # for messages

    def recognises(self, folder: Path) -> bool:
        """Whether a folder holds the files of this data set."""
        return all(any((folder / x).exists() for x in name.split("|")) for name in self.files)


DATASETS = {
    "instantavatar": DataSet(
        ("cameras.npz", "images", "masks", "poses.npz|poses_optimized.npz"),
        one_camera.instantavatar, "cameras.npz, images/, masks/ and poses.npz",
    ),
    "zju": DataSet(
        ("annots.npy",), multi_view.zju, "annots.npy, new_params/ and mask_cihp/",
    ),
    "easymocap": DataSet(
        ("intri.yml", "extri.yml"), multi_view.easymocap,
        "intri.yml, extri.yml, images/ and smpl/ with a .json a frame",
    ),
    "avatarrex": DataSet(
        ("calibration_full.json", "smpl_params.npz"), multi_view.avatarrex,
        "calibration_full.json, smpl_params.npz and a folder a camera",
    ),
    "exavatar": DataSet(
        ("smplx_optimized/shape_param.json", "frames"), one_camera.exavatar,
        "frames/, masks/, cam_params/ and smplx_optimized/",
    ),
}  # fmt: skip


def dataset_of(folder: Path) -> str | None:
    """Return the kind of data set in a folder; None for any other folder."""
    return next((kind for kind, record in DATASETS.items() if record.recognises(folder)), None)


def read_dataset(kind: str, folder: Path, camera: str | None, body: TargetBody) -> Capture:
    """Read people, pictures and masks from a data set's folder of one subject.

    ``camera`` names the one that becomes the video; None: the first. Poses are for ``body``.
    """
    record = DATASETS[kind]
    if not record.recognises(folder):
        raise InputError(
            f"{folder}: not of the kind {kind}; expected a folder with {record.expects}"
        )
    with expecting(f"{folder} (of the kind {kind})", record.expects):
        return record.read(str(folder), folder, camera, body)
