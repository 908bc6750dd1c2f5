"""Motions of AMASS, AIST++ and their look-alikes, as poses that drive an avatar.

Facts about the files are from the public descriptions of AMASS (nghorbani/amass), AIST++
(google/aistplusplus_api), GVHMR (zju3dv/GVHMR) and WHAM (yohanshin/WHAM).

A file may hold ``poses`` of any body, or parts of them; translations in metres, or in centimetres
with ``smpl_scaling``; a frame rate under several names, none of them exact; NaN where markers were
lost; angles of more than half a turn; and any axis may be up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch

from gva_mi.body.gestures import GESTURES, put_hand
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.importers.fields import find_betas, find_joints, find_translation
from gva_mi.data.importers.timeline import interpolate, listed, longest_gap
from gva_mi.data.importers.world import UP, up_axis, upright
from gva_mi.errors import InputError
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

    def __post_init__(self) -> None:
        require_ranges("motion", self)


@dataclass(frozen=True)
class Motion:
    """What came of a source."""

    pose: Pose
    shape: Shape
    notes: tuple[str, ...]  # what was found and done, for people


def read_motion(path: Path, body: BodyModel, options: MotionOptions) -> Motion:
    """Read a motion, and turn, fill and resample it.

    Args:
        path: .npz, .npy, .pkl or .pt; pickles run no code.
        body: whose pelvis stays in place when the world is turned upright.
        options: as above.

    Raises:
        InputError: what the file lacks, or cannot be told from it.
    """
    where = str(path)
    found = _one_person(path, read_objects(path, EXPECTED))
    joints = find_joints(where, found)
    rotations = joints.rotations
    transl = find_translation(where, found, len(rotations))
    rate, notes = _rate(where, found, options), []
    known = np.isfinite(rotations).all((1, 2)) & np.isfinite(transl).all(1)
    if not known.all():
        _check_gaps(where, known, rate, options)
        notes.append(f"frames without numbers, interpolated: {listed(np.flatnonzero(~known))}")
    if not joints.has_hands:
        for side in ("left", "right") if options.hands == "relaxed" else ():
            put_hand(rotations, side, GESTURES["rest"].values)
        notes.append(f"the source has no hands; they are {options.hands}")
    times = np.arange(len(rotations)) / rate
    count = int(np.floor(times[-1] * options.fps + 1e-6)) + 1
    if count > MOST_FRAMES:
        raise InputError(f"{where}: {count:,} frames at {options.fps:g} a second; give less --fps")
    wanted = np.arange(count) / options.fps
    rotations, transl = interpolate(times[known], rotations[known], transl[known], wanted)
    rest = body.rest(Shape(torch.zeros(0, dtype=body.v_template.dtype))).joints.double().numpy()
    up = up_axis(rotations, transl, rest) if options.up == "auto" else options.up
    if up is None:
        raise InputError(
            f"{where}: the head is above the feet along no axis; give --up, one of {', '.join(UP)}"
        )
    rotations, transl = upright(rotations, transl, up, rest[0])
    if options.place == "start":
        transl = transl - transl[0]
    notes.insert(0, f"{joints.form}, {len(known)} frames at {rate:g} a second, {up} up; "
                    f"now {count} at {options.fps:g}, y up")  # fmt: skip
    betas = find_betas(where, found)
    if betas is None or joints.form != "SMPL-X":
        betas = np.zeros(10)  # the shape spaces differ; an avatar has its own shape anyway
    betas = betas if betas.ndim == 1 else np.median(betas, axis=0)
    tensor = lambda x: torch.from_numpy(np.ascontiguousarray(x, np.float32))
    pose = Pose(tensor(rotations), tensor(transl), torch.zeros(count, 10))
    return Motion(pose, Shape(tensor(betas)), tuple(notes))


def _check_gaps(where: str, known: np.ndarray, rate: float, options: MotionOptions) -> None:
    """Raise an InputError where too many frames in a row, or all, hold no numbers."""
    if not known.any():
        raise InputError(f"{where}: every frame holds a number that is not finite")
    gap = longest_gap(known) / rate
    if gap > options.gap:
        raise InputError(
            f"{where}: {gap:.3g} s in a row without numbers, in frames "
            f"{listed(np.flatnonzero(~known))}; --gap {options.gap:g} allows less"
        )


def _one_person(path: Path, found: Any) -> Mapping[str, Any]:  # noqa: ANN401
    """The arrays of one person: GVHMR's in the world, or the longest of WHAM's."""
    if isinstance(found, np.ndarray) and found.dtype.hasobject and found.size == 1:
        found = found.item()
    if not isinstance(found, dict) or not found:
        raise InputError(f"{path}: holds no arrays by name; expected {EXPECTED}")
    if isinstance(found.get("smpl_params_global"), dict):
        return found["smpl_params_global"]
    people = [p for p in found.values() if isinstance(p, dict) and "pose_world" in p]
    if people:
        longest = max(people, key=lambda p: len(p["pose_world"]))
        return {"poses": longest["pose_world"], "trans": longest.get("trans_world")}
    return found


def _rate(where: str, found: Mapping[str, Any], options: MotionOptions) -> float:
    """Frames a second of the source; 120.00004 is 120."""
    if options.source_fps is not None:
        return options.source_fps
    name = next((name for name in RATES if name in found), None)
    if name is None and "smpl_scaling" in found:
        return AIST_RATE
    if name is None:
        raise InputError(
            f"{where}: says no frame rate (none of {', '.join(RATES)}); give --source-fps"
        )
    try:
        rate = float(np.ravel(found[name])[0])
    except (ValueError, TypeError, IndexError):
        rate = np.nan
    if not 0 < rate <= FASTEST:
        raise InputError(f"{where}: '{name}' must be frames a second, got {found[name]!s:.40}")
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 * rate and rate > 1 else rate
