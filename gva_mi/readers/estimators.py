"""The table of pose estimators: :data:`KINDS` has one record for each program.

**To add a program**, add a record of :class:`Estimator`. Say that its file is a dictionary by
people, each with ``theta`` (T, 72), ``camera_t`` (T, 3), and ``frame_ids`` (T,). Its lens is
WHAM's. Then::

    "mine": Estimator(
        expects="people with theta and camera_t",
        recognises=lambda found: has_one(found, "theta", "camera_t"),
        people=people_by_name("theta"),
        arrays={"poses": "theta", "transl": "camera_t"},
        lens=wham_lens,
    ),

1. ``recognises`` looks for names that no other program's files have: :mod:`.source_files`.
2. ``people`` and ``lens`` are functions of :mod:`.estimator_layouts`; if none fits, add one there.
3. ``arrays`` has the file's name for each of ours (:data:`.body_arrays.ARRAY_NAMES`), and
   ``poses`` for all joints in a row. Without it, the names of that table are read.
4. ``docs/sources.md`` gets a row, and ``WRITTEN`` in ``tests/samples/estimates.py`` a file to test.

Root rotation and translation are in the camera's axes: x right, y down, z forward. The focal length
that a program assumes is kept, because its translations hold for this one only. :data:`WORLDS` has
the programs that also write the motion in a world; a motion that drives an avatar is read from
there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError, expecting
from gva_mi.readers.body_arrays import (
    NOT_BODY_NAMES,
    NamedArrays,
    holds_pose,
    is_numbers,
    listed_names,
    posed_parts,
)
from gva_mi.readers.estimator_layouts import (
    People,
    VideoInfo,
    hybrik_lens,
    hybrik_person,
    is_romp,
    lens_by_name,
    named_people,
    no_lens,
    people_by_name,
    person_under,
    phalp_lens,
    phalp_people,
    romp_lens,
    romp_people,
    smplerx_files,
    smplerx_people,
    wham_lens,
)
from gva_mi.readers.people import Arrays
from gva_mi.readers.source_files import (
    contents,
    first_of,
    has_one,
    holds,
    read_source,
)
from gva_mi.readers.track import Track, make_track


@dataclass(frozen=True)
class Estimator:
    """One program: how its files are recognised, and what their arrays mean."""

    # What its files hold, in words for error messages.
    expects: str
    # Whether a source is this program's; it gets a file's content, or a folder's path.
    recognises: Callable[[Any], bool]
    # Reads the people in a source: people(where, found), where errors name the source as ``where``.
    people: Callable[[str, Any], People]
    # The file's name for each of our arrays. Empty: any names of body_arrays.
    arrays: Mapping[str, str] = field(default_factory=dict)
    # The lens that the program assumes, lens(where, arrays, info): K (3, 3) or (n, 3, 3), pixels.
    # By default the array K of the person.
    lens: Callable[[str, Arrays, VideoInfo], np.ndarray] = lambda where, arrays, info: arrays["K"]  # noqa: E731
    # Whether its translation is the pelvis's position, and not the offset of the body's origin.
    gives_pelvis: bool = False
    # Whether finger rotations are relative to the model's mean hand, and not to a flat hand.
    from_mean_hand: bool = False
    # Whether positions depend on the size of the video's pictures: then a file alone is no motion.
    needs_video: bool = False
    # The axis that is up: one of up_axis.UP_AXES, "-y" in the camera's axes; None: any.
    up: str | None = "-y"
    # The number of the first frame; None: that in its picture's name.
    first_number: int | None = 0

    def tracks(self, where: str, found: Any, info: VideoInfo) -> list[Track]:  # noqa: ANN401
        """Return the people in a source, one track each, in the camera's axes, frames ascending."""
        tracks, people = [], list(self.people(where, found))
        for person in people:
            at = where if len(people) == 1 else f"{where}: person {person.name}"
            K = np.asarray(self.lens(at, person.arrays, info), np.float64)
            given, notes = self._named(person.arrays)
            if info.is_known and NamedArrays(at, given).find("transl") is None:
                raise InputError(f"{at}: no translation; expected transl (T, 3) in the camera")
            track = make_track(
                at, person.name, person.frames, given, K, info.body, self.gives_pelvis
            )
            mean = self.from_mean_hand and track.has_hands
            track = replace(track, from_mean_hand=mean, notes=(*track.notes, *notes))
            tracks.append(track.where(np.unique(track.frames, return_index=True)[1]))
        return tracks

    def _named(self, found: Arrays) -> tuple[Arrays, list[str]]:
        """Return the arrays under our names, and a note on numbers that are not used."""
        if not self.arrays:
            return found, []
        known = {*NOT_BODY_NAMES, *self.arrays.values()}
        rest = sorted(k for k, x in found.items() if k not in known and is_numbers(x))
        notes = [f"arrays of the source that are not used: {listed_names(rest)}"] if rest else []
        return {ours: found[x] for ours, x in self.arrays.items() if x in found}, notes


KINDS: dict[str, Estimator] = {
    "wham": Estimator(
        expects="people with pose, trans and frame_ids",
        recognises=lambda found: has_one(found, "pose", "trans", "frame_ids|frame_id"),
        people=people_by_name("pose"),
        arrays={"poses": "pose", "transl": "trans", "betas": "betas"},
        lens=wham_lens,
    ),
    "gvhmr": Estimator(
        expects="smpl_params_incam and K_fullimg",
        recognises=lambda found: holds(found, "smpl_params_incam", "K_fullimg"),
        people=person_under("smpl_params_incam"),
    ),
    "4dhumans": Estimator(
        expects="frames with tid, smpl and camera",
        recognises=lambda found: has_one(found, "tid", "smpl", "camera"),
        people=phalp_people,
        arrays={"global_orient": "global_orient", "body_pose": "body_pose", "betas": "betas",
                "transl": "camera"},
        lens=phalp_lens,
        needs_video=True,
    ),
    "hybrik": Estimator(
        expects="pred_thetas, pred_cam_root and bbox",
        recognises=lambda found: holds(found, "pred_thetas", "pred_cam_root", "bbox"),
        people=hybrik_person,
        arrays={"poses": "pred_thetas", "transl": "pred_cam_root", "betas": "pred_betas"},
        lens=hybrik_lens,
        gives_pelvis=True,
        needs_video=True,
        first_number=1,
    ),
    "romp": Estimator(
        expects="results with smpl_thetas and cam_trans",
        recognises=is_romp,
        people=romp_people,
        arrays={"poses": "smpl_thetas", "transl": "cam_trans", "betas": "smpl_betas"},
        lens=romp_lens,
        first_number=None,
    ),
    "smplerx": Estimator(
        expects="a folder with smplx/00001_0.npz and meta/00001_0.json",
        recognises=lambda found: bool(smplerx_files(found)),
        people=smplerx_people,
        from_mean_hand=True,
        first_number=1,
    ),
    # Any program that uses public names: the last row, because it recognises most.
    "parameters": Estimator(
        expects="global_orient, body_pose and transl by name, in a file or one a frame",
        recognises=lambda found: holds_pose(x := first_of(found)) or bool(posed_parts(x)),
        people=named_people,
        lens=lens_by_name,
        up=None,
        first_number=None,
    ),
}  # fmt: skip
WORLDS: dict[str, Estimator] = {  # the same files, read in the program's own world
    "wham": Estimator(
        expects="people with pose_world",
        recognises=lambda found: has_one(found, "pose_world"),
        people=people_by_name("pose_world"),
        arrays={"poses": "pose_world", "transl": "trans_world", "betas": "betas"},
        lens=no_lens,
        up="y",
    ),
    "gvhmr": Estimator(
        expects="smpl_params_global",
        recognises=lambda found: holds(found, "smpl_params_global"),
        people=person_under("smpl_params_global"),
        lens=no_lens,
        up="y",
    ),
}


def read_estimator(kind: str, source: Path, info: VideoInfo) -> tuple[str, list[Track]]:
    """Read the people in an estimator's file or folder, and return them with its kind.

    ``kind`` is one of :data:`KINDS`, or "auto". Nothing in the file is executed.
    """
    found = read_source(source)
    kind = kind_of(found) or "" if kind == "auto" else kind
    if not kind:
        known = "; ".join(f"{name}: {record.expects}" for name, record in KINDS.items())
        raise InputError(
            f"{source}: unknown estimator format, holds {contents(found)}; expected one of {known}"
        )
    record = KINDS[kind]
    if not record.recognises(found):
        raise InputError(
            f"{source}: not a source of {kind}, holds {contents(found)}; expected {record.expects}"
        )
    with expecting(f"{source} (read as {kind})", record.expects):
        return kind, record.tracks(str(source), found, info)


def kind_of(found: Any) -> str | None:  # noqa: ANN401
    """Return which of :data:`KINDS` wrote a file (its content) or folder (its path), or None."""
    return next((name for name, record in KINDS.items() if record.recognises(found)), None)
