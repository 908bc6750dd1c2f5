"""``Track``: one person in a source, frame by frame, as a camera sees them.

A network that sees a crop assumes a long lens with its axis in the crop. So focal length, axis and
distance change with the detector's box, by metres for a person who stands still. Positions are
therefore compared, joined and interpolated as one usual lens would see them
(:mod:`gva_mi.subject.lens`, eq. 2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from gva_mi.body.pose import LEFT_HAND
from gva_mi.body.rotations import composed, nearest_rotations, shortest, to_rotvecs
from gva_mi.body.so3 import compose
from gva_mi.core.console import listed
from gva_mi.core.errors import InputError
from gva_mi.readers.body_arrays import NOT_BODY_NAMES, find_body, listed_names
from gva_mi.readers.target_body import MEAN_PELVIS, TargetBody
from gva_mi.subject.footage import Pictures
from gva_mi.subject.lens import (
    RECORDED,
    asked_for,
    centred,
    is_one_lens,
    recorded,
    seen_alike,
    usual_lens,
)

# Chosen: a smaller difference changes no step's result visibly, and a note would be noise.
LENS_NOTE_DIFFERENCE = 0.1  # of the logarithms of two focal lengths
BETAS_NOTE_DEVIATION = 0.1  # standard deviation of betas over frames


@dataclass(frozen=True)
class Track:
    """An estimator's result for one person; frames ascend and may have gaps.

    A body turns about its pelvis, so the pelvis's place and the root's rotation say where it is
    before any camera and on any body.
    """

    person: str  # the estimator's name of them
    frames: np.ndarray  # (n,) int
    rotations: np.ndarray  # (n, 55, 3) axis-angle; the root's is relative to the camera's axes
    places: np.ndarray  # (n, 3) the pelvis, metres, as the camera sees it: x right, y down, z deep
    betas: np.ndarray | None  # (n, B)
    K: np.ndarray  # (n, 3, 3) pixels
    form: str  # "SMPL", "SMPL+H" or "SMPL-X"
    has_hands: bool
    from_mean_hand: bool = False  # fingers are relative to the model's mean hand, not to the flat
    expression: np.ndarray | None = None  # (n, E)
    of_mean: bool = False  # places were made with the mean person's pelvis; betas move it
    notes: tuple[str, ...] = ()  # what was left out of the source

    def where(self, rows: np.ndarray) -> Track:
        """Select rows of the track by a mask (n,) or by row numbers."""
        names = ("frames", "rotations", "places", "betas", "K", "expression")
        arrays = {name: x[rows] for name in names if (x := getattr(self, name)) is not None}
        return replace(self, **arrays)

    def turned(self, turn: np.ndarray, places: np.ndarray) -> Track:
        """Turn the track's root by ``turn`` (n, 3), and put its pelvis at ``places`` (n, 3)."""
        rotations = self.rotations.copy()
        rotations[:, 0] = composed(turn, rotations[:, 0])
        return replace(self, rotations=rotations, places=places)

    def with_flat_hands(self, mean_hands: np.ndarray) -> Track:
        """Return the track with fingers relative to flat hands.

        ``mean_hands`` (30, 3) of the body are added where they are relative to those.
        """
        if not self.from_mean_hand:
            return self
        rotations = self.rotations.copy()
        rotations[:, LEFT_HAND.start :] += mean_hands
        return replace(self, rotations=rotations, from_mean_hand=False)

    def seen_from(self, R: np.ndarray, T: np.ndarray) -> Track:
        """Transform a track from world to camera axes, x_cam = R x + T.

        R is (3, 3), or (n, 3, 3) of a moving camera, made a rotation where digits were lost; T is
        (3,) or (n, 3) metres.
        """
        R = np.broadcast_to(nearest_rotations(R), (len(self.frames), 3, 3))
        places = np.einsum("nij,nj->ni", R, self.places) + np.reshape(T, (-1, 3))
        return self.turned(to_rotvecs(R), places)


def make_track(
    where: str,
    person: str,
    frames: np.ndarray | None,
    found: Mapping[str, Any],
    K: np.ndarray,
    body: TargetBody | None = None,
    gives_pelvis: bool = False,
) -> Track:
    """Make a track from arrays of all its frames, under any names of :mod:`.body_arrays`.

    Args:
        where: file and person, for errors.
        person: the estimator's name of them.
        frames: (n,) frame numbers; None: 0 to n − 1.
        found: the arrays.
        K: (3, 3) or (n, 3, 3) pixels.
        body: the body that poses are converted to, if known: if it is the source's body, its own
            pelvis is used.
        gives_pelvis: the translation is the pelvis's position, not the offset of the body's origin.
    """
    of = find_body(where, found)
    count = len(of.rotations)
    frames = np.arange(count) if frames is None else frames
    K = np.broadcast_to(K, (count, 3, 3)) if K.shape in ((3, 3), (1, 3, 3)) else K
    if len(frames) != count or K.shape != (count, 3, 3):
        raise InputError(f"{where}: {count} poses and K {K.shape} for {len(frames)} frames")
    betas, notes = of.betas, []
    if betas is not None:
        if betas.shape != (count, betas.shape[-1]):
            betas = median_betas(np.atleast_2d(betas))[0]
        betas = np.broadcast_to(betas, (count, betas.shape[-1]))
    places = of.transl
    if places is None:
        places = np.zeros((count, 3))
        notes.append("the source has no translation: the person stays in place")
    of_mean = False
    if not gives_pelvis:
        of_mean = betas is not None and betas.any() and not (body and body.keeps_betas(of.form))
        pelvis = np.array(MEAN_PELVIS[of.form]) if body is None else body.pelvises(of.form, betas)
        if of.about_origin is not None:
            pelvis = np.einsum("nij,nj->ni", of.about_origin, np.broadcast_to(pelvis, (count, 3)))
        places = places + pelvis
    if unused := sorted(set(of.unused) - NOT_BODY_NAMES):
        notes.append(f"arrays of the source that are not used: {listed_names(unused)}")
    return Track(
        person, frames, of.rotations, places, betas, K, of.form, of.has_hands,
        expression=of.expression, of_mean=of_mean, notes=tuple(notes),
    )  # fmt: skip


def every_frame(where: str, track: Track, count: int) -> tuple[Track, np.ndarray, list[str]]:
    """Interpolate a track so that it has each of a video's ``count`` frames.

    The pose is constant before the first known frame and after the last. Returns the track, whether
    each frame lies between these two (count,), and notes.
    """
    outside = track.frames[(track.frames < 0) | (track.frames >= count)]
    if len(outside):
        raise InputError(
            f"{where}: has frame {outside[0]}, but the video has frames 0 to {count - 1}; "
            "expected poses of this video"
        )
    good = np.isfinite(track.rotations).all((1, 2)) & np.isfinite(track.places).all(1)
    good &= np.isfinite(track.K).all((1, 2))
    if not good.any():
        raise InputError(f"{where}: person {track.person}: no frame holds finite numbers")
    focal = track.K[good][:, [0, 1], [0, 1]]
    if not (focal > 0).all():
        raise InputError(f"{where}: focal lengths must be above 0 pixels, got {focal.min():g}")
    known, wanted = track.frames[good], np.arange(count)
    # Interpolate as seen by one lens: a lens twice as long sees the person twice as far away.
    lens, expression = usual_lens(track.K[good]), track.expression
    rows = [seen_alike(track.places[good], track.K[good], lens)]
    rows += [] if expression is None else [expression[good]]
    rotations, moved = interpolate(
        known.astype(float), track.rotations[good], np.hstack(rows), wanted.astype(float)
    )
    entries = track.K[good].reshape(-1, 9).T
    K = np.stack([np.interp(wanted, known, x) for x in entries], axis=1).reshape(-1, 3, 3)
    places = seen_alike(moved[:, :3], lens, K)
    inside = (wanted >= known[0]) & (wanted <= known[-1])
    notes = []
    if len(gap := wanted[inside & ~np.isin(wanted, known)]):
        notes.append(f"frames without a pose, interpolated: {listed(gap)}")
    if len(gap := wanted[~inside]):
        notes.append(f"frames before or after the person is seen, left out: {listed(gap)}")
    filled = {"frames": wanted, "rotations": rotations, "places": places, "K": K}
    filled["expression"] = None if expression is None else moved[:, 3:]
    return replace(track, **filled), inside, notes


def interpolate(
    times: np.ndarray, rotations: np.ndarray, others: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sample rotations (n, J, 3) and other numbers (n, D) at times ``wanted`` (m,).

    A joint turns evenly, on the shorter way round; other numbers are interpolated linearly.
    ``times`` (n,) ascend; the motion is held before the first and after the last. Returned
    rotations are at most half a turn long.
    """
    after = np.clip(np.searchsorted(times, wanted, side="right"), 1, max(1, len(times) - 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    span = np.maximum(times[after] - times[before], 1e-12)
    s = np.clip((wanted - times[before]) / span, 0, 1)
    first, second = torch.from_numpy(rotations[before]), torch.from_numpy(rotations[after])
    turned = compose(first, torch.from_numpy(s)[:, None, None] * compose(-first, second))
    moved = others[before] + s[:, None] * (others[after] - others[before])
    return turned.numpy(), moved


def median_betas(betas: np.ndarray | None) -> tuple[np.ndarray, list[str]]:
    """Return one person's median betas (B,) over frames (T, B), and a note if these differ.

    The median is taken: a few frames that an estimator got wrong do not move it.
    """
    if betas is None:
        return np.zeros(10), []
    betas = betas[np.isfinite(betas).all(1)]
    if not len(betas):
        return np.zeros(10), ["no betas are finite; they are zero"]
    spread = float(betas.std(0).max())
    note = f"betas differ by up to {spread:.2g} from frame to frame; their median is taken"
    return np.median(betas, axis=0), [note] if spread > BETAS_NOTE_DEVIATION else []


def filmed_with(
    track: Track, given: str | None, frames: Pictures, size: tuple[int, int]
) -> tuple[Track, list[str]]:
    """Return a track adapted to the lens of the video, and notes.

    Args:
        track: by an estimator.
        given: the user's focal length, as :func:`asked_for` reads it; None keeps the estimator's.
        frames: the video file or the pictures.
        size: (W, H) of the pictures.
    """
    known = recorded(frames, size)
    each = np.sqrt(track.K[:, 0, 0] * track.K[:, 1, 1])
    assumed = float(np.median(each))
    if given is None and not is_one_lens(track.K):
        return track, [
            f"the estimator assumed another lens in each frame, {each.min():.0f} to "
            f"{each.max():.0f} pixels, so that positions jump; --lens gives all frames one"
        ]
    if given is None and (known is None or abs(np.log(known / assumed)) < LENS_NOTE_DIFFERENCE):
        return track, []
    if given is None:
        return track, [
            f"the poses are for a focal length of {assumed:.0f} pixels; the video file records "
            f"{known:.0f}, up to a fifth too little if stabilised: --lens {RECORDED} takes it"
        ]
    focal = asked_for(given, known, size)
    if is_one_lens(track.K) and focal == assumed:
        return track, []
    moved = f"people stand {focal / assumed:.3g} times as far away"
    K = centred(focal, size)
    if is_one_lens(track.K):  # else the axes are those of crops
        K[:2, 2] = track.K[0, :2, 2]
    return through_lens(track, K), [
        f"the focal length is {focal:.0f} pixels, the estimator assumed {assumed:.0f}: {moved}"
    ]


def through_lens(track: Track, K: np.ndarray) -> Track:
    """Adapt a track to the lens K (3, 3) if the estimator assumed another one, or one a frame.

    The person keeps place and size in the picture (:mod:`.track`), and turns with the ray on
    which the pelvis is seen, so that the camera sees the same side (as CLIFF, Li et al. 2022,
    separates the turn of a crop from that of the person).
    """
    places = seen_alike(track.places, track.K, K)
    turned = track.turned(shortest(track.places, places), places)
    return replace(turned, K=np.broadcast_to(K, track.K.shape))
