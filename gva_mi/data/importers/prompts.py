"""Make box and point prompts on the person in each frame, for a segmentation network.

* The box holds all joints and the top of the head, with room for clothes and hair.
* The points lie in the middle of thick parts of the body, where an estimate that is off by
  centimetres still meets the person: pelvis, chest, throat, head, and both thighs.
* The same points of other people are marked as not the person, unless they lie near one of the
  person's joints, because it is unknown which person stands in front.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.data.importers.people import pixels_by_frame
from gva_mi.data.importers.tracks import Track
from gva_mi.data.networks.segment_anything import Prompt

ROOM = 0.05  # of the longer side of the joints' box, round it
HEAD = 1.3  # from the head's joint to its top, in lengths from neck to head
NEAR = 0.12  # of that side: others' points nearer than this to a joint are left out
_NECK, _HEAD = JOINTS.index("neck"), JOINTS.index("head")
_PAIRS = [  # points are in the middle of these joints
    (JOINTS.index(a), JOINTS.index(b))
    for a, b in (
        ("pelvis", "pelvis"), ("spine2", "spine2"), ("neck", "head"), ("head", "head"),
        ("left_hip", "left_knee"), ("right_hip", "right_knee"),
    )
]  # fmt: skip


def prompts_of(
    track: Track, others: Sequence[Track], joints: np.ndarray, size: tuple[int, int]
) -> list[Prompt | None]:
    """Return a prompt for each frame of a track; None if the person is outside the picture.

    Frames are the video's; ``joints`` are (55, 3) of a body at rest, metres; ``size`` is (W, H).
    """
    theirs = [pixels_by_frame(other, joints, 55) for other in others]
    return [
        prompt_at(pixels, [seen[frame] for seen in theirs if frame in seen], size)
        for frame, pixels in pixels_by_frame(track, joints, 55).items()
    ]


def prompt_at(
    pixels: np.ndarray, others: Sequence[np.ndarray], size: tuple[int, int]
) -> Prompt | None:
    """Return a prompt by the joints (55, 2) of the person and of others; picture size (W, H).

    None if the person is outside the picture.
    """
    with np.errstate(invalid="ignore"):  # behind the camera
        top = pixels[_HEAD] + HEAD * (pixels[_HEAD] - pixels[_NECK])
    known = np.concatenate([pixels, top[None]])
    known = known[np.isfinite(known).all(1)]
    if not len(known):
        return None
    low, high = known.min(0), known.max(0)
    side = float((high - low).max())
    low, high = np.maximum(low - ROOM * side, 0), np.minimum(high + ROOM * side, size)
    own = _points(pixels, size)
    if not len(own) or (high - low < 1).any():
        return None
    known = np.concatenate([known, own])
    far = lambda place: np.linalg.norm(known - place, axis=1).min() > NEAR * side
    their = [place for other in others for place in _points(other, size) if far(place)]
    labels = np.array([1] * len(own) + [0] * len(their))
    return Prompt(np.concatenate([low, high]), np.array([*own, *their]), labels)


def _points(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the prompt points (n, 2) of a person's joints (55, 2) that are in the picture."""
    with np.errstate(invalid="ignore"):
        places = np.stack([(pixels[a] + pixels[b]) / 2 for a, b in _PAIRS])
        return places[((places >= 0) & (places < size)).all(1)]
