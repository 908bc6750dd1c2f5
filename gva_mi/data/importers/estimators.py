"""Convert the files of pose estimators to tracks: one record for each estimator.

``docs/sources.md`` lists their files. Root rotation and translation are in the camera's axes. The
focal length that an estimator assumed is kept, because its translations hold with that one only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.core.errors import InputError, expecting
from gva_mi.data.importers import estimator_files as files
from gva_mi.data.importers import frame_files as frames
from gva_mi.data.importers import people_files as people
from gva_mi.data.importers.estimator_files import SeenPerson, any_holds, holds
from gva_mi.data.importers.lens import centred, rescaled
from gva_mi.data.importers.spellings import OTHERS, is_numbers, named_rows
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.importers.tracks import Track, make_track

FAR_FOCAL = 5000.0  # pixels, of estimators that assume that a person stands far away


@dataclass(frozen=True)
class VideoInfo:
    """Facts about the video that a reader needs besides the file."""

    size: tuple[int, int]  # (W, H) of the video, pixels
    focal: float | None = None  # pixels, where the file says none
    body: TargetBody | None = None  # that poses are converted to


Arrays = Mapping[str, Any]  # (n, ...) each
Lens = Callable[[str, Arrays, VideoInfo], np.ndarray]  # where, arrays → K (3, 3) or (n, 3, 3)
# Our name: the file's name, or that name and a slice of joints. "betas?" may be missing.
Names = Mapping[str, "str | tuple[str, slice]"]


@dataclass(frozen=True)
class Estimator:
    """Rules that recognise one estimator's files, and the meaning of their arrays."""

    expects: str  # for messages
    recognises: Callable[[Any], bool]  # of what a file holds, or of a folder's path
    people: Callable[[str, Any], Iterable[SeenPerson]]
    lens: Lens = lambda where, arrays, info: arrays["K"]  # noqa: E731 (by default, the file's own)
    names: Names = field(default_factory=dict)  # none: the names of fields.py
    of_pelvis: bool = False  # its translation is the pelvis's position
    mean_hand: bool = False  # fingers are relative to the mean hand
    # Tracks of the camera in the world of its path; None where the file says no path.
    along_path: Callable[[Any, list[Track]], list[Track] | None] | None = None
    needs_video: bool = False  # places follow from an assumed lens: it is no motion on its own
    up: str | None = "-y"  # the axis of its people that is up; None: any
    # The number that it gives the first frame; None: that of the picture, by its name.
    first: int | None = 0

    def tracks(self, where: str, found: Any, info: VideoInfo) -> list[Track]:  # noqa: ANN401
        """Return the people in the camera's axes, one track each, frames ascending."""
        tracks = []
        for person in self.people(where, found):
            at = f"{where}: person {person.name}"
            K = np.asarray(self.lens(at, person.arrays, info), np.float64)
            given = self._named(person.arrays)
            track = make_track(at, person.name, person.frames, given, K, info.body, self.of_pelvis)
            mean = track.from_mean_hand or (self.mean_hand and track.has_hands)
            notes = (*track.notes, *self._left_out(person.arrays))
            track = replace(track, from_mean_hand=mean, notes=notes)
            tracks.append(track.where(np.unique(track.frames, return_index=True)[1]))
        return tracks

    def _named(self, arrays: Arrays) -> Arrays:
        """Return the arrays under the names of fields.py."""
        given = {} if self.names else dict(arrays)
        for ours, theirs in self.names.items():
            theirs, joints = theirs if isinstance(theirs, tuple) else (theirs, slice(None))
            key = theirs.removesuffix("?")
            if key in arrays or not theirs.endswith("?"):
                given[ours] = arrays[key] if joints == slice(None) else arrays[key][:, joints]
        return given

    def _left_out(self, arrays: Arrays) -> list[str]:
        """Return a note on arrays of numbers that :attr:`names` do not name."""
        named = {(x[0] if isinstance(x, tuple) else x).rstrip("?") for x in self.names.values()}
        rest = [k for k, x in arrays.items() if k not in OTHERS | named and is_numbers(x)]
        rest = rest if self.names else []
        return [f"not used of the source: {', '.join(sorted(rest))}"] if rest else []


def no_lens(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return np.eye(3)


def focal_of(rule: Callable[[VideoInfo], float]) -> Lens:
    """Return the centred lens that an estimator assumed; its focal length depends on the video."""
    return lambda where, arrays, info: centred(rule(info), info.size)


def lens_of_wham(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return centred(np.ravel(arrays.get("focal_length", np.hypot(*info.size)))[0], info.size)


def lens_of_hybrik(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return HybrIK's lens for each person's box, rescaled from its picture size to the video's."""
    box, sizes = arrays["bbox"], zip(arrays["width"], arrays["height"], strict=True)
    widths = 1000 / 256 * (box[:, 2] - box[:, 0])
    return np.stack([
        rescaled(where, centred(f, of), of, info.size)
        for f, of in zip(widths, sizes, strict=True)
    ])  # fmt: skip


def lens_of_romp(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return ROMP's lens: it pads pictures to a square, whose centre is rounded to whole pixels."""
    side = max(info.size)
    K = centred(443.4 / 512 * side, info.size)
    K[:2, 2] = [side / 2 - (side - length) // 2 for length in info.size]
    return K


def lens_by_name(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return the camera in a file, or one of the focal length that a user gives."""
    for name in ("K", "cam_K", "intrinsic", "intrinsics"):
        if arrays.get(name) is not None:
            K = np.asarray(arrays[name], np.float64)
            if K.shape[-2:] != (3, 3) or K.ndim > 3:
                raise InputError(f"{where}: '{name}' must be (3, 3) or (T, 3, 3), got {K.shape}")
            return K.reshape(-1, 3, 3)
    names = ("focal", "focal_length", "focal_l")
    focal = next((x for name in names if (x := arrays.get(name)) is not None), info.focal)
    if focal is None:
        raise InputError(f"{where}: says no camera (K, or focal); give --focal, in pixels")
    focal = np.ravel(np.asarray(focal, np.float64))
    if not focal.size or not (focal > 0).all():
        raise InputError(f"{where}: 'focal' must be one number above 0, or (T,); got {focal}")
    return np.stack([centred(f, info.size) for f in focal])


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
