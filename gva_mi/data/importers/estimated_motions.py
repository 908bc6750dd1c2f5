"""What pose estimators saw, as motions: in the world where they found one, else before the camera.

=============================================  ===================================================
Source                                         Axes
=============================================  ===================================================
WHAM with ``pose_world``, GVHMR, GLAMR         their world
TRAM with ``pred_cam_R``, ``pred_cam_T``       the world of its camera's path
4D-Humans, PyMAF-X, HybrIK                     the camera's; depth brought to a usual lens
ROMP, BEV, Multi-HMR, SMPLer-X, OSX, and       the camera's
anything by name, a file a frame
=============================================  ===================================================

In the camera's axes a motion is one of the world only where the camera stood still, which is said.

Some assume a lens so long that its pictures are nearly parallel projections. Their depth, and so
how far somebody steps towards the camera, is larger than true by as much as the lens is longer: a
point (x, z) is seen at f x / z, so z f'/f before a lens f' shows the same. f' = √(W² + H²), the
focal length that WHAM takes for a video of which it knows none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.data.importers.estimators import kind_of, tracks_of
from gva_mi.data.importers.frame_files import tram_camera
from gva_mi.data.importers.readings import PELVIS, View, make_track, of_pelvis, seen_from
from gva_mi.data.importers.tracks import Track, choose
from gva_mi.data.importers.whole_videos import FAR_FOCAL, frame_numbers
from gva_mi.errors import InputError, expecting

_STANDS = "in the axes of the camera, which is taken to stand still"
_NO_PLACES = ("vibe", "smplifyx")  # places of weak perspective in pictures of an unknown size


def estimated(
    path: Path,
    found: Any,  # noqa: ANN401
    person: str | None,
    components: np.ndarray | None = None,
) -> tuple[Track, list[str]] | None:
    """One person of what an estimator wrote, as a motion of the source's own body.

    Args:
        path: its file, or its folder.
        found: what the file holds; of a folder, its path.
        person: the estimator's name of one of several; without it, who is seen longest.
        components: (2, K, 45) of the body file's PCA of hands.

    Returns:
        The person's track, whose axes are those above and whose K means nothing, and what to say;
        None where no estimator wrote this, or it is one person's arrays by name.

    Raises:
        InputError: of an estimator's kind, and not in its form; or without places.
    """
    kind = _kind(found)
    if kind is None or (kind == "parameters" and not isinstance(found, Path)):
        return None
    if kind in _NO_PLACES:
        raise InputError(
            f"{path}: written by {kind}, whose places follow from the size of the pictures, which "
            f"it does not say; expected a motion in metres, or gva-mi prepare {kind} with its video"
        )
    with expecting(f"{path} (of the kind {kind})", "a motion of one person at least"):
        tracks = _of_world(str(path), kind, found, components)
        axes = f"{kind}, in the axes of its world"
        if not tracks:
            size = _size(str(path), kind, found)
            tracks = tracks_of(kind, path, found, View(size, 1.0, components))
            tracks, axes = _from_camera(kind, found, tracks, size)
        track, notes = choose(str(path), tracks, person, None)
    return track.sorted(), [axes, *notes]


def _kind(found: Any) -> str | None:  # noqa: ANN401
    """Who wrote it; of a world's motion alone, too, which says no camera."""
    if isinstance(found, Mapping) and "smpl_params_global" in found:
        return "gvhmr"
    if isinstance(found, Mapping) and _world_of_wham(found):
        return "wham"
    return kind_of(found)


def _world_of_wham(found: Mapping[Any, Any]) -> dict[Any, Mapping[str, Any]]:
    """WHAM's people who were found in the world."""
    people = {k: p for k, p in found.items() if isinstance(p, Mapping)}
    return {k: p for k, p in people.items() if p.get("pose_world") is not None}


def _of_world(
    where: str,
    kind: str,
    found: Any,  # noqa: ANN401
    components: np.ndarray | None,
) -> list[Track]:
    """The people of an estimator that finds the world, there; nothing where it has not."""

    def track(name: object, frames: np.ndarray, given: Mapping[str, Any]) -> Track:
        K = np.tile(np.eye(3), (len(frames), 1, 1))
        return make_track(f"{where}: person {name}", str(name), frames, given, K, components)

    if kind == "gvhmr" and isinstance(inner := found.get("smpl_params_global"), Mapping):
        return [track("0", np.arange(len(inner["body_pose"])), inner)]
    if kind == "wham":
        names = {"poses": "pose_world", "trans": "trans_world", "betas": "betas"}
        numbers = lambda p: p.get("frame_ids", p.get("frame_id", np.arange(len(p["pose_world"]))))
        return [
            track(k, frame_numbers(numbers(p)), {to: p.get(of) for to, of in names.items()})
            for k, p in _world_of_wham(found).items()
        ]
    if kind == "glamr":
        tracks = []
        for name, p in found["person_data"].items():
            frames = np.flatnonzero(np.ravel(p["exist_frames"]))
            if "smpl_orient_world" not in p or not len(frames):
                continue
            some = lambda key, p=p, frames=frames: np.asarray(p[key])[frames]
            given = {"global_orient": some("smpl_orient_world"), "body_pose": some("smpl_pose"),
                     "betas": some("smpl_beta"),
                     "transl": of_pelvis(some("root_trans_world"), "SMPL")}  # fmt: skip
            tracks.append(track(name, frames, given))
        return tracks
    return []


def _from_camera(
    kind: str,
    found: Any,  # noqa: ANN401
    tracks: list[Track],
    size: tuple[int, int],
) -> tuple[list[Track], str]:
    """Tracks of the camera's axes, with its own path, or at the depth of a usual lens."""
    if kind == "tram":
        about = tram_camera(found)
        if "pred_cam_R" in about and "pred_cam_T" in about:
            R, T = (np.asarray(about[f"pred_cam_{x}"], np.float64) for x in "RT")
            if R.ndim == 3 and T.ndim == 2:
                placed = [seen_from(t, R[t.frames], T[t.frames]) for t in tracks]
                return placed, f"{kind}, in the world of its camera's path"
    if kind not in ("4dhumans", "pymafx", "hybrik"):
        return tracks, f"{kind}, {_STANDS}"
    nearer = []
    for track in tracks:
        pelvis = np.array(PELVIS[track.form])
        scale = np.stack([np.ones(len(track.frames))] * 2 + [np.hypot(*size) / track.K[:, 0, 0]], 1)
        nearer.append(replace(track, transl=(track.transl + pelvis) * scale - pelvis))
    return nearer, f"{kind}, {_STANDS}; depth as before a lens of {np.hypot(*size):.0f} px"


def _size(where: str, kind: str, found: Any) -> tuple[int, int]:  # noqa: ANN401
    """(W, H) of an estimator's pictures, which its depths follow from; any, where none do.

    Raises:
        InputError: they do, and the file does not say it.
    """
    size: Any = (1000, 1000)
    if kind == "glamr":
        lenses = np.concatenate([np.asarray(p["cam_K"]) for p in found["person_data"].values()])
        size = 2 * lenses[lenses[:, 0, 0] > 0][0][:2, 2]
    elif kind == "hybrik":
        size = [np.ravel(found[name])[0] for name in ("width", "height")]
    elif kind == "4dhumans":
        sizes = [np.reshape(f["size"], (-1, 2))[0] for f in found.values() if np.size(f.get("size"))
                 and f.get("size") is not None]  # fmt: skip
        size = sizes[0][::-1] if sizes else None
    elif kind == "pymafx":
        # Where a picture of W is seen as s, PyMAF-X puts a person at z = 2 f / (s W).
        seen = np.reshape(found["orig_cam"], (-1, 4)) if "orig_cam" in found else None
        depth = np.reshape(found["orig_cam_t"], (-1, 3))[:, 2]
        if seen is not None:
            width = float(np.median(2 * FAR_FOCAL / (seen[:, 0] * depth)))
            size = width, width * float(np.median(seen[:, 0] / seen[:, 1]))
        else:
            size = None
    if size is None or not all(0 < float(x) < 1e6 for x in size):
        raise InputError(f"{where}: {kind} says no size of its pictures, which depth follows from")
    return round(float(size[0])), round(float(size[1]))


def refuse_folder(path: Path) -> None:
    """Say what a folder holds, and which files of motions there are.

    Raises:
        InputError: always.
    """
    names = sorted(x.name + "/" * x.is_dir() for x in path.iterdir())
    held = f"{', '.join(names[:5])}{', ...' if len(names) > 5 else ''}" if names else "nothing"
    poses = [name for name in ("poses_refined.npz", "poses.npz") if name in names]
    hint = f"; its motion is {path / poses[0]}" if poses else ""
    raise InputError(
        f"{path}: a folder that holds {held}, and no motion that is known; expected a file such as "
        f"AMASS's .npz or AIST++'s .pkl, or the folder of TRAM, ROMP, BEV, Multi-HMR, SMPLer-X or "
        f"OSX{hint}"
    )


def lone_track(path: Path, found: Mapping[str, Any]) -> None:
    """Refuse one person's file of TRAM, whose camera lies in the folder above.

    Raises:
        InputError: it is one.
    """
    if {"pred_rotmat", "pred_trans"} <= set(found):
        raise InputError(
            f"{path}: one person of TRAM without its camera; give the folder with hps/ and "
            "camera.npy"
        )
