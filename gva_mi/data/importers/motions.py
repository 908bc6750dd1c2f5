"""Motions of AMASS, AIST++ and their look-alikes, as poses that drive an avatar.

Facts about the files are from the public descriptions of AMASS (nghorbani/amass) and AIST++
(google/aistplusplus_api); of what pose estimators write, from :mod:`estimators`.

A file may hold ``poses`` of any body, or parts of them; translations in metres, or in centimetres
with ``smpl_scaling``; a frame rate under several names, none of them exact; NaN where markers were
lost; angles of more than half a turn; and any axis may be up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch

from gva_mi.body.gestures import GESTURES, put_hand
from gva_mi.body.pose import LEFT_HAND, SMPLX_FIELDS, Pose, Shape
from gva_mi.body.puppet import PUPPET
from gva_mi.console import listed
from gva_mi.data.importers.estimated_motions import estimated, lone_track, refuse_folder
from gva_mi.data.importers.fields import find_betas, find_joints, find_translation
from gva_mi.data.importers.frame_files import first_of, plain
from gva_mi.data.importers.other_bodies import refuse_other_bodies
from gva_mi.data.importers.readings import PELVIS
from gva_mi.data.importers.target import Target
from gva_mi.data.importers.timeline import interpolate, longest_gap
from gva_mi.data.importers.tracks import Track, median_betas
from gva_mi.data.importers.world import UP, up_axis, upright
from gva_mi.errors import InputError
from gva_mi.files import read_arrays
from gva_mi.pickles.reader import read_objects
from gva_mi.ranges import Within, require_ranges

EXPECTED = "a motion such as AMASS's .npz or AIST++'s .pkl"
RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "framerate", "frame_rate")
AIST_RATE = 60.0  # frames a second of AIST++, whose files do not say so
FASTEST = 10_000.0  # frames a second
MOST_FRAMES = 1_000_000  # of one motion, after resampling
FrameRate = Annotated[float, Within(0, FASTEST, "low")]


@dataclass(frozen=True)
class MotionOptions:
    """How a motion is brought to this program's conventions."""

    fps: FrameRate = 25.0  # frames a second of the poses; gva-mi render plays 25
    # Frames a second of the source; without it, what its file says.
    source_fps: FrameRate | None = None
    up: Literal["auto", "x", "-x", "y", "-y", "z", "-z"] = "auto"  # the source's axis that is up
    hands: Literal["relaxed", "flat"] = "relaxed"  # where the source has none
    place: Literal["start", "source"] = "start"  # the pelvis in the first frame: at rest's place
    # Seconds without numbers in a row that are still interpolated.
    gap: Annotated[float, Within(0, 3600, "low")] = 1.0
    # The estimator's name of one of several people; without it, who is seen longest.
    person: str | None = None

    def __post_init__(self) -> None:
        require_ranges("motion", self)


@dataclass(frozen=True)
class Motion:
    """What came of a source."""

    pose: Pose
    shape: Shape
    notes: tuple[str, ...]  # what was found and done, for people


@dataclass(frozen=True)
class Driven:
    """The body that a motion is for."""

    joints: np.ndarray  # (55, 3) at rest, metres
    mean_hands: np.ndarray  # (30, 3) left before right, relative to flat ones
    components: np.ndarray | None  # (2, K, 45) of SMPL-X's PCA of hands, in the same order

    @staticmethod
    def of(path: Path | None) -> Driven:
        """A body's file at its mean shape; None: the puppet.

        Raises:
            InputError: as :func:`gva_mi.body.smplx.load_body`.
        """
        target = Target.read(path or PUPPET)
        shape = Shape(torch.zeros(0, dtype=target.model.v_template.dtype))
        joints = target.model.rest(shape).joints.double().numpy()
        return Driven(joints, target.mean_hands, target.components)


def is_poses(path: Path) -> bool:
    """Whether a file holds poses in this program's own form, which are driven as they are.

    They have all names of :func:`gva_mi.body.pose.load_poses` in its widths. A file that is not
    there counts, too: that reader says so.
    """
    if not path.exists():
        return True
    try:
        found = read_arrays(path, EXPECTED)
    except InputError:
        return False
    if "stage" in found:  # made here, whatever happened to it since
        return True
    widths = {name: 3 * (part.stop - part.start) for name, part in SMPLX_FIELDS.items()}
    return {"global_orient", "body_pose", "transl", "betas"} <= set(found) and all(
        found[name].ndim == 2 and found[name].shape[1] == width
        for name, width in widths.items()
        if name in found
    )


def read_motion(path: Path, driven: Driven, options: MotionOptions) -> Motion:
    """Read a motion, and turn, fill and resample it.

    Args:
        path: .npz, .npy, .pkl or .pt, or an estimator's folder; pickles run no code.
        driven: whose pelvis stays in place when the world is turned upright, and whose hands
            components of a PCA weigh.
        options: as above.

    Raises:
        InputError: what the file lacks, or cannot be told from it.
    """
    where = str(path)
    track, rate, betas, said = _found(path, driven, options)
    rotations, transl, known = _timeline(where, track)
    notes = [*said]
    if not known.all():
        _check_gaps(where, known, rate, options)
        notes.append(f"frames without numbers, interpolated: {listed(np.flatnonzero(~known))}")
    if track.from_mean_hand:
        rotations[:, LEFT_HAND.start :] += driven.mean_hands
        notes.append("hands are components of a PCA, added to the body's mean hand")
    if not track.has_hands:
        for side in ("left", "right") if options.hands == "relaxed" else ():
            put_hand(rotations, side, GESTURES["rest"].values)
        notes.append(f"the source has no hands; they are {options.hands}")
    times = np.arange(len(rotations)) / rate
    count = int(np.floor(times[-1] * options.fps + 1e-6)) + 1
    if count > MOST_FRAMES:
        raise InputError(f"{where}: {count:,} frames at {options.fps:g} a second; give less --fps")
    wanted = np.arange(count) / options.fps
    rotations, transl = interpolate(times[known], rotations[known], transl[known], wanted)
    up = up_axis(rotations, transl, driven.joints) if options.up == "auto" else options.up
    if up is None:
        raise InputError(
            f"{where}: the head is above the feet along no axis; give --up of gva-mi motion, one "
            f"of {', '.join(UP)}"
        )
    rotations, transl = upright(rotations, transl, up, driven.joints[0])
    if options.place == "start":
        transl = transl - transl[0]
    notes.insert(0, f"{track.form}, {len(known)} frames at {rate:g} a second, {up} up; "
                    f"now {count} at {options.fps:g}, y up")  # fmt: skip
    tensor = lambda x: torch.from_numpy(np.ascontiguousarray(x, np.float32))
    pose = Pose(tensor(rotations), tensor(transl), torch.zeros(count, 10))
    return Motion(pose, Shape(tensor(betas)), tuple(notes))


def _found(
    path: Path, driven: Driven, options: MotionOptions
) -> tuple[Track, float, np.ndarray, list[str]]:
    """One person's track, frames a second, their betas (B,), and what to say."""
    where, found = str(path), _opened(path)
    refuse_other_bodies(where, first_of(path) if path.is_dir() else found)
    people = estimated(path, found, options.person, driven.components)
    if people is None and isinstance(found, Path):
        refuse_folder(path)
    if people is not None:
        track, notes = people
        rate, betas = _rate(where, {}, options), track.betas
        # From the source's body to the driven one, whose pelvis is elsewhere at rest.
        place = track.transl + np.array(PELVIS[track.form])
        track = replace(track, transl=place - driven.joints[0])
    else:
        lone_track(path, found)
        track, notes = _by_name(where, found, driven.components), []
        rate, betas = _rate(where, found, options), find_betas(where, found)
    if betas is None or track.form != "SMPL-X":
        return track, rate, np.zeros(10), notes  # the shape spaces differ, and avatars have one
    betas, varied = median_betas(np.atleast_2d(betas))
    return track, rate, betas, [*notes, *varied]


def _by_name(where: str, found: Mapping[str, Any], components: np.ndarray | None) -> Track:
    """One person's arrays, as fields.py knows them; K and betas mean nothing."""
    joints = find_joints(where, found, components)
    count = len(joints.rotations)
    transl, K = find_translation(where, found, count), np.tile(np.eye(3), (count, 1, 1))
    return Track(
        "0", np.arange(count), joints.rotations, transl, None, K, joints.form, joints.has_hands,
        joints.from_mean_hand,
    )  # fmt: skip


def _timeline(where: str, track: Track) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations (T, 55, 3), translations (T, 3) and whether they are known (T,), first to last.

    Frames that an estimator left out are NaN, as those are whose numbers are.
    """
    rows = track.frames - track.frames.min()
    count = int(rows.max()) + 1
    if count > MOST_FRAMES:
        raise InputError(
            f"{where}: frames {track.frames.min()} to {track.frames.max()}, expected at most "
            f"{MOST_FRAMES:,}"
        )
    rotations = np.full((count, *track.rotations.shape[1:]), np.nan)
    transl = np.full((count, 3), np.nan)
    rotations[rows], transl[rows] = track.rotations, track.transl
    return rotations, transl, np.isfinite(rotations).all((1, 2)) & np.isfinite(transl).all(1)


def _check_gaps(where: str, known: np.ndarray, rate: float, options: MotionOptions) -> None:
    """Raise an InputError where too many frames in a row, or all, hold no numbers."""
    if not known.any():
        raise InputError(f"{where}: every frame holds a number that is not finite")
    gap = longest_gap(known) / rate
    if gap > options.gap:
        raise InputError(
            f"{where}: {gap:.3g} s in a row without numbers, in frames "
            f"{listed(np.flatnonzero(~known))}; --gap {options.gap:g} of gva-mi motion allows less"
        )


def _opened(path: Path) -> Any:  # noqa: ANN401
    """What a file holds by name; a folder as its path."""
    if path.is_dir():
        return path
    found = plain(read_objects(path, EXPECTED))
    if isinstance(found, dict) and found:
        return found
    refuse_other_bodies(path, found)
    raise InputError(f"{path}: holds no arrays by name; expected {EXPECTED}")


def _rate(where: str, found: Mapping[str, Any], options: MotionOptions) -> float:
    """Frames a second of the source; 120.00004 is 120."""
    if options.source_fps is not None:
        return options.source_fps
    name = next((name for name in RATES if name in found), None)
    if name is None and "smpl_scaling" in found:
        return AIST_RATE
    if name is None:
        raise InputError(
            f"{where}: says no frame rate (none of {', '.join(RATES)}); give --source-fps of "
            "gva-mi motion"
        )
    try:
        rate = float(np.ravel(found[name])[0])
    except (ValueError, TypeError, IndexError):
        rate = np.nan
    if not 0 < rate <= FASTEST:
        raise InputError(f"{where}: '{name}' must be frames a second, got {found[name]!s:.40}")
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 * rate and rate > 1 else rate
