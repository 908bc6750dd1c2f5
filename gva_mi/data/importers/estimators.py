"""Convert the files of pose estimators to tracks: one record for each estimator.

``docs/sources.md`` lists their files. Root rotation and translation are in the camera's axes. The
focal length that an estimator assumed is kept, because its translations hold with that one only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.core.errors import InputError, expecting
from gva_mi.data.importers import estimator_files as files
from gva_mi.data.importers import frame_files as frames
from gva_mi.data.importers import people_files as people
from gva_mi.data.importers.estimator_files import any_holds, holds
from gva_mi.data.importers.estimator_record import (
    Estimator,
    VideoInfo,
    focal_of,
    lens_by_name,
    lens_of_hybrik,
    lens_of_romp,
    lens_of_wham,
    no_lens,
)
from gva_mi.data.importers.spellings import named_rows
from gva_mi.data.importers.tracks import Track

FAR_FOCAL = 5000.0  # pixels, of estimators that assume that a person stands far away


def read_estimator(kind: str, source: Path, info: VideoInfo) -> tuple[str, list[Track]]:
    """Read a file or folder of ``kind`` (or "auto"); return the kind and a track per person."""
    found = files.read_source(source, "what a pose estimator wrote, a .pkl, .pt, .npy or .npz, or "
                              "its folder")  # fmt: skip
    if isinstance(found, np.ndarray) and not found.dtype.hasobject:
        found = named_rows(source, found)
    files.refuse_mhr(source, files.first_of(found))
    kind = kind_of(found) or "" if kind == "auto" else kind
    if not kind:
        known = "; ".join(f"{name}: {record.expects}" for name, record in KINDS.items())
        raise InputError(f"{source}: of no kind that is known; looked for {known}")
    record = KINDS[kind]
    if not record.recognises(found):
        raise InputError(f"{source}: not of the kind {kind}; expected {record.expects}")
    with expecting(f"{source} (of the kind {kind})", record.expects):
        return kind, record.tracks(str(source), found, info)


def kind_of(found: Any) -> str | None:  # noqa: ANN401
    """Return which of :data:`KINDS` wrote a file (its content) or folder (its path), or None."""
    return next((name for name, record in KINDS.items() if record.recognises(found)), None)


_MULTI_HMR_ANGLE = np.radians(60.0 / 2)  # half of what the longer side is seen under
_PYMAFX = {  # the root stands before the body, and SMPL's mittens after it
    "global_orient": ("body_pose", slice(0, 1)), "body_pose": ("body_pose", slice(1, 22)),
    "left_hand_pose": "left_hand_pose", "right_hand_pose": "right_hand_pose",
    "jaw_pose": "jaw_pose", "leye_pose": "leye_pose", "reye_pose": "reye_pose",
    "betas": "shape", "expression": "expression?", "transl": "orig_cam_t",
}  # fmt: skip
_MULTIHMR = {  # joints: the root, 21 of the body, both hands relative to the flat ones, the jaw
    "global_orient": ("rotvec", slice(0, 1)), "body_pose": ("rotvec", slice(1, 22)),
    "left_hand_pose": ("rotvec", slice(22, 37)), "right_hand_pose": ("rotvec", slice(37, 52)),
    "jaw_pose": ("rotvec", slice(52, 53)), "betas": "shape", "expression": "expression?",
    "transl": "transl_pelvis",
}  # fmt: skip
_SMPLIFYX = {name: f"{name}?" for name in (*SMPLX_FIELDS, "betas", "expression")}

KINDS: dict[str, Estimator] = {
    "wham": Estimator(
        "people with pose, trans and frame_ids",
        lambda x: any(any_holds(x, "pose", "trans", key) for key in ("frame_ids", "frame_id")),
        people.wham, lens_of_wham, {"pose": "pose", "transl": "trans", "betas": "betas?"},
    ),
    "prompthmr": Estimator(
        "people with smplx_cam, and a camera",
        lambda x: people.of_prompthmr(x, "smplx_cam"), people.prompthmr("smplx_cam"),
    ),
    "vibe": Estimator(
        "people with pose, orig_cam and frame_ids",
        lambda x: any_holds(x, "pose", "orig_cam", "frame_ids"), people.vibe,
        focal_of(lambda info: people.FAR_SHARE * info.size[0]),
        {"pose": "pose", "transl": "place", "betas": "betas?"}, needs_video=True,
    ),
    "gvhmr": Estimator(
        "smpl_params_incam and K_fullimg",
        lambda x: holds(x, "smpl_params_incam", "K_fullimg"), people.gvhmr("smpl_params_incam"),
    ),
    "4dhumans": Estimator(
        "frames with tid, smpl and camera",
        lambda x: any_holds(x, "tid", "smpl", "camera"), people.phalp,
        focal_of(lambda info: 5000 / 256 * max(info.size)),
        {"global_orient": "global_orient", "body_pose": "body_pose", "betas": "betas",
         "transl": "camera"},
        needs_video=True,
    ),
    "pymafx": Estimator(
        "smplx_params, orig_cam_t and frame_ids",
        lambda x: holds(x, "smplx_params", "orig_cam_t", "frame_ids"), people.pymafx,
        focal_of(lambda info: FAR_FOCAL), _PYMAFX, needs_video=True,
    ),
    "hybrik": Estimator(
        "pred_thetas, pred_cam_root and bbox",
        lambda x: holds(x, "pred_thetas", "pred_cam_root", "bbox"), people.hybrik, lens_of_hybrik,
        {"pose": "pred_thetas", "transl": "pred_cam_root", "betas": "pred_betas"}, of_pelvis=True,
        needs_video=True, first=1,
    ),
    "tram": Estimator(
        "a folder with hps/hps_track_0.npy and camera.npy",
        lambda x: bool(people.tram_files(x)), people.tram,
        names={"pose": "pred_rotmat", "transl": "pred_trans", "betas": "pred_shape"},
        along_path=people.along_path, up=None,
    ),
    "romp": Estimator(
        "results with smpl_thetas and cam_trans", frames.is_romp, frames.romp, lens_of_romp,
        {"pose": "smpl_thetas", "transl": "cam_trans", "betas": "smpl_betas"}, first=None,
    ),
    "multihmr": Estimator(
        "a folder with people of rotvec and transl_pelvis, a file a frame",
        frames.is_multihmr, frames.multihmr,
        focal_of(lambda info: info.focal or max(info.size) / 2 / np.tan(_MULTI_HMR_ANGLE)),
        _MULTIHMR, of_pelvis=True, first=None,
    ),
    "smplifyx": Estimator(
        "a folder with results/000/000.pkl with camera_translation",
        frames.is_smplifyx, frames.smplifyx, focal_of(lambda info: info.focal or FAR_FOCAL),
        _SMPLIFYX | {"transl": "camera_translation"}, mean_hand=True, needs_video=True, first=None,
    ),
    "smplerx": Estimator(
        "a folder with smplx/00001_0.npz and meta/00001_0.json",
        lambda x: bool(frames.smplerx_files(x)), frames.smplerx, mean_hand=True, first=1,
    ),
    "osx": Estimator(
        "a folder with 12_0.json of smplx_param and cam_param",
        frames.is_osx, frames.osx, mean_hand=True, first=None,
    ),
    "parameters": Estimator(
        "global_orient, body_pose and transl by name, in a file or one a frame",
        frames.is_parameters, frames.parameters, lens_by_name, up=None, first=None,
    ),
}  # fmt: skip
WORLDS = {  # of people in the estimator's own world
    "wham": Estimator(
        "people with pose_world", people.is_wham_world, people.wham_world, no_lens,
        {"pose": "pose_world", "transl": "trans_world?", "betas": "betas?"}, up="y",
    ),
    "prompthmr": Estimator(
        "people with smplx_world", lambda x: people.of_prompthmr(x, "smplx_world"),
        people.prompthmr("smplx_world"), no_lens, up="y",
    ),
    "gvhmr": Estimator(
        "smpl_params_global", lambda x: holds(x, "smpl_params_global"),
        people.gvhmr("smpl_params_global"), no_lens, up="y",
    ),
}  # fmt: skip
