"""``Track``: a pose estimator's result for one person, frame by frame, in camera axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gva_mi.body.rotations import composed, nearest_rotations, to_rotvecs
from gva_mi.core.console import listed
from gva_mi.core.errors import InputError
from gva_mi.data.importers.fields import find_betas, find_joints, find_translation
from gva_mi.data.importers.timeline import interpolate

# The pelvis of the neutral mean person at rest, metres, as the public models regress it.
PELVIS = {
    "SMPL": (-0.0018, -0.2233, 0.0282), "SMPL+H": (-0.0018, -0.2233, 0.0282),
    "SMPL-X": (0.0031, -0.3514, 0.0120),
}  # fmt: skip
BETAS_VARY = 0.1  # standard deviation of betas over frames from which a note is given


@dataclass(frozen=True)
class Track:
    """An estimator's result for one person; frames ascend and may have gaps."""

    person: str  # the estimator's name of them
    frames: np.ndarray  # (n,) int
    rotations: np.ndarray  # (n, 55, 3) axis-angle; the root's is relative to the camera's axes
    transl: np.ndarray  # (n, 3) metres, in the camera's axes: x right, y down, z forward
    betas: np.ndarray | None  # (n, B)
    K: np.ndarray  # (n, 3, 3) pixels
    form: str  # "SMPL", "SMPL+H" or "SMPL-X"
    has_hands: bool
    from_mean_hand: bool = False  # fingers are relative to the model's mean hand, not to the flat

    @property
    def pelvis(self) -> np.ndarray:
        """Pelvis (3,) of the source's body at rest, metres."""
        return np.array(PELVIS[self.form])

    def sorted(self) -> Track:
        """Return the track with ascending frames, each once."""
        return self.where(np.unique(self.frames, return_index=True)[1])

    def where(self, rows: np.ndarray) -> Track:
        """Select rows of the track by a mask (n,) or by row numbers."""
        betas = None if self.betas is None else self.betas[rows]
        arrays = {
            name: getattr(self, name)[rows] for name in ("frames", "rotations", "transl", "K")
        }
        return replace(self, betas=betas, **arrays)

    def turned(self, turn: np.ndarray, places: np.ndarray) -> Track:
        """Turn the track's root by ``turn`` (n, 3), and put its pelvis at ``places`` (n, 3)."""
        rotations = self.rotations.copy()
        rotations[:, 0] = composed(turn, rotations[:, 0])
        return replace(self, rotations=rotations, transl=places - self.pelvis)

    def seen_from(self, R: np.ndarray, T: np.ndarray) -> Track:
        """Transform a track from world to camera axes, x_cam = R x + T, about its pelvis.

        R is (3, 3), or (n, 3, 3) of a moving camera, made a rotation where digits were lost; T is
        (3,) or (n, 3) metres.
        """
        R = np.broadcast_to(nearest_rotations(R), (len(self.frames), 3, 3))
        places = np.einsum("nij,nj->ni", R, self.transl + self.pelvis) + np.reshape(T, (-1, 3))
        return self.turned(to_rotvecs(R), places)


def make_track(
    where: str,
    person: str,
    frames: np.ndarray | None,
    found: Mapping[str, Any],
    K: np.ndarray,
    components: np.ndarray | None = None,
    of_pelvis: bool = False,
) -> Track:
    """Make a track of arrays that hold all its frames, by the names of :mod:`fields`.

    Args:
        where: file and person, for errors.
        person: the estimator's name of them.
        frames: (n,) frame numbers; None: 0 to n − 1.
        found: the arrays.
        K: (3, 3) or (n, 3, 3) pixels.
        components: (2, K, 45) PCA of hands of the body's file.
        of_pelvis: the translation is where the pelvis is, not the offset of the body's origin.
    """
    joints = find_joints(where, found, components)
    frames = np.arange(len(joints.rotations)) if frames is None else frames
    count = len(frames)
    K = np.broadcast_to(K, (count, 3, 3)) if K.shape in ((3, 3), (1, 3, 3)) else K
    if len(joints.rotations) != count or K.shape != (count, 3, 3):
        raise InputError(
            f"{where}: {len(joints.rotations)} poses and K {K.shape} for {count} frames"
        )
    betas = find_betas(where, found)
    betas = None if betas is None else np.broadcast_to(betas, (count, betas.shape[-1]))
    transl = find_translation(where, found, count)
    track = Track(
        person, frames, joints.rotations, transl, betas, K, joints.form, joints.has_hands,
        joints.from_mean_hand,
    )  # fmt: skip
    return replace(track, transl=transl - track.pelvis) if of_pelvis else track


def every_frame(where: str, track: Track, count: int) -> tuple[Track, np.ndarray, list[str]]:
    """Fill a track so that it has each of a video's ``count`` frames.

    It is held before the first known frame and after the last. Returns the track, whether a frame
    lies between these (count,), and notes.
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
    # An estimator with a lens for each frame puts the person as many times farther away as the
    # lens is longer, so K is interpolated as translations are.
    entries = track.K[good].reshape(-1, 9).T
    K = np.stack([np.interp(wanted, known, x) for x in entries], axis=1).reshape(-1, 3, 3)
    inside = (wanted >= known[0]) & (wanted <= known[-1])
    notes = []
    if len(gap := wanted[inside & ~np.isin(wanted, known)]):
        notes.append(f"frames without a pose, interpolated: {listed(gap)}")
    if len(gap := wanted[~inside]):
        notes.append(f"frames before or after the person is seen, left out: {listed(gap)}")
    return replace(track, frames=wanted, rotations=rotations, transl=transl, K=K), inside, notes


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
    return np.median(betas, axis=0), [note] if spread > BETAS_VARY else []
