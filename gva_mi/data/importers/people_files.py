"""Read estimators that write one file of all people and frames, or one a person."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.data.importers.estimator_files import (
    SeenPerson,
    any_holds,
    files_in,
    holds,
    read_named,
    read_source,
    stacked,
)
from gva_mi.data.importers.lens import pinhole_K
from gva_mi.data.importers.numbering import frame_numbers, frames_named, number_in
from gva_mi.data.importers.tracks import Track

# Focal length of VIBE and its kin, relative to the width of what they see.
FAR_SHARE = 5000 / 224


def wham(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read WHAM's file: one dictionary per person."""
    for name, person in found.items():
        ids = person["frame_ids" if "frame_ids" in person else "frame_id"]
        yield SeenPerson(str(name), frame_numbers(ids), person)


def vibe(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read the files of VIBE, PARE and their kin: one dictionary per person.

    Their camera (sx, sy, tx, ty) of the whole picture scales x + tx by sx half widths. A lens of
    ``c`` widths shows the same of a person at z = 2 c / sx.
    """
    for name, person in found.items():
        sx, _, tx, ty = np.reshape(person["orig_cam"], (-1, 4)).T
        place = np.stack([tx, ty, 2 * FAR_SHARE / sx], axis=1)
        arrays = {name: person[name] for name in ("pose", "betas") if name in person}
        yield SeenPerson(str(name), frame_numbers(person["frame_ids"]), arrays | {"place": place})


def prompthmr(which: str) -> Callable[[str, dict], Iterator[SeenPerson]]:
    """Return a reader of one of PromptHMR's parameter sets, ``smplx_cam`` or ``smplx_world``.

    Hands and face stay at rest in both, so they are left out.
    """

    def people(where: str, found: dict) -> Iterator[SeenPerson]:
        lens = found["camera"]
        K = pinhole_K(np.ravel(lens["img_focal"])[0], lens["img_center"])
        for name, person in found["people"].items():
            frames, of = frame_numbers(person["frames"]), person[which]
            row = (len(frames), -1, 3, 3) if "rotmat" in of else (len(frames), -1, 3)
            pose = np.reshape(of["rotmat" if "rotmat" in of else "pose"], row)
            yield SeenPerson(str(name), frames, {
                "global_orient": pose[:, 0], "body_pose": pose[:, 1:22], "transl": of["trans"],
                "betas": of["shape"], "K": K,
            })  # fmt: skip

    return people


def gvhmr(which: str) -> Callable[[str, dict], Iterator[SeenPerson]]:
    """Return a reader of one of GVHMR's parameter sets of one person, of the camera or world."""

    def one(where: str, found: dict) -> Iterator[SeenPerson]:
        person = found[which]
        frames, K = np.arange(len(person["body_pose"])), found.get("K_fullimg")
        yield SeenPerson("0", frames, {**person, "K": K})

    return one


def of_prompthmr(found: Any, which: str) -> bool:  # noqa: ANN401
    return holds(found, "people", "camera") and any_holds(found["people"], which, "frames")


def wham_world(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read WHAM's people in world axes; frames without numbers are consecutive."""
    for name, person in found.items():
        if _is_placed(person):
            every = np.arange(len(person["pose_world"]))
            ids = person.get("frame_ids", person.get("frame_id", every))
            yield SeenPerson(str(name), frame_numbers(ids), person)


def is_wham_world(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, Mapping) and any(map(_is_placed, found.values()))


def _is_placed(person: Any) -> bool:  # noqa: ANN401
    return isinstance(person, Mapping) and person.get("pose_world") is not None


def phalp(where: str, found: dict) -> list[SeenPerson]:
    """Read PHALP's (4D-Humans') file: one dictionary per frame, with lists of people."""
    rows = []
    for k, name in enumerate(sorted(found)):
        frame = found[name]
        number, tracked = int(frame.get("time", k)), frame.get("tracked_ids", frame["tid"])
        tracked = {int(i) for i in tracked}
        for person, smpl, camera in zip(frame["tid"], frame["smpl"], frame["camera"], strict=False):
            if int(person) in tracked:
                some = {key: smpl[key] for key in ("global_orient", "body_pose", "betas")}
                rows.append((str(int(person)), number, some | {"camera": camera}))
    return stacked(where, rows)


def pymafx(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read PyMAF-X's batches of parameters; all people follow one another."""
    frames = frame_numbers(found["frame_ids"])
    names = ("body_pose", "shape", "left_hand_pose", "right_hand_pose", "jaw_pose", "leye_pose",
             "reye_pose", "expression")  # fmt: skip
    arrays = {
        name: np.concatenate([np.asarray(batch[name]) for batch in found["smplx_params"]])
        for name in names
        if all(name in batch for batch in found["smplx_params"])
    } | {"orig_cam_t": np.asarray(found["orig_cam_t"])}
    for name, x in arrays.items():
        if len(x) != len(frames):
            raise InputError(f"{where}: '{name}' has {len(x)} rows for {len(frames)} frame_ids")
    people = [str(p) for p in np.ravel(found.get("person_ids", ()))]
    people = np.array(people if len(people) == len(frames) else ["0"] * len(frames))
    for name in dict.fromkeys(people.tolist()):
        rows = np.flatnonzero(people == name)
        yield SeenPerson(name, frames[rows], {key: x[rows] for key, x in arrays.items()})


def hybrik(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read HybrIK's person: matrices of SMPL's 24 joints or SMPL-X's 55, and a box per frame."""
    frames = frames_named(np.ravel(found["img_path"]))
    n = len(frames)
    shapes = {"pred_thetas": (n, -1, 3, 3), "pred_betas": (n, -1), "bbox": (n, 4)}
    arrays = {name: np.reshape(found[name], shape) for name, shape in shapes.items()}
    arrays |= {name: np.broadcast_to(np.ravel(found[name]), n) for name in ("width", "height")}
    yield SeenPerson("0", frames, arrays | {"pred_cam_root": found["pred_cam_root"]})


def tram_files(found: Any) -> list[Path]:  # noqa: ANN401
    return files_in(found, "hps/hps_track_*.npy", "hps_track_*.npy")


def tram_camera(found: Path) -> dict:
    """Read TRAM's lens and camera path (``pred_cam_R``, ``pred_cam_T``) from above ``hps/``."""
    above = found if tram_files(found)[0].parent != found else found.parent
    return read_named(above / "camera.npy", "img_focal and img_center, as TRAM writes")


def along_path(found: Path, tracks: list[Track]) -> list[Track] | None:
    """Transform TRAM's people to the world of its camera path; None where it says none."""
    about = tram_camera(found)
    if not holds(about, "pred_cam_R", "pred_cam_T"):
        return None
    R, T = (np.asarray(about[f"pred_cam_{x}"], np.float64) for x in "RT")
    if R.ndim != 3 or T.ndim != 2:
        return None
    return [track.seen_from(R[track.frames], T[track.frames]) for track in tracks]


def tram(where: str, found: Path) -> Iterator[SeenPerson]:
    """Read TRAM's folder: one file per person."""
    about = tram_camera(found)
    K = pinhole_K(np.ravel(about["img_focal"])[0], about["img_center"])
    for path in tram_files(found):
        person = read_source(path, "pred_rotmat, pred_trans and frame, as TRAM writes")
        frames = frame_numbers(person["frame"])
        pose = np.reshape(person["pred_rotmat"], (len(frames), -1, 3, 3))
        yield SeenPerson(str(number_in(path)), frames, {**person, "pred_rotmat": pose, "K": K})
