"""Find one person's landmarks and silhouette in every picture of a video, by MediaPipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.core.console import Progress, listed
from gva_mi.core.errors import InputError
from gva_mi.core.tasks import in_order
from gva_mi.networks.body_landmarks import BodyNetwork, SeenBody
from gva_mi.networks.hand_face_landmarks import FaceNetwork, HandNetwork, SeenPart
from gva_mi.networks.person_tracker import PersonDetector, PersonTracker
from gva_mi.subject.landmarks import BODY_LANDMARKS, FACE_LANDMARKS, Landmarks, hand_names

LANDMARK_NAMES = (*BODY_LANDMARKS, *hand_names("left"), *hand_names("right"), *FACE_LANDMARKS)


@dataclass(frozen=True)
class WatchedVideo:
    """What the networks find in T pictures of a video."""

    landmarks: Landmarks  # NaN where the person, a hand or the face is not found
    notes: Sequence[str]  # sentences on what went wrong
    crowded: Sequence[int] = ()  # pictures with several people


def watch_video(
    pictures: Sequence[np.ndarray],
    on_silhouette: Callable[[int, np.ndarray], None] | None = None,
    person: int | None = None,
    progress: Progress | None = None,
) -> WatchedVideo:
    """Find one person's landmarks in all pictures of a video, in their order.

    Args:
        pictures: T pictures (H, W, 3) 8-bit; each is read once.
        on_silhouette: called with each picture's number and the probability (H, W) float32 that
            a pixel shows the person; all zero if the person is not found.
        person: the N-th from the left; None: the largest and most central.
        progress: called after every picture.
    """
    body_network, hand_network, face_network = BodyNetwork(), HandNetwork(), FaceNetwork()
    tracker = PersonTracker(PersonDetector(), body_network, person)

    def bodies() -> Iterator[tuple[np.ndarray, SeenBody | None]]:
        body = None
        for k in range(len(pictures)):
            image, before = pictures[k], body
            body = tracker.follow(image)
            if body is not None:
                body = body_network.see_mirrored(image, body, before)
            yield image, body
            if on_silhouette is not None:
                closer = None if body is None else body_network.see_closer(image, body)
                nobody = np.zeros(image.shape[:2], np.float32)
                on_silhouette(k, nobody if body is None else closer.probability(nobody.shape))
            if progress:
                progress(k + 1, len(pictures))

    hands, face = {}, None

    def with_parts(seen: tuple[np.ndarray, SeenBody | None]) -> tuple[np.ndarray, ...]:
        nonlocal hands, face
        image, body = seen
        hands = {} if body is None else hand_network.find(image, body, hands)
        face = None if body is None else face_network.find(image, body, face)
        return _row(body, hands, face)

    with ThreadPoolExecutor(1) as beside:  # while the next body is found
        rows = list(in_order(beside, with_parts, bodies(), ahead=1))
    if not tracker.begun:
        several = f"{person} people" if (person or 1) > 1 else "a person"
        raise InputError(
            f"the network finds {several} in no picture of the video; expected one person, filmed "
            "from head to feet"
        )
    landmarks = Landmarks(LANDMARK_NAMES, *(np.stack(parts) for parts in zip(*rows, strict=True)))
    return WatchedVideo(landmarks, _notes(tracker, landmarks), tuple(tracker.crowded))


def _row(
    body: SeenBody | None, hands: dict[str, SeenPart], face: SeenPart | None
) -> tuple[np.ndarray, ...]:
    """Return one picture's row of each array of :class:`Landmarks`."""
    count = len(LANDMARK_NAMES)
    pixels, metric = np.full((count, 2), np.nan), np.full((count, 3), np.nan)
    confidence, spread = np.zeros(count), np.zeros(count)
    if body is not None:
        n = len(BODY_LANDMARKS)
        pixels[:n], metric[:n] = body.points[:n], body.metric[:n]
        confidence[:n], spread[:n] = body.visibility[:n], body.spread[:n]
    parts = {hand_names(side)[0]: hand for side, hand in hands.items()}
    for name, part in (parts | ({} if face is None else {FACE_LANDMARKS[0]: face})).items():
        at = slice(LANDMARK_NAMES.index(name), LANDMARK_NAMES.index(name) + len(part.points))
        pixels[at], metric[at] = part.points, part.metric
        confidence[at], spread[at] = part.presence, part.spread
    return pixels, confidence, spread, metric


def _notes(tracker: PersonTracker, landmarks: Landmarks) -> list[str]:
    """Return sentences about pictures in which the networks failed."""
    notes = []
    if tracker.crowded:
        notes.append(f"frames with several people: {listed(tracker.crowded)}")
    if tracker.lost:
        notes.append(f"frames where the person was not found: {listed(tracker.lost)}")
    for side in SIDES:
        wrist = landmarks.indices([f"{side}_hand_wrist"])
        seen = np.isfinite(landmarks.pixels[:, wrist, 0]).mean()
        if seen < 0.5:
            notes.append(f"the {side} hand was recognised in {seen:.0%} of the frames")
    return notes
