"""``Track``: one person as a pose estimator saw them, frame by frame, before any camera's axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.console import listed
from gva_mi.data.importers.timeline import interpolate
from gva_mi.errors import InputError

SPREAD = 0.1  # standard deviations of betas from frame to frame that are worth a word


@dataclass(frozen=True)
class Track:
    """What an estimator says of one person; frames ascend, and may have gaps."""

    person: str  # the estimator's name of them
    frames: np.ndarray  # (n,) int
    rotations: np.ndarray  # (n, 55, 3) axis-angle, the root's to the axes of the camera
    transl: np.ndarray  # (n, 3) metres, in the axes of the camera: x right, y down, z forward
    betas: np.ndarray | None  # (n, B)
    K: np.ndarray  # (n, 3, 3) pixels
    form: str  # "SMPL", "SMPL+H" or "SMPL-X"
    has_hands: bool
    from_mean_hand: bool = False  # fingers are relative to the model's mean hand, not to the flat

    def sorted(self) -> Track:
        """The same with ascending frames, each once."""
        return self.where(np.unique(self.frames, return_index=True)[1])

    def where(self, rows: np.ndarray) -> Track:
        """Some of its rows: a mask (n,), or their numbers."""
        betas = None if self.betas is None else self.betas[rows]
        arrays = {
            name: getattr(self, name)[rows] for name in ("frames", "rotations", "transl", "K")
        }
        return replace(self, betas=betas, **arrays)


@dataclass(frozen=True)
class Votes:
    """What the joints of a track say about its being the person in the masks.

    A person's joints lie in the person, so in the right masks nearly all joints are inside. Each
    joint in each frame votes: for, where it is inside, against, where it is not. A passer-by who is
    seen for long collects votes against, and so does not win over the person by length.
    """

    inside: int  # joints in a mask, of all frames
    outside: int

    @property
    def majority(self) -> int:
        """Votes for, less those against."""
        return self.inside - self.outside

    @property
    def share(self) -> float:
        """Of the votes that are for; 0 where there are none."""
        return self.inside / max(1, self.inside + self.outside)


def choose(
    where: str,
    tracks: Sequence[Track],
    person: str | None,
    votes: Callable[[], Sequence[Votes]] | None,
) -> tuple[Track, list[str]]:
    """The person of a name, or the one who is in the masks; and what to say about it.

    Args:
        where: the source, for errors.
        tracks: a person each.
        person: the estimator's name of one of them.
        votes: of the joints of each of them, for being the person in the masks; asked where that
            decides. Where no vote is for anybody, or without masks, it is the one who is seen in
            most frames.

    Raises:
        InputError: nobody is there, or nobody of that name.
    """
    if not tracks:
        raise InputError(f"{where}: holds nobody; expected one person at least")
    names = ", ".join(f"{t.person} ({len(t.frames)} frames)" for t in tracks[:20])
    if person is not None:
        chosen = next((t for t in tracks if t.person == person), None)
        if chosen is None:
            raise InputError(f"{where}: has no person '{person}'; it has {names}")
        return chosen, []
    if len(tracks) == 1:
        return tracks[0], []
    if votes is None:
        chosen = max(tracks, key=lambda t: len(t.frames))
        return chosen, [f"person {chosen.person}, seen longest of {names}; --person takes another"]
    found = list(votes())
    best = max(range(len(tracks)), key=lambda i: found[i].majority)
    if found[best].majority > 0:
        shares = ", ".join(
            f"{t.person} ({len(t.frames)} frames, {100 * v.share:.0f} % of the joints)"
            for t, v in zip(tracks[:20], found, strict=False)
        )
        chosen = tracks[best]
        note = f"person {chosen.person}, who is in the masks best of {shares}"
    else:
        chosen = max(tracks, key=lambda t: len(t.frames))
        note = f"person {chosen.person}, seen longest of {names}, for nobody is in the masks"
    return chosen, [f"{note}; --person takes another"]


def every_frame(where: str, track: Track, count: int) -> tuple[Track, np.ndarray, list[str]]:
    """A track at each of a video's frames, and which of them it was seen in or between.

    Returns:
        The track at frames 0 to ``count`` − 1, held before the first and after the last; (count,)
        whether a frame lies between these; and what to say about it.

    Raises:
        InputError: frames beyond the video's, or numbers that are not finite in all of them.
    """
    outside = track.frames[(track.frames < 0) | (track.frames >= count)]
    if len(outside):
        raise InputError(
            f"{where}: has frame {outside[0]}, but the video has frames 0 to {count - 1}; --first "
            "says which number the estimator gave the first one"
        )
    good = np.isfinite(track.rotations).all((1, 2)) & np.isfinite(track.transl).all(1)
    good &= np.isfinite(track.K).all((1, 2))
    if not good.any():
        raise InputError(f"{where}: person {track.person}: no frame holds finite numbers")
    focal = track.K[good][:, [0, 1], [0, 1]]
    if not (focal > 0).all():
        raise InputError(f"{where}: focal lengths must be above 0 pixels, got {focal.min():g}")
    known, wanted = track.frames[good], np.arange(count)
    rotations, transl = interpolate(
        known.astype(float), track.rotations[good], track.transl[good], wanted.astype(float)
    )
    # An estimator that gives each frame a lens of its own puts the person farther away by as much
    # as the lens is longer: so both are interpolated alike.
    entries = track.K[good].reshape(-1, 9).T
    K = np.stack([np.interp(wanted, known, x) for x in entries], axis=1).reshape(-1, 3, 3)
    inside = (wanted >= known[0]) & (wanted <= known[-1])
    notes = []
    if len(gap := wanted[inside & ~np.isin(wanted, known)]):
        notes.append(f"frames without a pose, interpolated: {listed(gap)}")
    if len(gap := wanted[~inside]):
        notes.append(f"frames before or after the person is seen, left out: {listed(gap)}")
    return replace(track, frames=wanted, rotations=rotations, transl=transl, K=K), inside, notes


def one_shape(track: Track) -> tuple[np.ndarray, list[str]]:
    """The median of a person's betas (B,), and a word where they differ from frame to frame."""
    return (np.zeros(10), []) if track.betas is None else median_betas(track.betas)


def median_betas(betas: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """One person's betas (B,) of those of all frames (T, B), and a word where these differ.

    The median: a few frames that an estimator got wrong do not move it.
    """
    betas = betas[np.isfinite(betas).all(1)]
    if not len(betas):
        return np.zeros(10), ["no betas are finite; they are zero"]
    spread = float(betas.std(0).max())
    note = f"betas differ by up to {spread:.2g} from frame to frame; their median is taken"
    return np.median(betas, axis=0), [note] if spread > SPREAD else []
