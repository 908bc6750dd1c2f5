"""Convert motions of AMASS, AIST++, pose estimators and others to poses that drive an avatar.

Facts about the files are from the public descriptions of AMASS (nghorbani/amass) and AIST++
(google/aistplusplus_api). A file may hold ``poses`` of any body, or parts of them; translations in
metres, or in centimetres with ``smpl_scaling``; a frame rate under several names; NaN where markers
were lost; angles of more than half a turn; and any axis may be up.

An estimator's motion is in world axes if its file holds them. Otherwise it is in camera axes, and
the camera is assumed to stand still. If each frame has a lens of its own, all get one usual lens
(:func:`gva_mi.subject.lens.usual_lens`). An estimator whose positions depend on the video's size is
refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch

from gva_mi.body.gestures import GESTURES, put_hand
from gva_mi.body.pose import JOINTS, SIDES, Pose, Shape
from gva_mi.core.console import listed
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.options import PythonOnly, Within, options_of
from gva_mi.readers.body_arrays import plain_name
from gva_mi.readers.bvh import read_bvh
from gva_mi.readers.estimators import KINDS, WORLDS, VideoInfo, kind_of
from gva_mi.readers.joint_motions import HUMANML3D_FPS, joints_in, joints_track
from gva_mi.readers.people import choose
from gva_mi.readers.retarget import bvh_track
from gva_mi.readers.source_files import read_source
from gva_mi.readers.target_body import TargetBody
from gva_mi.readers.track import Track, interpolate, make_track, median_betas, through_lens
from gva_mi.readers.up_axis import LEAN_NOTE_DEGREES, UP_AXES, Axis, Upward, upright
from gva_mi.subject.folder import POSES, REFINED_POSES
from gva_mi.subject.lens import is_one_lens, usual_lens
from gva_mi.subject.silhouettes import joints_in_world

EXPECTED_MOTION = "a motion such as AMASS's .npz or AIST++'s .pkl"
MOST_FRAMES = 1_000_000  # of one motion, after resampling. Chosen: 11 hours at 25 a second
LONGEST_GAP = 1.0  # seconds without numbers. Chosen: a longer gap would be invented motion
FPS_RANGE = Within(0.001, 10_000)  # frames a second
FrameRate = Annotated[float, FPS_RANGE]
FPS_NAMES = ("mocap_framerate", "mocap_frame_rate", "fps", "framerate", "frame_rate")
AIST_FPS = 60.0  # frames a second of AIST++, whose files do not hold it
# While a person walks, one foot stays. In centimetres, both feet go as far as the pelvis. Chosen:
# metres a second, slower than a walk; share of the pelvis's path, above that of a sprint; half a
# step, in which a foot stays.
_GLIDE_SPEED, _GLIDE_SHARE, _GLIDE_SECONDS = 0.5, 0.9, 0.5
_PELVIS_AND_ANKLES = [JOINTS.index(x) for x in ("pelvis", "left_ankle", "right_ankle")]
_MOSH_NAMES = {  # names of MoSh++ (SOMA) and of MoSh: AMASS's names
    "fullpose": "poses", "trans": "trans", "betas": "betas", "expression": "expression",
    "pose_est_fullposes": "poses", "pose_est_trans": "trans", "shape_est_betas": "betas",
    "pose_est_exprs": "expression",
}  # fmt: skip
_MOSH_DETAILS = "stageii_debug_details"  # MoSh++'s name for frame rate and settings
_MOSH_BETAS = 10  # if the settings do not say how many
# Shapes of a frame in an array without names: axis-angle, flat or by joint.
_POSE_ROW_SHAPES = {(72,), (156,), (165,), (24, 3), (52, 3), (55, 3)}
_Found = tuple[Track, float | None, str | None]  # with frames a second and up axis, if known
# An estimator's file does not say the size of its pictures: W, H in pixels, which a motion ignores.
_ANY_VIDEO = VideoInfo((1000, 1000), 1.0, is_known=False)


@options_of("motion")
class MotionOptions:
    """Options of the conversion of a motion to this program's conventions."""

    fps: FrameRate = 25.0  # frames a second of the poses; gva-mi render plays 25
    # Frames a second of the source; without it, what its file says.
    source_fps: FrameRate | None = None
    default_fps: PythonOnly[FrameRate | None] = None  # of a file that says none; None: refuse it
    up: Literal["auto"] | Axis = "auto"  # the source's axis that is up
    hands: PythonOnly[Literal["relaxed", "flat"]] = "relaxed"  # where the source has none
    # The estimator's name of one of several people; without it, the person seen longest.
    person: str | None = None


@dataclass(frozen=True)
class Motion:
    """A motion that was read."""

    pose: Pose
    shape: Shape
    notes: tuple[str, ...]  # what was found and done


def read_motion(path: Path, body: TargetBody, options: MotionOptions) -> Motion:
    """Read a motion; turn it upright, fill its gaps, resample it.

    ``path`` is .bvh, .npz, .npy, .pkl or .pt, or an estimator's folder; pickles run no code.
    """
    body = body.for_source(path)
    track, rate, up = _read(path, body, options)
    if rate is None:
        rate, note = options.default_fps, "no frame rate is known: each pose is one frame"
        track = replace(track, notes=(*track.notes, f"{note}; gva-mi motion takes --source-fps"))
    return _resampled(str(path), track, rate, up, body, options)


def motion_of_poses(
    where: str, pose: Pose, shape: Shape, fps: float, body: TargetBody, options: MotionOptions
) -> Motion:
    """Resample poses of ``fps`` frames a second, as :func:`read_motion` does with a file."""
    body = replace(body, of_source=True)
    named = {name: x.double().numpy() for name, x in pose.to_smplx().items()}
    named["betas"] = shape.betas.double().numpy()
    track = make_track(where, "0", None, named, np.eye(3), body)
    return _resampled(where, track, fps, "y", body, options)


def _resampled(
    where: str, track: Track, rate: float, own_up: str | None, body: TargetBody,
    options: MotionOptions,
) -> Motion:  # fmt: skip
    """Turn a track upright, fill its gaps, and resample it; ``own_up`` is its format's up axis."""
    rotations, others, known = _timeline(where, track.with_flat_hands(body.mean_hands))
    notes = list(track.notes)
    if not known.all():
        _check_gaps(where, known, rate)
        notes.append(f"frames without numbers, interpolated: {listed(np.flatnonzero(~known))}")
    if track.from_mean_hand:
        notes.append("fingers are relative to the mean hand, and the body's is added")
    if not track.has_hands:
        for side in SIDES if options.hands == "relaxed" else ():
            put_hand(rotations, side, GESTURES["rest"].values)
        notes.append(f"the source has no hands; they are {options.hands}")
    times = np.arange(len(rotations)) / rate
    count = int(np.floor(times[-1] * options.fps + 1e-6)) + 1
    if count > MOST_FRAMES:
        raise InputError(f"{where}: {count:,} frames at {options.fps:g} a second; give less --fps")
    wanted = np.arange(count) / options.fps
    rotations, others = interpolate(times[known], rotations[known], others[known], wanted)
    places, expression = others[:, :3], others[:, 3:]
    upward = Upward.of(rotations, places, body.joints, options.fps)
    up = options.up if options.up != "auto" else own_up or upward.axis()
    if up is None:
        raise InputError(
            f"{where}: the head is above the feet along no axis; give --up of gva-mi motion, one "
            f"of {', '.join(UP_AXES)}"
        )
    if (lean := upward.lean(up)) >= LEAN_NOTE_DEGREES:
        notes.append(f"the person leans {lean:.0f} degrees from that axis; --up takes another")
    rotations, places = upright(rotations, places, up)
    joints = joints_in_world(rotations, places - body.joints[0], body.joints)
    notes += _doubt_of_unit(joints, options.fps)
    betas, varied = median_betas(track.betas if track.form == "SMPL-X" else None)
    expression, of_face = body.expression(track.form, expression)
    notes = [*notes, *varied, *of_face]
    notes.insert(0, f"{track.form}, {len(known)} frames at {rate:g} a second, {up} up; "
                    f"now {count} at {options.fps:g}, y up")  # fmt: skip
    shape = Shape(torch.from_numpy(betas.astype(np.float32)))
    return Motion(Pose.of_arrays(rotations, places - places[0], expression), shape, tuple(notes))


def _read(path: Path, body: TargetBody, options: MotionOptions) -> _Found:
    """Read one person's motion, in world or camera axes (module docstring)."""
    where = str(path)
    if path.suffix.lower() == ".bvh":
        clip = read_bvh(path)
        rate = rate_of(where, {"fps": 1 / clip.frame_time}, options)
        return bvh_track(path, clip, body), rate, None
    found = _from_mosh(read_source(path, EXPECTED_MOTION))
    if (places := joints_in(path, found, options.person)) is not None:
        rate = options.source_fps or HUMANML3D_FPS
        return joints_track(places, rate, body.joints), rate, None
    if isinstance(found, np.ndarray) and not found.dtype.hasobject:
        found = _named_rows(path, found)
    if not isinstance(found, dict | Path) or not found:
        raise InputError(f"{path}: holds no arrays by name; expected {EXPECTED_MOTION}")
    world = next((kind for kind, record in WORLDS.items() if record.recognises(found)), None)
    kind = world or kind_of(found)
    if kind is None and isinstance(found, Path):
        poses = [n for n in (REFINED_POSES, POSES) if (path / n).is_file()]
        hint = f"; its motion is {path / poses[0]}" if poses else ""
        raise InputError(
            f"{path}: holds no motion in a known format; expected a file such as AMASS's .npz or "
            "AIST++'s .pkl, or the folder of ROMP, BEV or SMPLer-X" + hint
        )
    kind = kind or "parameters"
    record = WORLDS[kind] if world else KINDS[kind]
    if record.needs_video:
        raise InputError(
            f"{path}: written by {kind}, whose positions depend on a lens that it assumed; "
            f"expected a motion in metres, or gva-mi prepare {kind} with its video"
        )
    with expecting(f"{path} (read as {kind})", "a motion of one person at least"):
        tracks = record.tracks(where, found, replace(_ANY_VIDEO, body=body))
        track, notes = choose(where, tracks, options.person, None)
    arrays, up = {}, record.up
    if kind == "parameters":
        arrays = next(x.arrays for x in record.people(where, found) if x.name == track.person)
        up = "y" if {"smpl_scaling", "stage"} & set(arrays) else None  # AIST++, and our own
    else:
        axes = "its world" if world else "the camera, which is taken to stand still"
        notes = [f"{kind}, in the axes of {axes}", *notes]
    if not is_one_lens(track.K):
        K = usual_lens(track.K)
        track = through_lens(track, K)
        notes.append(f"each frame has another lens; all were moved to one of {K[0, 0]:.0f} pixels")
    track = replace(track, notes=(*notes, *track.notes))
    return track, rate_of(where, arrays, options), up


def _from_mosh(found: Any) -> Any:  # noqa: ANN401
    """Return the arrays of MoSh's second stage, ``*_stageii.pkl``, under AMASS's names.

    Its settings say how many of the coefficients were used. Anything else is returned as it is.
    """
    if not isinstance(found, Mapping) or not {_MOSH_DETAILS, "pose_est_fullposes"} & set(found):
        return found
    details = found.get(_MOSH_DETAILS, found)
    settings = details.get("cfg", details.get("ps"))
    model = settings.get("surface_model", settings) if isinstance(settings, Mapping) else {}
    renamed = {ours: found[name] for name, ours in _MOSH_NAMES.items() if name in found}
    rate = details.get("mocap_frame_rate", details.get("mocap_framerate"))
    renamed |= {} if rate is None else {"mocap_frame_rate": rate}
    counts = {"betas": model.get("num_betas", _MOSH_BETAS)}
    counts["expression"] = model.get("num_expressions")
    for name, count in counts.items():
        if name in renamed and isinstance(count, int):
            renamed[name] = renamed[name][..., :count]
    return renamed


def _named_rows(where: object, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Return an array without names as poses, if its shape is a pose's."""
    shape = rows.shape[1:]
    if shape not in _POSE_ROW_SHAPES and not (shape[1:] == (3, 3) and shape[0] in (22, 24, 52, 55)):
        raise InputError(
            f"{where}: an array {rows.shape} without names, which could be any parameters in any "
            "order; save them by name: global_orient, body_pose, transl, betas (.npz)"
        )
    return {"poses": rows}


def rate_of(where: str, found: Mapping[str, Any], options: MotionOptions) -> float | None:
    """Return a motion's frames per second: the option, or the number in its arrays.

    A nearly whole number is rounded: 120.00004 becomes 120. None: there is none, and the options
    have a default.
    """
    if options.source_fps is not None:
        return options.source_fps
    found = {plain_name(name): x for name, x in found.items()}
    name = next((name for name in FPS_NAMES if name in found), None)
    if name is None and "scaling" in found:
        return AIST_FPS
    if name is None and options.default_fps is not None:
        return None
    if name is None:
        raise InputError(
            f"{where}: holds no frame rate (none of {', '.join(FPS_NAMES)}); give --source-fps of "
            "gva-mi motion"
        )
    try:
        rate, *others = np.unique(np.ravel(found[name]).astype(np.float64))
    except (ValueError, TypeError):
        rate, others = np.nan, []
    if not 1 <= rate <= FPS_RANGE.high or others:
        why = f"; seconds between frames? --source-fps {1 / rate:.4g}" if 0 < rate < 1 else ""
        raise InputError(f"{where}: '{name}' must be frames a second, got {found[name]!s:.40}{why}")
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 * rate and rate > 1 else rate


def _timeline(where: str, track: Track) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rotations (T, 55, 3), places and expressions (T, 3 + E) and known (T,), first to last.

    Frames that an estimator left out are NaN.
    """
    rows = track.frames - track.frames.min()
    count = int(rows.max()) + 1
    if count > MOST_FRAMES:
        raise InputError(
            f"{where}: frames {track.frames.min()} to {track.frames.max()}, expected at most "
            f"{MOST_FRAMES:,}"
        )
    face = np.zeros((len(rows), 10)) if track.expression is None else track.expression
    others = np.full((count, 3 + face.shape[1]), np.nan)
    rotations = np.full((count, *track.rotations.shape[1:]), np.nan)
    rotations[rows], others[rows] = track.rotations, np.hstack([track.places, face])
    return rotations, others, np.isfinite(rotations).all((1, 2)) & np.isfinite(others).all(1)


def _doubt_of_unit(joints: np.ndarray, fps: float) -> list[str]:
    """Return a warning if joints (T, 55, 3) glide without a step, as in another unit."""
    k = max(1, min(round(_GLIDE_SECONDS * fps), len(joints) - 1))
    moved = np.linalg.norm(joints[k:] - joints[:-k], axis=2)[:, _PELVIS_AND_ANKLES] * fps / k
    speed = float(np.median(moved[:, 0])) if len(moved) else 0.0
    share = moved.min(1) / moved[:, 0].clip(1e-9)
    if speed <= _GLIDE_SPEED or np.quantile(share, 0.25) <= _GLIDE_SHARE:
        return []
    return [f"doubtful: the pelvis goes {speed:.1f} m in a second without a step: in centimetres?"]


def _check_gaps(where: str, known: np.ndarray, rate: float) -> None:
    if not known.any():
        raise InputError(f"{where}: every frame holds a number that is not finite")
    edges = np.flatnonzero(np.diff(np.concatenate([[True], known, [True]]).astype(int)))
    gap = (edges[1::2] - edges[::2]).max(initial=0) / rate
    if gap > LONGEST_GAP:
        raise InputError(
            f"{where}: {gap:.3g} s in a row without numbers, in frames "
            f"{listed(np.flatnonzero(~known))}; expected at most {LONGEST_GAP:g} s"
        )
