"""What pose estimators write, as tracks; each is told by its keys.

==============  ===============================================  ==============================
Kind            File, by the public repository's own code        Camera
==============  ===============================================  ==============================
``wham``        ``wham_output.pkl`` (yohanshin/WHAM)             f = √(W² + H²), centred
``gvhmr``       ``hmr4d_results.pt`` (zju3dv/GVHMR)              ``K_fullimg``
``4dhumans``    PHALP's ``.pkl`` (shubham-goel/4D-Humans)        f = 5000/256 max(W, H), centred
``smplerx``     ``smplx/00001_0.npz`` and ``meta/00001_0.json``  ``focal``, ``princpt`` a frame
                (caizhongang/SMPLer-X)
==============  ===============================================  ==============================

All give root rotation and translation in the axes of the camera. Focal lengths are what the
estimator assumed: they are kept, for its translations only hold with them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.data.importers.fields import find_betas, find_joints, find_translation
from gva_mi.data.importers.tracks import Track
from gva_mi.errors import InputError
from gva_mi.pickles.reader import read_objects

PHALP_FOCAL = 5000 / 256  # focal length over the larger side of the picture
_NUMBERED = re.compile(r"(\d+)_(\d+)\.npz")  # frame, person


def read_estimator(kind: str, source: Path, size: tuple[int, int]) -> tuple[str, list[Track]]:
    """The people that an estimator saw.

    Args:
        kind: one of :data:`KINDS`, or "auto".
        source: its file, or its folder.
        size: (W, H) of the video, which some cameras follow from.

    Returns:
        The kind, and a track a person.

    Raises:
        InputError: the source is of another kind, or of none that is known.
    """
    found = _open(source)
    if kind == "auto":
        fitting = [name for name, (fits, _, _) in KINDS.items() if fits(found)]
        if not fitting:
            known = "; ".join(f"{name}: {what}" for name, (_, _, what) in KINDS.items())
            raise InputError(f"{source}: of no kind that is known; looked for {known}")
        kind = fitting[0]
    fits, read, what = KINDS[kind]
    if not fits(found):
        raise InputError(f"{source}: not of the kind {kind}; expected {what}")
    try:
        return kind, [track.sorted() for track in read(str(source), found, size)]
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"{source}: of the kind {kind}, but not of its form ({reason:.80}); expected {what}"
        ) from None


def centred(focal: float, size: tuple[int, int], frames: int) -> np.ndarray:
    """K (frames, 3, 3) of a lens whose axis meets the middle of the picture."""
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return np.tile(K, (frames, 1, 1))


def _open(source: Path) -> Any:  # noqa: ANN401
    """What a file holds; a folder as the paths of its numbered files."""
    if source.is_dir():
        inner = source / "smplx" if (source / "smplx").is_dir() else source
        return sorted(path for path in inner.iterdir() if _NUMBERED.fullmatch(path.name))
    return read_objects(source, "what a pose estimator wrote, a .pkl, .pt or .npz, or its folder")


def _people(found: Any) -> dict:  # noqa: ANN401
    """A file's people by name, where each is a dictionary."""
    whole = isinstance(found, dict) and all(isinstance(p, dict) for p in found.values())
    return found if whole else {}


def _is_wham(found: Any) -> bool:  # noqa: ANN401
    people = _people(found).values()
    return any({"pose", "trans"} <= set(p) and {"frame_ids", "frame_id"} & set(p) for p in people)


def _wham(where: str, found: dict, size: tuple[int, int]) -> list[Track]:
    tracks = []
    for name, person in found.items():
        at = f"{where}: person {name}"
        frames = np.ravel(person["frame_ids" if "frame_ids" in person else "frame_id"]).astype(int)
        given = {"pose": person["pose"], "trans": person["trans"]}
        given["betas"] = person.get("betas")
        focal = float(np.ravel(person.get("focal_length", np.hypot(*size)))[0])
        tracks.append(_track(at, str(name), frames, given, centred(focal, size, len(frames))))
    return tracks


def _is_gvhmr(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, dict) and {"smpl_params_incam", "K_fullimg"} <= set(found)


def _gvhmr(where: str, found: dict, size: tuple[int, int]) -> list[Track]:
    person = found["smpl_params_incam"]
    K = np.asarray(found["K_fullimg"], np.float64)
    frames = np.arange(len(person["transl"]))
    K = np.broadcast_to(K, (len(frames), 3, 3)) if K.shape in ((3, 3), (1, 3, 3)) else K
    return [_track(f"{where}: smpl_params_incam", "0", frames, person, K)]


def _is_phalp(found: Any) -> bool:  # noqa: ANN401
    frames = _people(found).values()
    return any({"smpl", "camera", "tid"} <= set(frame) for frame in frames)


def _phalp(where: str, found: dict, size: tuple[int, int]) -> list[Track]:
    people: dict[int, list[tuple[int, dict, Any]]] = {}
    for k, name in enumerate(sorted(found)):
        frame = found[name]
        number = int(frame.get("time", k))
        tracked = {int(i) for i in frame.get("tracked_ids", frame["tid"])}
        for person, smpl, camera in zip(frame["tid"], frame["smpl"], frame["camera"], strict=False):
            if int(person) in tracked:
                people.setdefault(int(person), []).append((number, smpl, camera))
    tracks = []
    for person, seen in people.items():
        at = f"{where}: person {person}"
        stacked = lambda key, seen=seen: np.stack([np.asarray(smpl[key]) for _, smpl, _ in seen])
        given = {
            "global_orient": stacked("global_orient").reshape(len(seen), 1, 3, 3),
            "body_pose": stacked("body_pose").reshape(len(seen), -1, 3, 3),
            "betas": stacked("betas").reshape(len(seen), -1),
            "transl": np.stack([np.ravel(camera) for _, _, camera in seen]),
        }
        K = centred(PHALP_FOCAL * max(size), size, len(seen))
        tracks.append(_track(at, str(person), np.array([n for n, _, _ in seen]), given, K))
    return tracks


def _is_smplerx(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, list) and bool(found)


def _smplerx(where: str, found: list[Path], size: tuple[int, int]) -> list[Track]:
    people: dict[str, list[tuple[int, Path]]] = {}
    for path in found:
        frame, person = _NUMBERED.fullmatch(path.name).groups()
        people.setdefault(person, []).append((int(frame), path))
    tracks = []
    for person, seen in people.items():
        files = [path for _, path in seen]
        frames, given = np.array([frame for frame, _ in seen]), _stacked(files)
        K = np.stack([_meta(path) for path in files])
        track = _track(f"{where}: person {person}", person, frames, given, K)
        # Its body is made with the package's default, to which the mean hand is added.
        tracks.append(replace(track, from_mean_hand=track.has_hands))
    return tracks


def _stacked(files: list[Path]) -> dict[str, np.ndarray]:
    """Parameters of one frame a file, each of any shape, as rows of all frames."""
    rows: dict[str, list[np.ndarray]] = {}
    for path in files:
        found = read_objects(path, "SMPL-X's parameters of one frame")
        if not isinstance(found, dict):
            raise InputError(f"{path}: holds no arrays by name; expected SMPL-X's parameters")
        for name in (*SMPLX_FIELDS, "transl", "betas"):
            if name in found:
                rows.setdefault(name, []).append(np.ravel(found[name]))
    uneven = [name for name, x in rows.items() if len({r.shape for r in x}) > 1]
    uneven += [name for name, x in rows.items() if len(x) < len(files)]
    if uneven:
        raise InputError(f"{files[0].parent}: '{uneven[0]}' is not of one shape in all files")
    return {name: np.stack(x) for name, x in rows.items()}


def _meta(path: Path) -> np.ndarray:
    """K (3, 3) of a frame of SMPLer-X, from the file beside."""
    meta = path.parent.parent / "meta" / path.with_suffix(".json").name
    try:
        about = json.loads(meta.read_text())
        (fx, fy), (cx, cy) = about["focal"], about["princpt"]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f'{meta}: expected {{"focal": [fx, fy], "princpt": [cx, cy]}} beside {path.name}'
        ) from None


def _track(
    where: str, person: str, frames: np.ndarray, found: Mapping[str, Any], K: np.ndarray
) -> Track:
    """A track of arrays that hold all frames, checked to be as many."""
    joints = find_joints(where, found)
    count = len(frames)
    if len(joints.rotations) != count or K.shape != (count, 3, 3):
        raise InputError(
            f"{where}: {len(joints.rotations)} poses and K {K.shape} for {count} frames"
        )
    betas = find_betas(where, found)
    betas = None if betas is None else np.broadcast_to(betas, (count, betas.shape[-1]))
    transl = find_translation(where, found, count)
    return Track(person, frames, joints.rotations, transl, betas, K, joints.form, joints.has_hands)


Reader = Callable[[str, Any, tuple[int, int]], list[Track]]
KINDS: dict[str, tuple[Callable[[Any], bool], Reader, str]] = {
    "wham": (_is_wham, _wham, "people with pose, trans and frame_ids"),
    "gvhmr": (_is_gvhmr, _gvhmr, "smpl_params_incam and K_fullimg"),
    "4dhumans": (_is_phalp, _phalp, "frames with tid, smpl and camera"),
    "smplerx": (_is_smplerx, _smplerx, "a folder with smplx/00001_0.npz and meta/00001_0.json"),
}
