"""Where the person is in each frame, for a network that finds whatever boxes and points are on.

* The box holds all joints and the top of the head, and a little more, for clothes and hair.
* The points are in the middle of thick parts of the body, where an estimate that is some
  centimetres off still meets the person: pelvis, chest, throat, head, and both thighs.
* Where others are seen, too, the like points of theirs say what is not the person, unless they lie
  near one of the person's own: who stands in front is not known.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.data.importers.in_masks import joint_pixels
from gva_mi.data.importers.readings import PELVIS
from gva_mi.data.importers.tracks import Track
from gva_mi.data.networks.segment_anything import Prompt

ROOM = 0.05  # of the longer side of the joints' box, round it
HEAD = 1.3  # from the head's joint to its top, in lengths of what is between neck and head
NEAR = 0.12  # of that side: somebody else's points nearer than this to a joint say nothing
_AT = {name: k for k, name in enumerate(JOINTS)}
_PAIRS = [  # points are in the middle of these joints
    (_AT[a], _AT[b])
    for a, b in (
        ("pelvis", "pelvis"), ("spine2", "spine2"), ("neck", "head"), ("head", "head"),
        ("left_hip", "left_knee"), ("right_hip", "right_knee"),
    )
]  # fmt: skip


def prompts_of(
    track: Track, others: Sequence[Track], joints: np.ndarray, size: tuple[int, int]
) -> list[Prompt | None]:
    """A prompt for each frame of a track; None where nothing of the person is in the picture.

    Args:
        track: the person, in frames of the video.
        others: other people, likewise.
        joints: (55, 3) of a body at rest, metres.
        size: (W, H) of the pictures.
    """
    seen = _seen(track, joints)
    theirs = [(_rows(other), _seen(other, joints)) for other in others]
    prompts = []
    for frame, pixels in zip(track.frames.tolist(), seen, strict=True):
        also = [found[rows[frame]] for rows, found in theirs if frame in rows]
        prompts.append(_prompt(pixels, also, size))
    return prompts


def _rows(track: Track) -> dict[int, int]:
    """The row of each frame of a track."""
    return {frame: row for row, frame in enumerate(track.frames.tolist())}


def _seen(track: Track, joints: np.ndarray) -> np.ndarray:
    return joint_pixels(track, joints, np.array(PELVIS[track.form]), len(joints))


def _prompt(
    pixels: np.ndarray, others: Sequence[np.ndarray], size: tuple[int, int]
) -> Prompt | None:
    """Of the joints (55, 2) of a person, and of others, in a picture of (W, H)."""
    with np.errstate(invalid="ignore"):  # behind the camera
        top = pixels[_AT["head"]] + HEAD * (pixels[_AT["head"]] - pixels[_AT["neck"]])
    known = np.concatenate([pixels, top[None]])
    known = known[np.isfinite(known).all(1)]
    if not len(known):
        return None
    low, high = known.min(0), known.max(0)
    side = float((high - low).max())
    low, high = np.maximum(low - ROOM * side, 0), np.minimum(high + ROOM * side, size)
    own = _inside(_points(pixels), size)
    if not len(own) or (high - low < 1).any():
        return None
    known = np.concatenate([known, own])
    far = lambda place: np.linalg.norm(known - place, axis=1).min() > NEAR * side
    their = [place for other in others for place in _inside(_points(other), size) if far(place)]
    labels = np.array([1] * len(own) + [0] * len(their))
    return Prompt(np.concatenate([low, high]), np.array([*own, *their]), labels)


def _points(pixels: np.ndarray) -> np.ndarray:
    """The points (n, 2) of a person's joints (55, 2)."""
    return np.stack([(pixels[a] + pixels[b]) / 2 for a, b in _PAIRS])


def _inside(places: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Those of places (n, 2) that are in the picture."""
    with np.errstate(invalid="ignore"):
        return places[((places >= 0) & (places < size)).all(1)]
