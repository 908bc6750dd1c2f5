"""Read keypoints of OpenPose, MMPose and AlphaPose as landmarks.

======================  ==============================================================  ============
Program                 Form                                                            Points
======================  ==============================================================  ============
OpenPose                a folder of ``..._000000000012_keypoints.json``: ``people`` of  25 or 18,
                        ``pose_keypoints_2d``, ``hand_left_keypoints_2d``, ...          2 × 21
MMPose, RTMPose         a file or folder: ``instances`` of ``keypoints`` and            17, 26, 133,
                        ``keypoint_scores``, by ``frame_id``                            136
AlphaPose, COCO         a list of ``keypoints`` (x, y, score each) by ``image_id``      the same
======================  ==============================================================  ============

The number of points names them: 25 BODY_25, 18 OpenPose's COCO, 17 COCO, 133 COCO-WholeBody, 26 and
136 Halpe. All count the points of a hand as MediaPipe does. The centre of the first pixel is (0, 0)
in these files, and (0.5, 0.5) here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.subject.footage import counted_from_0
from gva_mi.subject.landmarks import Landmarks, hand_names

_EXPECTED_KEYPOINTS = "keypoints of OpenPose, MMPose or AlphaPose (.json)"
# Of the person's height, the median over frames. Chosen: with more, it is another person or video.
_LARGEST_OFFSET = 0.2


def _sided(*names: str) -> list[str]:
    return [f"{side}_{name}" for name in names for side in SIDES]


_COCO = ("nose", *_sided("eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
_ARMS = [f"{side}_{name}" for side in ("right", "left") for name in ("shoulder", "elbow", "wrist")]
_LEGS = [f"{side}_{name}" for side in ("right", "left") for name in ("hip", "knee", "ankle")]
_FACE = ("right_eye", "left_eye", "right_ear", "left_ear")
_FEET = ("left_foot_index", "", "left_heel", "right_foot_index", "", "right_heel")
_HANDS = (*hand_names("left"), *hand_names("right"))
_HALPE = (*_COCO, "", "", "", *_sided("foot_index"), "", "", *_sided("heel"))
LAYOUTS: Mapping[int, tuple[str, ...]] = {  # by number of points; "" for those that are not used
    25: ("nose", "", *_ARMS, "", *_LEGS, *_FACE, *_FEET),
    18: ("nose", "", *_ARMS, *_LEGS, *_FACE),
    17: _COCO,
    133: (*_COCO, *_FEET, *[""] * 68, *_HANDS),
    26: _HALPE,
    136: (*_HALPE, *[""] * 68, *_HANDS),
}
KEYPOINT_NAMES = (*dict.fromkeys(filter(None, LAYOUTS[133])),)
_OPENPOSE_HANDS = {f"hand_{side}_keypoints_2d": hand_names(side) for side in SIDES}


def read_keypoints(path: Path) -> dict[int, list[np.ndarray]]:
    """Read all people of each frame; frames are numbered from 0.

    A person is (P, 3): x, y in pixels and confidence of each of :data:`KEYPOINT_NAMES`; NaN where a
    point was not found.
    """
    with expecting(path, _EXPECTED_KEYPOINTS):
        files = sorted(path.glob("[!.]*.json")) if path.is_dir() else [path]
        seen = [
            (file if path.is_dir() else frame, person)
            for file in files
            for frame, person in _people(path, read_json(file, _EXPECTED_KEYPOINTS), None)
        ]
        names = files if path.is_dir() else [name for name, _ in seen]
        numbers = dict(zip(names, counted_from_0(names), strict=True))
    if not seen:
        raise InputError(f"{path}: holds no people; expected {_EXPECTED_KEYPOINTS}")
    found: dict[int, list[np.ndarray]] = {}
    for name, person in seen:
        found.setdefault(numbers[name], []).append(person)
    return found


def _people(
    where: Path,
    value: Any,  # noqa: ANN401
    frame: object,
) -> Iterator[tuple[object, np.ndarray]]:
    """Yield frame and points of each person in a value of a file, however deep."""
    if isinstance(value, Mapping):
        frame = next((value[n] for n in ("frame_id", "frame_index", "image_id")
                      if n in value and frame is None), frame)  # fmt: skip
        if "pose_keypoints_2d" in value or "keypoints" in value:
            yield frame, _person(where, value)
            return
        value = [value[n] for n in ("people", "instances", "instance_info", "annotations",
                                    "predictions") if n in value]  # fmt: skip
    if isinstance(value, list):
        for item in value:
            yield from _people(where, item, frame)


def _person(where: Path, value: Mapping) -> np.ndarray:
    """Return the points (P, 3) of one person."""
    given = np.asarray(value.get("pose_keypoints_2d", value.get("keypoints")), np.float64)
    scores = np.ravel(value.get("keypoint_scores", ()))
    if len(scores) and given.size == 2 * len(scores):
        given = np.concatenate([given.reshape(-1, 2), scores[:, None]], 1)
    points = given.reshape(-1, 3)
    if len(points) not in LAYOUTS:
        raise InputError(
            f"{where}: a person has {len(points)} points; expected "
            f"{', '.join(map(str, sorted(LAYOUTS)))}"
        )
    parts = [(LAYOUTS[len(points)], points)]
    for name, names in _OPENPOSE_HANDS.items():
        hand = np.asarray(value.get(name, ()), np.float64).reshape(-1, 3)
        parts += [(names, hand)] if len(hand) == len(names) else []
    found = np.full((len(KEYPOINT_NAMES), 3), np.nan)
    for names, points in parts:
        for name, point in zip(names, points, strict=True):
            if name and point[2] > 0 and np.isfinite(point).all():
                found[KEYPOINT_NAMES.index(name)] = *(point[:2] + 0.5), min(point[2], 1.0)
    return found


def with_keypoints(
    landmarks: Landmarks, path: Path, numbers: Iterable[int], scale: float
) -> tuple[Landmarks, list[str]]:
    """Replace a network's landmarks by a file's keypoints, and return notes.

    Of several people, the one nearest to the network's person is taken, or, where the network found
    nobody, the nearest to the frame before. Depths stay the network's, because keypoints have none.

    Args:
        landmarks: of the network, T frames.
        path: what :func:`read_keypoints` reads.
        numbers: T numbers of the frames in the file.
        scale: pixels of the landmarks in one of the file.
    """
    found = read_keypoints(path)
    which = [k for k, name in enumerate(KEYPOINT_NAMES) if name in landmarks.names]
    at = landmarks.indices([KEYPOINT_NAMES[k] for k in which])
    names = ("pixels", "confidence", "spread")
    pixels, confidence, spread = (getattr(landmarks, name).copy() for name in names)
    pixels[:, at], confidence[:, at], spread[:, at] = np.nan, 0, 0
    before, apart = None, []
    for t, number in enumerate(numbers):
        people = [x[which] * [scale, scale, 1] for x in found.get(number, [])]
        network = landmarks.pixels[t, at]
        guide = network if np.isfinite(network).any() else before
        if not people or guide is None:
            continue
        off = [np.linalg.norm(x[:, :2] - guide, axis=1) for x in people]
        off = [np.median(x[np.isfinite(x)]) if np.isfinite(x).any() else np.inf for x in off]
        person = people[int(np.argmin(off))]
        if guide is network:
            apart.append(min(off) / np.ptp(guide[np.isfinite(guide[:, 1]), 1]))
        pixels[t, at] = before = person[:, :2]
        confidence[t, at] = np.nan_to_num(person[:, 2])
    for side in SIDES:  # a hand is found, or is not, as a whole
        hand = landmarks.indices(hand_names(side))
        seen = confidence[:, hand]
        confidence[:, hand] = np.median(seen, 1, keepdims=True) * (seen > 0)
    if not apart or not np.median(apart) < _LARGEST_OFFSET:
        raise InputError(
            f"{path}: its keypoints do not lie on the person of the video; expected keypoints of "
            "all frames of the video, numbered in order, in pixels of its upright pictures"
        )
    count = int(np.isfinite(pixels[:, at]).any((1, 2)).sum())
    fields = landmarks.names, pixels, confidence, spread, landmarks.metric, KEYPOINT_NAMES
    replaced = Landmarks(*fields)
    return replaced, [f"keypoints of {path} in {count} of {len(pixels)} frames"]
