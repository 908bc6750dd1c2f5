"""Choose the subject among the people in a source: by name, by masks, or by number of frames.

A person's joints lie inside the person's mask. In each frame a joint inside the mask is a vote for
its person, and a joint outside a vote against. So a passer-by in many frames collects votes
against, and does not win by number of frames.

A joint of a track is seen at ``K (p + place of the joint relative to the pelvis)``, with p the
pelvis's position. Positions relative to the pelvis are computed with any body in the track's
rotations; the error is smaller than limbs are wide.

Some files hold single frames. They become people by the names in the file, or, without names, each
person continues as the nearest one in the next frame.

The joints also prompt a segmentation network with a box and points: :func:`prompt_at`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gva_mi.body.pose import BODY, JOINTS
from gva_mi.core.errors import InputError
from gva_mi.networks.segment_anything import Prompt
from gva_mi.readers.track import Track
from gva_mi.subject.lens import seen_alike, usual_lens
from gva_mi.subject.masks import INSIDE_ABOVE
from gva_mi.subject.silhouettes import count_in_mask, joints_in_world

# All chosen.
_LONGEST_STEP = 1.0  # metres from frame to frame: a person who is farther away is another one
BOX_MARGIN = 0.05  # around the joints' box, relative to its longer side: clothes and hair
HEAD_TOP = 1.3  # distance from the head's joint to its top, over that from neck to head
OTHERS_DISTANCE = 0.12  # of the box's longer side: nearer points of others are not prompts
_NECK, _HEAD = JOINTS.index("neck"), JOINTS.index("head")
_PROMPT_JOINTS = [  # a point is halfway between two joints
    (JOINTS.index(a), JOINTS.index(b))
    for a, b in (
        ("pelvis", "pelvis"), ("spine2", "spine2"), ("neck", "head"), ("head", "head"),
        ("left_hip", "left_knee"), ("right_hip", "right_knee"),
    )
]  # fmt: skip

Arrays = Mapping[str, Any]  # (n, ...) each, under the file's own names


class Row(NamedTuple):
    """One person in one frame of a file."""

    person: str | None  # the file's name of them
    frame: int
    arrays: Arrays  # of this frame


@dataclass(frozen=True)
class SeenPerson:
    """One person's arrays in a file, under the file's own names."""

    name: str  # the estimator's name of them
    frames: np.ndarray | None  # (n,) frame numbers; None: 0 to n − 1
    arrays: Arrays  # (n, ...) each


def choose(
    where: str,
    tracks: Sequence[Track],
    person: str | None,
    votes: Callable[[], np.ndarray] | None,
) -> tuple[Track, list[str]]:
    """Choose the subject among the tracks, and return it with a note that says how.

    ``person`` is the estimator's name of one. ``votes`` are joints (n, 2) of each track inside the
    masks and outside, called only if masks decide. If no track lies in them, the one with most
    frames is chosen.
    """
    if not tracks:
        raise InputError(f"{where}: holds no person; expected at least one")
    names = ", ".join(f"{t.person} ({len(t.frames)} frames)" for t in tracks[:20])
    if person is not None:
        chosen = next((t for t in tracks if t.person == person), None)
        if chosen is None:
            raise InputError(f"{where}: has no person '{person}'; it has {names}")
        return chosen, []
    if len(tracks) == 1:
        return tracks[0], []
    inside, outside = (votes() if votes else np.zeros((1, 2), int)).T
    best = int(np.argmax(inside - outside))
    if inside[best] > outside[best]:
        share = 100 * inside / np.maximum(1, inside + outside)
        shares = ", ".join(
            f"{t.person} ({len(t.frames)} frames, {s:.0f} % of the joints)"
            for t, s in zip(tracks[:20], share, strict=False)
        )
        chosen, how = tracks[best], f"most inside the masks, of {shares}"
    else:
        chosen = max(tracks, key=lambda t: len(t.frames))
        why = ", because no person lies in the masks" if votes else ""
        how = f"seen longest of {names}{why}"
    return chosen, [f"person {chosen.person}, {how}; --person takes another"]


def joints_in_masks(
    tracks: Sequence[Track], masks: Iterable[np.ndarray], joints: np.ndarray
) -> np.ndarray:
    """Count each track's joints inside the masks and outside, (n, 2), without hands and face.

    A frame with an empty mask has no vote, and neither has a joint beyond the picture's border.
    Masks are (H, W) 8-bit, frame by frame from 0; ``joints`` are (55, 3) of a body at rest, metres.
    """
    seen = [pixels_by_frame(track, joints) for track in tracks]
    votes = np.zeros((len(tracks), 2), int)
    for k, mask in enumerate(masks):
        inside = mask > INSIDE_ABOVE
        for person, pixels in enumerate(seen if inside.any() else ()):
            if k in pixels:
                hits, there = count_in_mask(pixels[k], inside)
                votes[person] += hits, there - hits
    return votes


def pixels_by_frame(
    track: Track, joints: np.ndarray, count: int = BODY.stop
) -> dict[int, np.ndarray]:
    """Project a track's first ``count`` joints, by default root and body, in each frame.

    Pixels (count, 2) are not finite behind the camera. ``joints`` are (55, 3) of a body at rest,
    metres.
    """
    places = joints_in_world(track.rotations, np.zeros((len(track.frames), 3)), joints)[:, :count]
    x = places - places[:, :1] + track.places[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        projected = np.einsum("tab,tjb->tja", track.K, x)
        seen = projected[..., :2] / projected[..., 2:]
    pixels = np.where(x[..., 2:] > 0, seen, np.inf)
    return dict(zip(track.frames.tolist(), pixels, strict=True))


def stacked(where: object, rows: Iterable[Row]) -> list[SeenPerson]:
    """Stack rows to people; an array of one frame may have a leading axis of 1."""
    people: dict[str, list[tuple[int, Arrays]]] = {}
    for row in rows:
        people.setdefault(row.person, []).append((row.frame, row.arrays))
    found = []
    for person, seen in people.items():
        names = dict.fromkeys(name for _, arrays in seen for name in arrays)
        arrays = {name: [_of_frame(x[name]) for _, x in seen if name in x] for name in names}
        for name, values in arrays.items():
            if len(values) < len(seen) or len({x.shape for x in values}) > 1:
                raise InputError(f"{where}: '{name}' must have the same shape in all frames")
        frames = np.array([frame for frame, _ in seen])
        found.append(SeenPerson(person, frames, {k: np.stack(x) for k, x in arrays.items()}))
    return found


def _of_frame(value: Any) -> np.ndarray:  # noqa: ANN401
    array = np.asarray(value)
    return array[0] if array.ndim > 1 and len(array) == 1 else array


def followed(where: object, rows: Iterable[Row], place: str) -> list[SeenPerson]:
    """Stack rows without names to people: each continues as the nearest in the next frame.

    ``place`` is the file's name of the translation. If each row has a lens K of its own, positions
    are compared as one usual lens sees them.
    """
    by_frame: dict[int, list[Arrays]] = {}
    for row in rows:
        by_frame.setdefault(row.frame, []).append(row.arrays)
    frames = sorted(by_frame.items())
    everyone = [person for _, people in frames for person in people]
    places = np.array([np.ravel(person[place]) for person in everyone]).reshape(-1, 3)
    if everyone and "K" in everyone[0]:
        K = np.stack([person["K"] for person in everyone])
        places = seen_alike(places, K, usual_lens(K))
    ends = np.cumsum([len(people) for _, people in frames])[:-1]
    names = follow(np.split(places, ends))
    return stacked(where, (
        Row(name, number, person)
        for (number, people), row in zip(frames, names, strict=True)
        for name, person in zip(row, people, strict=True)
    ))  # fmt: skip


def follow(places: Sequence[Sequence[np.ndarray]]) -> list[list[str]]:
    """Track people without ids: each continues the nearest person of earlier frames.

    ``places`` are the positions (3,), metres, of the people in each frame. Names count from "0".
    """
    last: list[np.ndarray] = []  # where each person was seen last
    names = []
    for found in places:
        found = np.asarray(found, np.float64).reshape(-1, 3)
        chosen: dict[int, int] = {}
        pairs = [(np.linalg.norm(x - y), i, j) for i, x in enumerate(found)
                 for j, y in enumerate(last)]  # fmt: skip
        for distance, i, j in sorted(pairs):
            if distance < _LONGEST_STEP and i not in chosen and j not in chosen.values():
                chosen[i] = j
        for i, place in enumerate(found):
            if i not in chosen:
                chosen[i] = len(last)
                last.append(place)
            last[chosen[i]] = place
        names.append([str(chosen[i]) for i in range(len(found))])
    return names


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
    """Return a prompt from the joints (55, 2), pixels, of the person and of others.

    ``size`` is the picture's (W, H). None if the person is outside the picture.
    """
    with np.errstate(invalid="ignore"):  # behind the camera
        top = pixels[_HEAD] + HEAD_TOP * (pixels[_HEAD] - pixels[_NECK])
    known = np.concatenate([pixels, top[None]])
    known = known[np.isfinite(known).all(1)]
    if not len(known):
        return None
    low, high = known.min(0), known.max(0)
    side = float((high - low).max())
    low, high = np.maximum(low - BOX_MARGIN * side, 0), np.minimum(high + BOX_MARGIN * side, size)
    own = _points(pixels, size)
    if not len(own) or (high - low < 1).any():
        return None
    known = np.concatenate([known, own])
    far = lambda place: np.linalg.norm(known - place, axis=1).min() > OTHERS_DISTANCE * side
    their = [place for other in others for place in _points(other, size) if far(place)]
    labels = np.array([1] * len(own) + [0] * len(their))
    return Prompt(np.concatenate([low, high]), np.array([*own, *their]), labels)


def _points(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the prompt points (n, 2) of a person's joints (55, 2) that are in the picture."""
    with np.errstate(invalid="ignore"):
        places = np.stack([(pixels[a] + pixels[b]) / 2 for a, b in _PROMPT_JOINTS])
        return places[((places >= 0) & (places < size)).all(1)]
