"""Estimators that write one file a video: readers of :mod:`estimators`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.data.importers.readings import (
    View,
    centred,
    make_track,
    of_pelvis,
    of_weak_perspective,
    rescaled,
)  # fmt: skip
from gva_mi.data.importers.tracks import Track
from gva_mi.errors import InputError

PHALP_FOCAL = 5000 / 256  # focal length over the larger side of the picture
FAR_FOCAL = 5000.0  # pixels, of those who assume that a person stands far away
HYBRIK_FOCAL = 1000 / 256  # focal length over the width of the person's box


def last_number(name: object) -> int:
    """The last number in a name, as people number frames.

    Raises:
        ValueError: there is none.
    """
    numbers = re.findall(r"\d+", Path(str(name)).stem)
    if not numbers:
        raise ValueError(f"no number in the name '{name}'")
    return int(numbers[-1])


def _people(found: Any) -> dict:  # noqa: ANN401
    """A file's people by name, where each is a dictionary."""
    whole = isinstance(found, dict) and all(isinstance(p, dict) for p in found.values())
    return found if whole else {}


def _numbers(person: Mapping[str, Any]) -> np.ndarray:
    return frame_numbers(person["frame_ids" if "frame_ids" in person else "frame_id"])


def frame_numbers(value: Any) -> np.ndarray:  # noqa: ANN401
    """Numbers of frames (n,) of what a file says; NaN as whole numbers would be frames of a guess.

    Raises:
        ValueError: they are no whole numbers.
    """
    numbers = np.ravel(value).astype(np.float64)
    if not (np.isfinite(numbers) & (numbers == np.floor(numbers))).all():
        raise ValueError("frames must be numbered by whole numbers")
    return numbers.astype(int)


def is_wham(found: Any) -> bool:  # noqa: ANN401
    people = _people(found).values()
    return any({"pose", "trans"} <= set(p) and {"frame_ids", "frame_id"} & set(p) for p in people)


def read_wham(where: str, found: dict, view: View) -> list[Track]:
    tracks = []
    for name, person in found.items():
        at = f"{where}: person {name}"
        frames = _numbers(person)
        given = {"pose": person["pose"], "trans": person["trans"]}
        given["betas"] = person.get("betas")
        focal = float(np.ravel(person.get("focal_length", np.hypot(*view.size)))[0])
        K = centred(focal, view.size, len(frames))
        tracks.append(make_track(at, str(name), frames, given, K))
    return tracks


def is_vibe(found: Any) -> bool:  # noqa: ANN401
    people = _people(found).values()
    return any({"pose", "orig_cam", "frame_ids"} <= set(person) for person in people)


def read_vibe(where: str, found: dict, view: View) -> list[Track]:
    focal, tracks = view.focal or FAR_FOCAL, []
    for name, person in found.items():
        frames = _numbers(person)
        transl = of_weak_perspective(person["orig_cam"], focal, view.size)
        given = {"pose": person["pose"], "betas": person.get("betas"), "transl": transl}
        K = centred(focal, view.size, len(frames))
        tracks.append(make_track(f"{where}: person {name}", str(name), frames, given, K))
    return tracks


def is_gvhmr(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, dict) and {"smpl_params_incam", "K_fullimg"} <= set(found)


def read_gvhmr(where: str, found: dict, view: View) -> list[Track]:
    person = found["smpl_params_incam"]
    K = np.asarray(found["K_fullimg"], np.float64)
    frames = np.arange(len(person["transl"]))
    K = np.broadcast_to(K, (len(frames), 3, 3)) if K.shape in ((3, 3), (1, 3, 3)) else K
    return [make_track(f"{where}: smpl_params_incam", "0", frames, person, K)]


def is_phalp(found: Any) -> bool:  # noqa: ANN401
    frames = _people(found).values()
    return any({"smpl", "camera", "tid"} <= set(frame) for frame in frames)


def read_phalp(where: str, found: dict, view: View) -> list[Track]:
    people: dict[int, list[tuple[int, dict, Any]]] = {}
    for k, name in enumerate(sorted(found)):
        frame = found[name]
        number = int(frame.get("time", k))
        tracked = {int(i) for i in frame.get("tracked_ids", frame["tid"])}
        for person, smpl, camera in zip(frame["tid"], frame["smpl"], frame["camera"], strict=False):
            if int(person) in tracked:
                people.setdefault(int(person), []).append((number, smpl, camera))
    tracks = []
    for person, seen in people.items():
        at = f"{where}: person {person}"
        stacked = lambda key, seen=seen: np.stack([np.asarray(smpl[key]) for _, smpl, _ in seen])
        given = {
            "global_orient": stacked("global_orient").reshape(len(seen), 1, 3, 3),
            "body_pose": stacked("body_pose").reshape(len(seen), -1, 3, 3),
            "betas": stacked("betas").reshape(len(seen), -1),
            "transl": np.stack([np.ravel(camera) for _, _, camera in seen]),
        }
        K = centred(PHALP_FOCAL * max(view.size), view.size, len(seen))
        tracks.append(make_track(at, str(person), np.array([n for n, _, _ in seen]), given, K))
    return tracks


def is_glamr(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, dict) and {"person_data", "cam_pose"} <= set(found)


def read_glamr(where: str, found: dict, view: View) -> list[Track]:
    """Roots and pelvises as the camera sees them after the camera's own path was found."""
    tracks = []
    for name, person in found["person_data"].items():
        at = f"{where}: person {name}"
        frames = np.flatnonzero(np.ravel(person["exist_frames"]))
        if not len(frames):
            continue
        some = lambda key, person=person, frames=frames: np.asarray(person[key])[frames]
        moved = "smpl_orient_cam_in_world" in person
        root, pelvis = (
            ("smpl_orient_cam_in_world", "root_trans_cam_in_world")
            if moved
            else ("smpl_orient_cam", "root_trans_cam")
        )
        K = np.asarray(person["cam_K"], np.float64)
        K = K[np.argmax(K[:, 0, 0] > 0)]  # one lens; zero where nobody is seen
        if not K[0, 0] > 0:
            raise InputError(f"{at}: 'cam_K' is zero in all frames; expected a focal length")
        K = rescaled(at, K, 2 * K[:2, 2], view.size)
        given = {
            "global_orient": some(root), "body_pose": some("smpl_pose"),
            "transl": of_pelvis(some(pelvis), "SMPL"), "betas": some("smpl_beta"),
        }  # fmt: skip
        K = np.tile(K, (len(frames), 1, 1))
        tracks.append(make_track(at, str(name), frames, given, K))
    return tracks


def is_pymafx(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, dict) and {"smplx_params", "orig_cam_t", "frame_ids"} <= set(found)


def read_pymafx(where: str, found: dict, view: View) -> list[Track]:
    """Parameters come in batches, of all people after one another."""
    joined = lambda name: np.concatenate([np.asarray(b[name]) for b in found["smplx_params"]])
    frames = frame_numbers(found["frame_ids"])
    body = joined("body_pose")  # (n, J, 3, 3), the root before the rest
    arrays = {
        "global_orient": body[:, :1], "body_pose": body[:, 1:22], "betas": joined("shape"),
        "transl": np.asarray(found["orig_cam_t"]),
    }  # fmt: skip
    for name in ("left_hand_pose", "right_hand_pose", "jaw_pose", "leye_pose", "reye_pose"):
        arrays[name] = joined(name)
    uneven = [name for name, x in arrays.items() if len(x) != len(frames)]
    if uneven:
        raise InputError(
            f"{where}: '{uneven[0]}' has {len(arrays[uneven[0]])} rows for {len(frames)} frame_ids"
        )
    people = [str(p) for p in np.ravel(found.get("person_ids", ()))]
    people = people if len(people) == len(frames) else ["0"] * len(frames)
    tracks = []
    for name in dict.fromkeys(people):
        rows = np.flatnonzero(np.array(people) == name)
        given = {key: x[rows] for key, x in arrays.items()}
        K = centred(FAR_FOCAL, view.size, len(rows))
        tracks.append(make_track(f"{where}: person {name}", name, frames[rows], given, K))
    return tracks


def is_hybrik(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, dict) and {"pred_thetas", "pred_cam_root", "bbox"} <= set(found)


def read_hybrik(where: str, found: dict, view: View) -> list[Track]:
    """One person; rotation matrices of 24 joints, or of SMPL-X's 55, and a lens for each box."""
    frames = np.array([last_number(name) for name in np.ravel(found["img_path"])])
    n = len(frames)
    matrices = np.reshape(found["pred_thetas"], (n, -1, 3, 3))
    parts = {"global_orient": slice(0, 1), "body_pose": slice(1, None)}
    form = "SMPL"
    if matrices.shape[1] == 55:
        form = "SMPL-X"
        parts |= {
            "body_pose": slice(1, 22), "jaw_pose": slice(22, 23), "leye_pose": slice(23, 24),
            "reye_pose": slice(24, 25), "left_hand_pose": slice(25, 40),
            "right_hand_pose": slice(40, 55),
        }  # fmt: skip
    given: dict[str, Any] = {name: matrices[:, part] for name, part in parts.items()}
    given["transl"] = of_pelvis(found["pred_cam_root"], form)
    given["betas"] = np.reshape(found["pred_betas"], (n, -1))
    box, sizes = np.reshape(found["bbox"], (n, 4)), _sizes(found, n)
    K = np.concatenate([
        rescaled(where, centred(HYBRIK_FOCAL * width, of, 1), of, view.size)
        for width, of in zip(box[:, 2] - box[:, 0], sizes, strict=True)
    ])  # fmt: skip
    return [make_track(where, "0", frames, given, K)]


def _sizes(found: Mapping[str, Any], n: int) -> Sequence[tuple[int, int]]:
    """(W, H) of each picture."""
    width, height = (np.broadcast_to(np.ravel(found[name]), n) for name in ("width", "height"))
    return list(zip(width.tolist(), height.tolist(), strict=True))
