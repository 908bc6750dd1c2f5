"""What pose estimators write, as tracks; each is told by its keys.

===============  ===============================================  ==============================
Kind             File, by the public repository's own code        Camera
===============  ===============================================  ==============================
``wham``         ``wham_output.pkl`` (yohanshin/WHAM)             f = √(W² + H²), centred
``vibe``         ``vibe_output.pkl`` (mkocabas/VIBE)              weak perspective, f = 5000 here
``gvhmr``        ``hmr4d_results.pt`` (zju3dv/GVHMR)              ``K_fullimg``
``4dhumans``     PHALP's ``.pkl`` (shubham-goel/4D-Humans)        f = 5000/256 max(W, H), centred
``glamr``        ``grecon/*.pkl`` (NVlabs/GLAMR)                  ``cam_K`` of its own pictures
``pymafx``       ``output.pkl`` (HongwenZhang/PyMAF-X)            f = 5000, centred
``hybrik``       ``res.pk`` (jeffffffli/HybrIK), 24 or 55 joints  f = 1000/256 width of the box
``tram``         ``hps/hps_track_0.npy`` (yufu-wang/tram)         ``camera.npy`` above
``romp``         ``.npz`` a frame or ``video_results.npz``, ROMP  f = 443.4/512 max(W, H)
                 and BEV (Arthur151/ROMP)
``multihmr``     its people, pickled a frame (naver/multi-hmr)    60° over max(W, H)
``smplifyx``     ``results/000/000.pkl`` (vchoutas/smplify-x)     f = 5000, or ``--focal``
``smplerx``      ``smplx/00001_0.npz`` and ``meta/00001_0.json``  ``focal``, ``princpt`` a frame
                 (caizhongang/SMPLer-X)
``osx``          ``12_0.json`` with ``smplx_param`` and           ``focal``, ``princpt`` a frame
                 ``cam_param`` (IDEA-Research/OSX, NeuralAnnot);
                 forks of SMPLest-X: :mod:`.smplx_json`
``parameters``   SMPL's or SMPL-X's, by the names and in the      ``K``, ``focal``, or ``--focal``
                 shapes of :mod:`fields`
===============  ===============================================  ==============================

All give root rotation and translation in the axes of the camera. Focal lengths are what the
estimator assumed: they are kept, for its translations only hold with them. ``whole_videos`` and
``frame_files`` hold the readers.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.data.importers import frame_files as frames
from gva_mi.data.importers import smplx_json
from gva_mi.data.importers import whole_videos as videos
from gva_mi.data.importers.other_bodies import refuse_other_bodies
from gva_mi.data.importers.readings import View
from gva_mi.data.importers.tracks import Track
from gva_mi.errors import InputError, expecting
from gva_mi.pickles.reader import read_objects


def read_estimator(kind: str, source: Path, view: View) -> tuple[str, list[Track]]:
    """The people that an estimator saw.

    Args:
        kind: one of :data:`KINDS`, or "auto".
        source: its file, or its folder.
        view: the video's size, which some cameras follow from, and what the file does not say.

    Returns:
        The kind, and a track a person.

    Raises:
        InputError: the source is of another kind, or of none that is known.
    """
    found = _open(source)
    _refuse(source, found)
    kind = kind_of(found) or "" if kind == "auto" else kind
    if not kind:
        known = "; ".join(f"{name}: {what}" for name, (_, _, what) in KINDS.items())
        raise InputError(f"{source}: of no kind that is known; looked for {known}")
    return kind, tracks_of(kind, source, found, view)


def kind_of(found: Any) -> str | None:  # noqa: ANN401
    """Which of :data:`KINDS` wrote what a file holds, or a folder (its path), if any did."""
    return next((name for name, (fits, _, _) in KINDS.items() if fits(found)), None)


def tracks_of(kind: str, source: Path, found: Any, view: View) -> list[Track]:  # noqa: ANN401
    """The people in what a file holds, or in a folder (its path), frames ascending.

    Raises:
        InputError: it is not of this kind, or not in its form.
    """
    fits, read, what = KINDS[kind]
    if not fits(found):
        raise InputError(f"{source}: not of the kind {kind}; expected {what}")
    return [track.sorted() for track in told(source, kind, what, read, found, view)]


def told(source: Path, kind: str, what: str, read: Callable[..., Any], *arguments: Any) -> Any:  # noqa: ANN401
    """What a reader returns; where a file is of its kind and not of its form, one sentence.

    Raises:
        InputError: whatever the reader stumbles over.
    """
    with expecting(f"{source} (of the kind {kind})", what):
        return read(str(source), *arguments)


def _open(source: Path) -> Any:  # noqa: ANN401
    """What a file holds; a folder as its path."""
    if source.is_dir():
        return source
    expected = "what a pose estimator wrote, a .pkl, .pt, .npy or .npz, or its folder"
    return frames.plain(read_objects(source, expected))


def _refuse(source: Path, found: Any) -> None:  # noqa: ANN401
    """Raise an InputError for what has no meaning without something that is not there."""
    if isinstance(found, np.ndarray) and not found.dtype.hasobject:
        raise InputError(
            f"{source}: an array {found.shape} without names, which could be any parameters in any "
            "order; save them by name: global_orient, body_pose, transl, betas (.npz)"
        )
    refuse_other_bodies(source, frames.first_of(source) if source.is_dir() else found)


Reader = Callable[[str, Any, View], list[Track]]
KINDS: dict[str, tuple[Callable[[Any], bool], Reader, str]] = {
    "wham": (videos.is_wham, videos.read_wham, "people with pose, trans and frame_ids"),
    "vibe": (videos.is_vibe, videos.read_vibe, "people with pose, orig_cam and frame_ids"),
    "gvhmr": (videos.is_gvhmr, videos.read_gvhmr, "smpl_params_incam and K_fullimg"),
    "4dhumans": (videos.is_phalp, videos.read_phalp, "frames with tid, smpl and camera"),
    "glamr": (videos.is_glamr, videos.read_glamr, "person_data and cam_pose"),
    "pymafx": (videos.is_pymafx, videos.read_pymafx, "smplx_params, orig_cam_t and frame_ids"),
    "hybrik": (videos.is_hybrik, videos.read_hybrik, "pred_thetas, pred_cam_root and bbox"),
    "tram": (frames.is_tram, frames.read_tram, "a folder with hps/hps_track_0.npy and camera.npy"),
    "romp": (frames.is_romp, frames.read_romp, "results with smpl_thetas and cam_trans"),
    "multihmr": (
        frames.is_multihmr, frames.read_multihmr,
        "a folder with people of rotvec and transl_pelvis, a file a frame",
    ),
    "smplifyx": (
        frames.is_smplifyx, frames.read_smplifyx,
        "a folder with results/000/000.pkl with camera_translation",
    ),
    "smplerx": (
        frames.is_smplerx, frames.read_smplerx,
        "a folder with smplx/00001_0.npz and meta/00001_0.json",
    ),
    "osx": (
        smplx_json.is_osx, smplx_json.read_osx,
        "a folder with 12_0.json of smplx_param and cam_param",
    ),
    "parameters": (
        frames.is_parameters, frames.read_parameters,
        "global_orient, body_pose and transl by name, in a file or one a frame",
    ),
}  # fmt: skip
