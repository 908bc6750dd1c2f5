"""Merge hands of a hand estimator into the poses of a body estimator.

Where a hand is seen, its fingers take the place of the body's. Between frames of it they are
interpolated; farther than :data:`NEAR` frames from any, they go over into the body's own hand, or
into a relaxed one. The wrist may be taken, too: with the elbow's rotation E in the camera's axes,
and the wrist's G there, the wrist's own is Eᵀ G.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gva_mi.body.gestures import GESTURES, put_hand
from gva_mi.body.pose import HANDS, JOINTS, PARENTS, SIDES
from gva_mi.body.rotations import to_matrices, to_rotvecs
from gva_mi.core.errors import InputError
from gva_mi.data.importers.hands import ForeignHand, read_hands
from gva_mi.data.importers.people import pixels_by_frame
from gva_mi.data.importers.tracks import Track, interpolate

NEAR = 5  # frames around a hand that was seen, in which it is held


def merge_hands(
    track: Track,
    path: Path,
    mean_hands: np.ndarray,
    *,
    wrists: bool = False,
    from_mean: bool = False,
    first: int = 0,
    body: np.ndarray | None = None,
) -> tuple[Track, list[str]]:
    """Return a track with the hands of a file, and notes.

    Args:
        track: of the body; its frames count from 0.
        path: what :func:`read_hands` reads.
        mean_hands: (30, 3) of the body, relative to flat ones, left before right.
        wrists: take the wrists, too; the track is in the camera's axes.
        from_mean: the fingers of the file are relative to MANO's mean hand.
        first: of :func:`read_hands`.
        body: joints (55, 3) at rest, metres, which show whose hands they are;
            None where the lens is not known.
    """
    hands, notes = read_hands(path, first)
    rotations = track.with_flat_hands(mean_hands).rotations.copy()
    seen, said = {} if body is None else pixels_by_frame(track, body), []
    for k, side in enumerate(SIDES):
        if not track.has_hands:
            put_hand(rotations, side, GESTURES["rest"].values)
        at = {frame: pixels[JOINTS.index(f"{side}_wrist")] for frame, pixels in seen.items()}
        chosen = _one_each(hands, side, set(track.frames.tolist()), at)
        said.append(f"{len(chosen)} {side}")
        if chosen:
            mean = mean_hands[15 * k : 15 * (k + 1)] if from_mean else 0.0
            _put(path, rotations, track.frames, chosen, side, wrists, mean)
    if all(text.startswith("0 ") for text in said):
        frames = [hand.frame for hand in hands]
        raise InputError(
            f"{path}: has hands of frames {min(frames)} to {max(frames)}, and none of the body's, "
            f"{track.frames.min()} to {track.frames.max()}"
        )
    notes.append(
        f"of {len(track.frames)} frames, hands of {path} in {' and '.join(said)}; between them "
        "interpolated or " + ("the body's own" if track.has_hands else "relaxed")
    )
    return replace(track, rotations=rotations, has_hands=True, from_mean_hand=False), notes


def _one_each(
    hands: Sequence[ForeignHand], side: str, frames: set[int], at: dict[int, np.ndarray]
) -> dict[int, ForeignHand]:
    """Return one hand for each frame: the first, or of several the one nearest to the wrist."""
    found: dict[int, ForeignHand] = {}
    for hand in hands:
        if hand.side != side or hand.frame not in frames or not np.isfinite(hand.fingers).all():
            continue
        other = found.get(hand.frame)
        if other is None:
            found[hand.frame] = hand
        elif at and hand.centre is not None and other.centre is not None:
            wrist = at[hand.frame]
            if np.linalg.norm(hand.centre - wrist) < np.linalg.norm(other.centre - wrist):
                found[hand.frame] = hand
    return found


def _put(
    path: Path, rotations: np.ndarray, frames: np.ndarray, hands: dict[int, ForeignHand],
    side: str, wrists: bool, mean: np.ndarray | float,
) -> None:  # fmt: skip
    """Write one side's hands into rotations (n, 55, 3) of ``frames`` (n,)."""
    order = sorted(hands)
    seen = np.stack([hands[k].fingers + mean for k in order])
    joints = list(range(HANDS[side].start, HANDS[side].stop))
    if wrists:
        if any(hands[k].wrist is None for k in order):
            raise InputError(f"{path}: holds no wrists (global_orient), which are asked for")
        wrist = JOINTS.index(f"{side}_wrist")
        rows = np.searchsorted(frames, order)
        joint = PARENTS[wrist]
        elbow = to_matrices(rotations[rows, joint])  # in the axes of the root's parent
        while (joint := PARENTS[joint]) >= 0:
            elbow = to_matrices(rotations[rows, joint]) @ elbow
        own = elbow.swapaxes(1, 2) @ to_matrices(np.stack([hands[k].wrist for k in order]))
        seen, joints = np.concatenate([to_rotvecs(own)[:, None], seen], 1), [wrist, *joints]
    known = np.array(order, float)
    merged, _ = interpolate(known, seen, np.zeros((len(known), 3)), frames.astype(float))
    apart = np.abs(frames[:, None] - known).min(1)
    weight = np.clip((2 * NEAR - apart) / NEAR, 0, 1)[:, None, None]
    base = rotations[:, joints]
    turn = to_rotvecs(to_matrices(base).swapaxes(-1, -2) @ to_matrices(merged))
    blended = to_rotvecs(to_matrices(base) @ to_matrices(weight * turn))
    rotations[:, joints] = np.where(weight == 1, merged, blended)
