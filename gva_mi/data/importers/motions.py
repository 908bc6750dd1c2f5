"""Convert motions of AMASS, AIST++, pose estimators and others to poses that drive an avatar.

Facts about the files are from the public descriptions of AMASS (nghorbani/amass) and AIST++
(google/aistplusplus_api). A file may hold ``poses`` of any body, or parts of them; translations in
metres, or in centimetres with ``smpl_scaling``; a frame rate under several names; NaN where markers
were lost; angles of more than half a turn; and any axis may be up.

An estimator's motion is in world axes if the estimator gives them or the camera's path; else in
camera axes, and then the camera is assumed to stand still. A lens of its own in each frame becomes
one usual lens: :mod:`.one_lens`. Estimators whose file does not say the lens are refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch

from gva_mi.body.gestures import GESTURES, put_hand
from gva_mi.body.pose import SIDES, Pose, Shape
from gva_mi.core.console import listed
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.options import Within, options_of
from gva_mi.data.folder import POSES, REFINED_POSES
from gva_mi.data.importers.estimator_files import first_of, holds, read_source, refuse_mhr
from gva_mi.data.importers.estimators import (
    KINDS,
    WORLDS,
    Estimator,
    VideoInfo,
    kind_of,
    lens_by_name,
)
from gva_mi.data.importers.frame_rate import FPS, rate_of
from gva_mi.data.importers.hand_merge import merge_hands
from gva_mi.data.importers.joint_fit import joints_track
from gva_mi.data.importers.joint_motion import RATE, joints_in
from gva_mi.data.importers.lens import through_lens
from gva_mi.data.importers.mosh import from_mosh
from gva_mi.data.importers.one_lens import is_one_lens, usual_lens
from gva_mi.data.importers.people import choose
from gva_mi.data.importers.retarget import bvh_track
from gva_mi.data.importers.spellings import named_rows, unnested
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.importers.tracks import Track, interpolate, make_track, median_betas
from gva_mi.data.importers.world import LEANS, UP, Upward, upright

HANDS = ("relaxed", "flat")
EXPECTED = "a motion such as AMASS's .npz or AIST++'s .pkl"
MOST_FRAMES = 1_000_000  # of one motion, after resampling
FrameRate = Annotated[float, FPS]
_SPRINT = 15.0  # metres a second; nobody ran faster than 12.5


@options_of("motion")
class MotionOptions:
    """Options of the conversion of a motion to this program's conventions."""

    fps: FrameRate = 25.0  # frames a second of the poses; gva-mi render plays 25
    # Frames a second of the source; without it, what its file says.
    source_fps: FrameRate | None = None
    up: Literal["auto", "x", "-x", "y", "-y", "z", "-z"] = "auto"  # the source's axis that is up
    # Where the source has none, relaxed or flat; or a file or folder of a hand estimator, such as
    # HaMeR or WiLoR.
    hands: str = "relaxed"
    place: Literal["start", "source"] = "start"  # the pelvis in the first frame: at rest's place
    # Seconds in a row without numbers that are still interpolated.
    gap: Annotated[float, Within(0, 3600, "low")] = 1.0
    # The estimator's name of one of several people; without it, the person seen longest.
    person: str | None = None

    def __post_init__(self) -> None:
        if self.hands not in HANDS and not Path(self.hands).exists():
            raise InputError(
                f"motion: --hands must be {' or '.join(HANDS)}, or hands found by another "
                f"program; got {self.hands}, which is no file"
            )


@dataclass(frozen=True)
class Motion:
    """A motion that was read."""

    pose: Pose
    shape: Shape
    notes: tuple[str, ...]  # what was found and done


def read_motion(path: Path, body: TargetBody, options: MotionOptions) -> Motion:
    """Read a motion; turn it upright, fill its gaps, resample it.

    ``path`` is .bvh, .npz, .npy, .pkl or .pt, or an estimator's folder; pickles run no code.
    Components of a PCA weigh the hands of ``body``.
    """
    body = body.for_source(path)
    return _resampled(str(path), *_read(path, body, options), body, options)


def motion_of_poses(
    where: str, pose: Pose, shape: Shape, fps: float, body: TargetBody, options: MotionOptions
) -> Motion:
    """Resample poses of ``fps`` frames a second, and put them where :func:`read_motion` does."""
    if options.hands not in HANDS:
        raise InputError(f"{where}: --hands of a file are for motions of files; films have hands")
    body = replace(body, of_source=True)
    named = {name: x.double().numpy() for name, x in pose.to_smplx().items()}
    named["betas"] = shape.betas.double().numpy()
    track = make_track(where, "0", None, named, np.eye(3), body)
    return _resampled(where, track, fps, "y", body, options)


def _resampled(
    where: str, track: Track, rate: float, own_up: str | None, body: TargetBody,
    options: MotionOptions,
) -> Motion:  # fmt: skip
    """Turn a track upright, fill its gaps, and resample it; ``own_up`` is its form's own axis."""
    if options.hands not in HANDS:
        start = int(track.frames.min() == 1)  # of SMPLer-X
        counted = replace(track, frames=track.frames - start)
        track, more = merge_hands(counted, Path(options.hands), body.mean_hands)
        track = replace(track, notes=(*track.notes, *more))
    rotations, others, known = _timeline(where, track.with_flat_hands(body.mean_hands))
    notes = list(track.notes)
    if not known.all():
        _check_gaps(where, known, rate, options)
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
            f"of {', '.join(UP)}"
        )
    if (lean := upward.lean(up)) >= LEANS:
        notes.append(f"the person leans {lean:.0f} degrees from that axis; --up takes another")
    rotations, places = upright(rotations, places, up)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if len(steps) and (speed := np.median(steps) * options.fps) > _SPRINT:
        notes.append(f"doubtful: the pelvis goes {speed:.0f} m in a second: in centimetres or "
                     "millimetres? Translations must be metres")  # fmt: skip
    betas, varied = median_betas(track.betas if track.form == "SMPL-X" else None)
    expression, of_face = body.expression(track.form, expression)
    notes = [*notes, *varied, *of_face]
    own = betas if body.keeps_betas(track.form) else betas * 0
    pelvis = places[0] if options.place == "start" else body.pelvises(body.form, own)
    notes.insert(0, f"{track.form}, {len(known)} frames at {rate:g} a second, {up} up; "
                    f"now {count} at {options.fps:g}, y up")  # fmt: skip
    shape = Shape(torch.from_numpy(betas.astype(np.float32)))
    return Motion(Pose.of_arrays(rotations, places - pelvis, expression), shape, tuple(notes))


def _read(path: Path, body: TargetBody, options: MotionOptions) -> tuple[Track, float, str | None]:
    """Read one person's track, frames per second, and the form's own up axis."""
    where = str(path)
    if path.suffix.lower() == ".bvh":
        track, fps = bvh_track(path, body)
        return track, rate_of(where, {"fps": fps}, options.source_fps), None
    found = from_mosh(read_source(path, EXPECTED))
    if (places := joints_in(path, found, options.person)) is not None:
        rate = options.source_fps or RATE
        return joints_track(places, rate, body.joints), rate, None
    refuse_mhr(where, first_of(found))
    if isinstance(found, np.ndarray) and not found.dtype.hasobject:
        found = named_rows(path, found)
    if not isinstance(found, dict | Path) or not found:
        raise InputError(f"{path}: holds no arrays by name; expected {EXPECTED}")
    world = next((kind for kind, record in WORLDS.items() if record.recognises(found)), None)
    kind = world or kind_of(found)
    if kind is not None and (kind != "parameters" or isinstance(found, Path)):
        record = WORLDS[kind] if world else KINDS[kind]
        track = _estimated(kind, record, path, found, options.person, body)
        return track, rate_of(where, {}, options.source_fps), record.up
    if isinstance(found, Path):
        poses = [n for n in (REFINED_POSES, POSES) if (path / n).is_file()]
        hint = f"; its motion is {path / poses[0]}" if poses else ""
        raise InputError(
            f"{path}: a folder of no motion that is known; expected a file such as AMASS's .npz or "
            "AIST++'s .pkl, or the folder of TRAM, ROMP, BEV, Multi-HMR, SMPLer-X or OSX" + hint
        )
    if holds(found, "pred_rotmat", "pred_trans"):
        raise InputError(
            f"{path}: one person of TRAM without its camera; give the folder with hps/ and "
            "camera.npy"
        )
    found = unnested(found)
    K = lens_by_name(where, found, VideoInfo((1000, 1000), 1.0))
    K = K if len(K) > 1 and not is_one_lens(K) else np.eye(3)
    track = _before_one_lens(make_track(where, "0", None, found, K, body))
    own = "y" if {"smpl_scaling", "stage"} & set(found) else None  # AIST++, and our own
    return track, rate_of(where, found, options.source_fps), own


def _estimated(
    kind: str, record: Estimator, path: Path, found: Any,  # noqa: ANN401
    person: str | None, body: TargetBody,
) -> Track:  # fmt: skip
    """Return one person of an estimator's output, in world or camera axes (module docstring)."""
    if record.needs_video:
        raise InputError(
            f"{path}: written by {kind}, whose places follow from a lens that it assumed; expected "
            f"a motion in metres, or gva-mi prepare {kind} with its video"
        )
    with expecting(f"{path} (of the kind {kind})", "a motion of one person at least"):
        # Of the size of its pictures nothing is known, nor of a lens that follows from it.
        tracks = record.tracks(str(path), found, VideoInfo((1000, 1000), 1.0, body))
        axes = "in the axes of its world"
        if record is not WORLDS.get(kind):
            placed = record.along_path(found, tracks) if record.along_path else None
            standing = "in the axes of the camera, which is taken to stand still"
            axes = standing if placed is None else "in the world of its camera's path"
            tracks = tracks if placed is None else placed
        track, chosen = choose(str(path), tracks, person, None)
    return _before_one_lens(track, f"{kind}, {axes}", *chosen)


def _before_one_lens(track: Track, *notes: str) -> Track:
    """Return a track with notes, before one usual lens if it has another in each frame."""
    if not is_one_lens(track.K):
        K = usual_lens(track.K)
        track = through_lens(track, K)
        lens = f"{K[0, 0]:.0f} pixels"
        notes += (f"seen through another lens in each frame; placed before one of {lens}",)
    return replace(track, notes=(*notes, *track.notes))


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


def _check_gaps(where: str, known: np.ndarray, rate: float, options: MotionOptions) -> None:
    if not known.any():
        raise InputError(f"{where}: every frame holds a number that is not finite")
    edges = np.flatnonzero(np.diff(np.concatenate([[True], known, [True]]).astype(int)))
    gap = (edges[1::2] - edges[::2]).max(initial=0) / rate
    if gap > options.gap:
        raise InputError(
            f"{where}: {gap:.3g} s in a row without numbers, in frames "
            f"{listed(np.flatnonzero(~known))}; --gap {options.gap:g} of gva-mi motion allows less"
        )
