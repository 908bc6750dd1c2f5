"""``Track``: one person in a source, frame by frame, before a camera; and the body it is for.

A network that sees a crop assumes a long lens with its axis in the crop: focal length, axis and
distance breathe with the detector's box, by metres while a person stands still. So places are
compared, joined and interpolated before one usual lens. With f the geometric mean of a lens's focal
lengths and u the pixel where a place x is seen,

1. ``z' = z f' / f``
2. ``x' = (u − c') z' / f'``, y alike

is the place at the same pixel, with as many pixels a metre, before the lens f', c'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gva_mi.body.body_file import BUILT_IN_BODY, SMPL, SMPLH, SMPLX, read_body
from gva_mi.body.pose import LEFT_HAND, Shape
from gva_mi.body.rotations import composed, nearest_rotations, to_rotvecs
from gva_mi.body.smplx import BodyModel, body_name, resolve_body
from gva_mi.body.so3 import compose
from gva_mi.core.console import listed
from gva_mi.core.errors import InputError
from gva_mi.data.fingerprint import belongs_to
from gva_mi.data.importers.body_arrays import OTHERS, find_body

ONE_LENS = 1e-3  # by which entries of K may differ, as a share of the focal length
BETAS_VARY = 0.1  # standard deviation of betas over frames from which a note is given
# The pelvis of the neutral mean person at rest, metres, as the public models regress it.
PELVIS = {
    "SMPL": (-0.0018, -0.2233, 0.0282), "SMPL+H": (-0.0018, -0.2233, 0.0282),
    "SMPL-X": (0.0031, -0.3514, 0.0120),
}  # fmt: skip
_NEAR = 0.05  # metres of it are those of the male and of the female mean


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
    of_mean: bool = False  # places follow from the mean person's pelvis, which betas move
    notes: tuple[str, ...] = ()  # what of the source is not here

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
    of_pelvis: bool = False,
) -> Track:
    """Make a track of arrays that hold all its frames, by the names of :mod:`.body_arrays`.

    Args:
        where: file and person, for errors.
        person: the estimator's name of them.
        frames: (n,) frame numbers; None: 0 to n − 1.
        found: the arrays.
        K: (3, 3) or (n, 3, 3) pixels.
        body: the body that poses are converted to, if it is known: its pelvis counts where the
            source's body is the same.
        of_pelvis: the translation is where the pelvis is, not the offset of the body's origin.
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
    if not of_pelvis:
        of_mean = betas is not None and betas.any() and not (body and body.keeps_betas(of.form))
        pelvis = np.array(PELVIS[of.form]) if body is None else body.pelvises(of.form, betas)
        if of.about_origin is not None:
            pelvis = np.einsum("nij,nj->ni", of.about_origin, np.broadcast_to(pelvis, (count, 3)))
        places = places + pelvis
    if unused := sorted(set(of.unused) - OTHERS):
        notes.append(f"not used of the source: {listed_names(unused)}")
    return Track(
        person, frames, of.rotations, places, betas, K, of.form, of.has_hands,
        expression=of.expression, of_mean=of_mean, notes=tuple(notes),
    )  # fmt: skip


def listed_names(names: Sequence[str]) -> str:
    """Return the first of some names, and how many more there are."""
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(names[:12]) + more


def every_frame(where: str, track: Track, count: int) -> tuple[Track, np.ndarray, list[str]]:
    """Fill a track so that it has each of a video's ``count`` frames.

    It is held before the first known frame and after the last. Returns the track, whether a frame
    lies between these (count,), and notes.
    """
    outside = track.frames[(track.frames < 0) | (track.frames >= count)]
    if len(outside):
        raise InputError(
            f"{where}: has frame {outside[0]}, but the video has frames 0 to {count - 1}; "
            "expected poses of this very video"
        )
    good = np.isfinite(track.rotations).all((1, 2)) & np.isfinite(track.places).all(1)
    good &= np.isfinite(track.K).all((1, 2))
    if not good.any():
        raise InputError(f"{where}: person {track.person}: no frame holds finite numbers")
    focal = track.K[good][:, [0, 1], [0, 1]]
    if not (focal > 0).all():
        raise InputError(f"{where}: focal lengths must be above 0 pixels, got {focal.min():g}")
    known, wanted = track.frames[good], np.arange(count)
    # Before one lens, because the person is as many times farther away as a lens is longer.
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
    return np.median(betas, axis=0), [note] if spread > BETAS_VARY else []


@dataclass(frozen=True)
class TargetBody:
    """The body that poses are for."""

    name: str
    model: BodyModel
    form: str  # "SMPL", "SMPL+H" or "SMPL-X"; "own" for another body in such a file
    joints: np.ndarray  # (55, 3) at rest, of the mean shape, metres
    mean_hands: np.ndarray  # (30, 3) left before right, relative to flat ones
    of_source: bool = False  # the source's poses were made on this very body

    @staticmethod
    def read(path: Path | None) -> TargetBody:
        """Read a body's file; the built-in body for the word ``puppet``, or for None."""
        path = path or BUILT_IN_BODY
        arrays = read_body(resolve_body(path))
        hands = [arrays.get(f"hands_mean{side}", np.zeros(45)) for side in "lr"]
        model = BodyModel(arrays)
        joints = model.rest(Shape(torch.zeros(0))).joints.double().numpy()
        # The model is known by the joints that move it and by its pelvis: other bodies come in
        # SMPL-X's format, too, and have betas of their own.
        moved = set(np.flatnonzero(arrays["weights"].any(0)).tolist())
        form = next((f for f in (SMPL, SMPLH) if moved <= set(f.joints)), SMPLX).name
        form = form if np.linalg.norm(joints[0] - PELVIS[form]) < _NEAR else "own"
        hands = np.stack(hands).reshape(30, 3)
        return TargetBody(body_name(path), model, form, joints, hands)

    def for_source(self, source: Path) -> TargetBody:
        """Return this body, marked if the subject's folder that poses lie in was made on it."""
        folder = source if source.is_dir() else source.parent
        return replace(self, of_source=belongs_to(folder, self.model))

    def keeps_betas(self, form: str) -> bool:
        """Whether betas and expressions of a source with this body model are this body's."""
        return self.of_source or form == self.form

    def pelvises(self, form: str, betas: np.ndarray | None) -> np.ndarray:
        """Return the pelvis at rest, (3,) or (n, 3) metres, of a source's body with ``betas``.

        They are (B,) or (n, B). Without that body at hand it is the mean person's, which betas
        move by centimetres.
        """
        if not self.keeps_betas(form):
            return np.array(PELVIS[form])
        betas = np.zeros(0) if betas is None else betas
        moves = self.model.shape_joints[:, :3].double().numpy()
        count = min(len(moves), betas.shape[-1])
        return self.joints[0] + betas[..., :count] @ moves[:count]

    def expression(self, form: str, given: np.ndarray) -> tuple[np.ndarray, list[str]]:
        """Return what of a source's expressions (T, E) is this body's, ten at most, and notes."""
        if not self.keeps_betas(form):
            if not given.any():
                return np.zeros((len(given), 10)), []
            note = f"the face's expression is left out: coefficients of {form} are not the body's"
            return np.zeros((len(given), 10)), [f"{note} {self.name}"]
        count = min(10, self.model.num_expressions, given.shape[1])
        note = [f"the first {count} of {given.shape[1]} coefficients of the expression are kept"]
        return given[:, :count], note if given[:, count:].any() else []


def usual_lens(K: np.ndarray) -> np.ndarray:
    """Return K (3, 3) of a lens that is likely for pictures that lenses (n, 3, 3) belong to.

    Its axis is where theirs is on the median. A picture of twice that is seen under 53 degrees
    along its diagonal, as by a camera of 43 mm.
    """
    cx, cy = np.median(K[:, :2, 2], axis=0)
    focal = 2 * max(np.hypot(cx, cy), 1.0)
    return np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])


def is_one_lens(K: np.ndarray) -> bool:
    """Whether lenses (n, 3, 3) are the same in all frames."""
    return bool(np.ptp(K, axis=0).max() <= ONE_LENS * K[0, 0, 0])


def seen_alike(places: np.ndarray, K: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return where (n, 3) metres through the lens ``other`` shows the picture of ``K`` (eq. 1, 2).

    ``places`` are (n, 3); both lenses (3, 3) or (n, 3, 3).
    """
    K, other = (np.broadcast_to(x, (len(places), 3, 3)) for x in (K, other))
    f, axes, middle = _parts(K)
    f_other, axes_other, middle_other = _parts(other)
    z = places[:, 2:] * (f_other / f)
    with np.errstate(divide="ignore", invalid="ignore"):  # a place in the plane of the lens
        pixels = places[:, :2] * axes / places[:, 2:] + middle - middle_other
    return np.concatenate([pixels * z / axes_other, z], axis=1)


def _parts(K: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return f (n, 1), both focal lengths (n, 2) and the axis (n, 2) of lenses (n, 3, 3)."""
    axes = K[:, [0, 1], [0, 1]]
    return np.sqrt(axes.prod(1, keepdims=True)), axes, K[:, :2, 2]
