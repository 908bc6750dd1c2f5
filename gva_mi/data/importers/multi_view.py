"""Readers of multi-camera data sets; one camera, ``--camera``, becomes the video.

Their forms are those of the public code of zju3dv/neuralbody, zju3dv/EasyMocap and
lizhe00/AnimatableGaussians; ``docs/sources.md`` lists the files. ZJU-MoCap's ``T`` is in
millimetres, the others' in metres.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from gva_mi.body.rotations import to_matrices
from gva_mi.core.errors import InputError
from gva_mi.core.files import read_arrays, read_json
from gva_mi.data.importers.capture import Capture, FixedCamera
from gva_mi.data.importers.estimator_files import read_source
from gva_mi.data.importers.footage import files_of
from gva_mi.data.importers.numbering import number_in
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.importers.tracks import Track, make_track
from gva_mi.data.masks import MaskMeaning

_SMPL = (
    "output-smpl-3d/smpl", "output-smpl-3d/smplfull", "output/smplx/smpl", "output/smplh/smpl",
    "output/smpl/smpl", "output/smpl", "smpl",
)  # fmt: skip
_MATRIX = re.compile(
    r"^(\w[\w.\-]*): *!!opencv-matrix\s+rows: *(\d+)\s+cols: *(\d+)\s+dt: *\w+\s+"
    r"data: *\[([^\]]*)\]",
    re.M,
)
_JSON = "what the data set holds there"
Cameras = Mapping[str, Callable[[], FixedCamera]]


def zju(where: str, folder: Path, camera: str | None, body: TargetBody) -> Capture:
    found = read_source(folder / "annots.npy", "cams and ims, as ZJU-MoCap has them")
    cameras = {
        str(k): partial(_zju_camera, folder, found, k) for k in range(len(found["cams"]["K"]))
    }
    name, own = _chosen(folder, cameras, camera)
    params = folder / ("new_params" if (folder / "new_params").is_dir() else "params")
    # 000010.jpg, or CoreView_313_Camera_(1)_0010_...jpg
    number = lambda path: int((path.stem.split("_")[4:] or [path.stem])[0])
    people = [
        read_source(params / f"{number(path)}.npy", "poses, shapes, Rh and Th of a frame")
        for path in own.frames.values()
    ]
    track = _stacked(where, "0", range(len(people)), people, own, body)
    numbers = list(own.frames)
    return replace(_among([track], name, own, cameras, numbers), meaning=MaskMeaning(parts=True))


def _zju_camera(folder: Path, found: Mapping[str, Any], k: int) -> FixedCamera:
    """Read ZJU-MoCap's k-th camera; frames are numbered by their place in the list."""
    K, D, R, T = (np.asarray(found["cams"][key][k], np.float64) for key in "KDRT")
    names = [_inside(folder, frame["ims"][k]) for frame in found["ims"]]
    masks = folder / ("mask_cihp" if (folder / "mask_cihp").is_dir() else "mask")
    return FixedCamera.of_opencv(
        {i: folder / name for i, name in enumerate(names)},
        {i: (masks / name).with_suffix(".png") for i, name in enumerate(names)},
        K, R, T.ravel() / 1000, D,
    )  # fmt: skip


def _among(
    tracks: list[Track], name: str, own: FixedCamera, cameras: Cameras, numbers: Sequence[int]
) -> Capture:
    """Return the capture of one camera in frames of these numbers, with the other cameras."""
    note = f"camera {name} of {len(cameras)}; --camera takes another, --views holds others out"
    images, masks = (tuple(paths[k] for k in numbers if k in paths)
                     for paths in (own.frames, own.masks))  # fmt: skip
    others = {other: read for other, read in cameras.items() if other != name}
    return Capture(
        tracks, images, masks or None, own.distortion, note=note, own=own, others=others,
        numbers=numbers,
    )  # fmt: skip


def _inside(folder: Path, name: object) -> str:
    """Return a path that a file names, if it stays in the folder."""
    path = PurePosixPath(str(name))
    if path.is_absolute() or ".." in path.parts:
        raise InputError(f"{folder}: names the picture '{path}', which is outside of the folder")
    return str(path)


def easymocap(where: str, folder: Path, camera: str | None, body: TargetBody) -> Capture:
    inner, outer = (_yaml(folder / name) for name in ("intri.yml", "extri.yml"))
    names = [key[2:] for key in inner if key.startswith("K_")]
    cameras = {name: partial(_easymocap_camera, folder, inner, outer, name) for name in names}
    name, own = _chosen(folder, cameras, camera)
    params = next((folder / p for p in _SMPL if (folder / p).is_dir()), None)
    if params is None:
        raise InputError(f"{folder}: has none of {', '.join(_SMPL)}, with a .json a frame")
    numbers = list(own.frames)
    people: dict[str, list[tuple[int, Mapping[str, Any]]]] = {}
    for path in sorted(params.glob("*.json"), key=number_in):
        frame, number = read_json(path, _JSON), number_in(path)
        for person in frame["annots"] if isinstance(frame, dict) else frame:
            seen = people.setdefault(str(person.get("id", 0)), [])
            if number in own.frames:
                seen.append((numbers.index(number), person))
    tracks = [
        _stacked(f"{params}: person {person}", person, *zip(*seen, strict=True), own, body)
        for person, seen in people.items() if seen
    ]  # fmt: skip
    return _among(tracks, name, own, cameras, numbers)


def _easymocap_camera(
    folder: Path, inner: Mapping[str, np.ndarray], outer: Mapping[str, np.ndarray], name: str
) -> FixedCamera:
    masks = folder / "mask" / _inside(folder, name)
    R = outer.get(f"Rot_{name}")
    R = to_matrices(np.ravel(outer[f"R_{name}"])) if R is None else R
    return FixedCamera.of_opencv(
        _numbered(folder / "images" / _inside(folder, name)),
        _numbered(masks) if masks.is_dir() else {}, inner[f"K_{name}"], R, outer[f"T_{name}"],
        inner.get(f"dist_{name}", inner.get(f"D_{name}", np.zeros(5))),
    )  # fmt: skip


def _stacked(
    where: str, person: str, frames: Sequence[int], each: Sequence[Mapping[str, Any]],
    own: FixedCamera, body: TargetBody,
) -> Track:  # fmt: skip
    """Convert EasyMocap's parameters (SMPL, SMPL+H or SMPL-X) to the axes of the camera ``own``."""
    if "handl" in each[0]:
        raise InputError(
            f"{where}: hands as PCA (handl, handr) are not read; expected 'poses' of SMPL's 72 or "
            "69 numbers a frame, SMPL+H's 156 or SMPL-X's 165"
        )
    rows = lambda name: np.stack([np.ravel(np.asarray(p[name], np.float64)) for p in each])
    given = {name: rows(name) for name in ("poses", "Rh", "Th", "shapes")}
    if "expression" in each[0]:
        given["expression"] = rows("expression")
    if given["poses"].shape[1] == 69:  # without the root
        given["poses"] = np.pad(given["poses"], ((0, 0), (3, 0)))
    frames = np.array(frames)
    return make_track(where, person, frames, given, own.K, body).seen_from(own.R, own.T)


def avatarrex(where: str, folder: Path, camera: str | None, body: TargetBody) -> Capture:
    about = read_json(folder / "calibration_full.json", _JSON)
    cameras = {key: partial(_avatarrex_camera, folder, key, lens) for key, lens in about.items()}
    name, own = _chosen(folder, cameras, camera)
    path = folder / "smpl_params.npz"
    poses = read_arrays(path, "SMPL-X's parameters")
    count = len(poses["transl"])
    rows = [k for k in own.frames if k < count and k in own.masks]
    given = {key: x[rows] if len(x) == count else x for key, x in poses.items()}
    track = make_track(str(path), "0", np.arange(len(rows)), given, own.K, body)
    return _among([track.seen_from(own.R, own.T)], name, own, cameras, rows)


def _avatarrex_camera(folder: Path, name: str, lens: Mapping[str, Any]) -> FixedCamera:
    frames = _numbered(folder / _inside(folder, name))
    masks = {k: folder / name / "mask" / "pha" / path.name for k, path in frames.items()}
    return FixedCamera.of_opencv(
        frames, {k: path for k, path in masks.items() if path.is_file()},
        lens["K"], lens["R"], lens["T"], lens.get("distCoeff", np.zeros(5)),
    )  # fmt: skip


def _chosen(folder: Path, cameras: Cameras, name: str | None) -> tuple[str, FixedCamera]:
    """Return the camera of a name; without a name, the first."""
    if not cameras:
        raise InputError(f"{folder}: names no camera")
    name = next(iter(cameras)) if name is None else name
    if name not in cameras:
        some = ", ".join(list(cameras)[:30])
        raise InputError(f"{folder}: has no camera '{name}'; it has {some}")
    return name, cameras[name]()


def _numbered(folder: Path) -> dict[int, Path]:
    """Return a camera's pictures by the number in their names."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of pictures")
    return {number_in(path): path for path in files_of(folder)}


def _yaml(path: Path) -> dict[str, np.ndarray]:
    """Read the matrices of an OpenCV file, by name."""
    return {
        name: np.array([float(x) for x in data.split(",")]).reshape(int(rows), int(cols))
        for name, rows, cols, data in _MATRIX.findall(path.read_text(errors="replace"))
    }
