"""NeuMan: somebody walks past a camera that moves, in a scene that COLMAP reconstructed.

==========  ===================================================  =============================
Kind        Folder, by the public repository's own code          Camera
==========  ===================================================  =============================
``neuman``  ``images/``, ``segmentations/``, ``alignments.npy``  ``sparse/cameras.txt`` and
            and ``smpl_output_optimized.pkl``, or ``_romp``      ``images.txt``, of COLMAP
            (apple/ml-neuman)
==========  ===================================================  =============================

An alignment (4, 3) takes the rows of SMPL's vertices, posed and not translated, to the scene, x =
s A b + t; what is seen is the same as of the body that is not scaled, A b + t/s before the camera.
Masks are 255 around the person. The published pictures have no distortion any more; where
``cameras.txt`` says one, it is taken out as everywhere.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import roma
import torch

from gva_mi.data.importers.frame_files import plain
from gva_mi.data.importers.readings import make_track, seen_from
from gva_mi.data.importers.recordings import Recording, Wanted
from gva_mi.data.importers.whole_videos import last_number
from gva_mi.data.video import Splits
from gva_mi.errors import InputError
from gva_mi.pickles.reader import read_objects

_POSES = ("smpl_output_optimized.pkl", "smpl_output_romp.pkl")
_LENSES = {  # COLMAP's models: where fx, fy, cx, cy and k1, k2, p1, p2, k3 are among the numbers
    "PINHOLE": ((0, 1, 2, 3), ()), "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3,)), "RADIAL": ((0, 0, 1, 2), (3, 4)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
}  # fmt: skip


def is_neuman(folder: Path) -> bool:
    return (folder / "alignments.npy").is_file() and (folder / "sparse/images.txt").is_file()


def read_neuman(where: str, folder: Path, wanted: Wanted) -> Recording:
    path = next((folder / name for name in _POSES if (folder / name).is_file()), None)
    if path is None:
        raise InputError(f"{folder}: has none of {', '.join(_POSES)}")
    person = next(iter(read_objects(path, "pose and betas of one person").values()))
    alignments = plain(read_objects(folder / "alignments.npy", "an alignment a picture, by name"))
    views = _views(folder / "sparse")
    names = sorted((n for n in views if n in alignments), key=last_number)
    if not names:
        raise InputError(f"{folder}: no picture of sparse/images.txt is in alignments.npy")
    rows = [last_number(name) for name in names]
    poses = np.stack([np.ravel(x) for x in person["pose"]])[rows]
    betas = np.stack([np.ravel(x) for x in person["betas"]])[rows]
    R, T, K, lens = (np.stack([views[name][k] for name in names]) for k in range(4))
    if lens.any() and ((lens != lens[0]).any() or (K != K[0]).any()):
        raise InputError(
            f"{folder / 'sparse/cameras.txt'}: lenses with distortion that differ from picture to "
            "picture; expected one, or pictures without, as COLMAP's image_undistorter writes them"
        )
    A = np.stack([np.asarray(alignments[name], np.float64).T for name in names])  # (n, 3, 4)
    scale = np.cbrt(np.linalg.det(A[:, :, :3]))
    if not (scale > 0).all():
        raise InputError(f"{folder}: an alignment of alignments.npy is no scaled rotation")
    track = make_track(str(path), "0", np.arange(len(names)), {"pose": poses, "betas": betas}, K)
    place = (np.einsum("nij,nj->ni", R, A[:, :, 3]) + T) / scale[:, None]
    track = seen_from(track, R @ A[:, :, :3] / scale[:, None, None], place)
    pictures = tuple(folder / "images" / name for name in names)
    masks = tuple(folder / "segmentations" / name for name in names)
    splits = _splits(folder, names)
    return Recording([track], pictures, masks, lens[0], splits=splits, around=True)


def _views(folder: Path) -> dict[str, tuple[np.ndarray, ...]]:
    """R (3, 3), T (3,), K (3, 3) and (k1, k2, p1, p2, k3) of each picture, by its name."""
    lenses = {}
    for line in _lines(folder / "cameras.txt"):
        number, model, _, _, *numbers = line.split()
        if model not in _LENSES:
            raise InputError(
                f"{folder / 'cameras.txt'}: a lens {model}; expected one of {', '.join(_LENSES)}"
            )
        places, bent = _LENSES[model]
        fx, fy, cx, cy = (float(numbers[k]) for k in places)
        distortion = np.zeros(5)
        distortion[: len(bent)] = [float(numbers[k]) for k in bent]
        lenses[number] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), distortion
    views = {}
    for line in _lines(folder / "images.txt")[::2]:  # every other line lists points
        _, w, x, y, z, *T, lens, name = line.split()
        quat = torch.tensor([float(q) for q in (x, y, z, w)], dtype=torch.float64)
        R = roma.unitquat_to_rotmat(quat / quat.norm()).numpy()
        views[Path(name).name] = (R, np.array([float(t) for t in T]), *lenses[lens])
    return views


def _lines(path: Path) -> list[str]:
    """A file's lines without its comments."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError):
        raise InputError(f"{path}: not readable; expected COLMAP's text") from None
    return [line for line in lines if not line.startswith("#")]


def _splits(folder: Path, names: list[str]) -> Splits | None:
    """Of ``train_split.txt`` and ``test_split.txt``, which list pictures."""
    paths = [folder / f"{name}_split.txt" for name in ("train", "test")]
    if not all(path.is_file() for path in paths):
        return None
    places = {name: k for k, name in enumerate(names)}
    listed = [[places[n.strip()] for n in _lines(path) if n.strip() in places] for path in paths]
    return Splits(*listed)
