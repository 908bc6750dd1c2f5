"""How far off a network's landmarks are: standard deviations in pixels, and of depths in metres.

**Pixels.** In the picture, the error of a landmark is a share of the person's size, because
networks see people scaled to one size. The spread between passes of the network adds to it, and a
low confidence widens it:

1. ``σ² = ((share · S)² + misfit² + spread²) / confidence² + hand_offset²``
   with ``S`` the pixels of 1.7 m at the person's distance

``hand_offset`` is for the points of a hand, and zero for others. The tracker of hands may stay
where the hand was, or jump to another hand, with high confidence. Two networks see the wrist: the
one of the hand and the one of the body. If they disagree, the body's is right: on rendered people a
hand errs by as much as its wrist is away from the body's, and the body's wrist errs no more than
usual. So ``hand_offset`` is this distance, minus what the body's wrist may be off. It widens the
errors of pixels and of depths.

A face that is turned away is a guess, although the network says that it is sure: on rendered people
its points err twice as much in profile as from the front, and from behind they err together. So
their ``share`` grows by :func:`face_factors`.

In some frames the network misplaces the whole person: it takes a bare shoulder for the face. Then
the person seems to be smaller or larger than in the frames around. ``misfit`` is how far ``S`` is
from its running median, beyond what is usual in the video. Depths err as much.

A knee may be taken for a point higher or lower on the leg, but hardly for a point beside the leg.
On rendered people elbows, wrists, knees and ankles err along their limb 1.4 to 2 times as much as
across it; shoulders and hips err equally in all directions. So with the direction ``u`` of the limb
in the picture, the points at its ends have the covariance

2. ``Σ = σ² (1 + (ALONG_LIMB² - 1) u uᵀ)``

**Depths** are guesses. A network that is trained to be right on average gives the mean of the
depths that a picture leaves possible. So its answers vary less than the true depths do. Along a
bone from ``i`` to ``j``, with the scale ``s`` of :meth:`gva_mi.observe.rig.LandmarkRig.scale`,

3. ``s (m_j - m_i) = gain (z_j - z_i) + bias + e``,   ``e`` with standard deviation ``σ_z``

The gain of legs and trunk is 1. Legs are mostly straight. If their answers were divided by the
smaller slope of answers against true depths, knees would bend. Arms point anywhere, and their gain
is that slope.

**Repeated errors.** Errors last, and the same picture of a person gets the same errors. So ``m``
frames that look the same count as one: at least the frames of a tenth of a second. A person who
stands still, or repeats one movement, shows less in a minute than a person who turns around once.
With the mean square distance ``d²`` between the landmarks of two frames, metres, after both are
centred,

4. ``m_t = Σ_k exp(-d_tk² / 2 ℓ²)``,   ``ℓ² = 2 (share · 1.7 m)²``

The body's landmarks decide this for the body, and the landmarks of a hand for its fingers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from gva_mi.core.errors import InputError
from gva_mi.subject.landmarks import BODY_LANDMARKS, Landmarks

REFERENCE_HEIGHT = 1.7  # metres of a person, whose pixels are S; chosen: an average person
# Error of a landmark of the body, and of a hand, as a share of S; chosen by eye.
BODY_SHARE, HAND_SHARE = 0.012, 0.004
# Factor on the share of a point of the face that is seen from behind; it grows from 1 on from this
# cosine of the angle between face and camera. Chosen by the heads of six rendered videos.
HIDDEN_FACE, SEEN_FACE = 4.0, 0.5
SMALLEST_CONFIDENCE = 0.05  # landmarks of less are not used; chosen by eye
HAND_CONFIDENCE = 0.5  # hands of less are not used; chosen: more likely a hand than not
SIZE_MEDIAN_FRAMES = 30  # on each side of a frame; chosen: one second of 30 frames a second
# Usual deviations of S from its running median: in median deviations (four are 2.7 sigma of a
# normal distribution), and at least a share of S. Chosen: a person who leans forward changes S.
USUAL_DEVIATIONS, USUAL_CHANGE = 4.0, 0.03
# Misfit of a frame that is not used, as a share of S. Chosen on one rendered person with dark hair
# in a dark room: in frames with more, the network saw no head.
MISPLACED = 0.08
# Least correlation time of the network's errors, seconds; chosen: three frames of 30 a second.
LANDMARK_CORRELATION_SECONDS = 0.1
# All points of the face, or of a hand, count as so many independent points. Chosen
# between 1, since they err together, and their number.
POINTS_OF_GROUP = 3.0
# Standard deviation along a limb, relative to across it. Chosen by the poses of twelve rendered
# videos, for shoulders and hips as well: bones of the fitted body may be too long or too short.
ALONG_LIMB = 2.0


class BoneDepth(NamedTuple):
    """How a network answers for the depth along a bone (eq. 3)."""

    gain: float
    bias: float  # metres
    sigma: float  # σ_z, metres


# Bones by their ends, on both sides unless the names say one. ``gain`` and ``bias`` are rounded
# from answers of BlazePose and of the hand network on rendered people who turn and walk. There the
# errors of depth vary by 10 to 65 mm in a video, but they last: after 0.2 s their correlation is
# 0.2 to 0.7, and a part is constant. So ``σ_z`` is several times as large: chosen by the poses of
# twelve rendered videos, for legs of seven.
BONES = {
    ("shoulder", "elbow"): BoneDepth(0.6, 0.0, 0.24),
    ("elbow", "wrist"): BoneDepth(0.45, -0.03, 0.42),
    ("hip", "knee"): BoneDepth(1.0, 0.02, 0.12),
    ("knee", "ankle"): BoneDepth(1.0, 0.03, 0.11),
    ("ankle", "foot_index"): BoneDepth(0.25, -0.06, 0.18),
    ("shoulder", "hip"): BoneDepth(1.0, 0.0, 0.18),
    ("left_shoulder", "right_shoulder"): BoneDepth(1.0, 0.0, 0.24),
    ("left_hip", "right_hip"): BoneDepth(1.4, 0.0, 0.24),
    ("nose", "ear"): BoneDepth(1.0, 0.0, 0.18),
    ("left_ear", "right_ear"): BoneDepth(0.9, 0.0, 0.18),
    ("wrist", "index"): BoneDepth(0.4, -0.025, 0.12),
    ("wrist", "pinky"): BoneDepth(0.3, -0.01, 0.12),
    ("index", "pinky"): BoneDepth(0.35, 0.015, 0.072),
    ("hand_wrist", "hand_middle_mcp"): BoneDepth(0.4, -0.03, 0.06),
    ("hand_index_mcp", "hand_pinky_mcp"): BoneDepth(0.5, 0.0, 0.05),
}
OTHER_END = {  # of the limb of a point
    "shoulder": "elbow", "elbow": "shoulder", "wrist": "elbow",
    "hip": "knee", "knee": "hip", "ankle": "knee",
}  # fmt: skip
PHALANX = BoneDepth(0.3, 0.0, 0.015)  # every bone of a finger; source as of BONES
_FACE = BODY_LANDMARKS[: BODY_LANDMARKS.index("left_shoulder")]
_FINGER_POINTS = {
    "thumb": ("cmc", "mcp", "ip", "tip"),
    **{name: ("mcp", "pip", "dip", "tip") for name in ("index", "middle", "ring", "pinky")},
}


@dataclass(frozen=True)
class LandmarkNoise:
    """Errors of P landmarks in T frames, and of K bones' depths.

    Attributes:
        pixels: (T, P) ``σ``, pixels; infinite without a landmark.
        whitening: (T, P, 2, 2) ``σ Σ^-1/2``, symmetric: makes errors equally wide in all
            directions.
        bones: (K, 2) from and to, indices of the P landmarks.
        gain: (K,) of eq. 3.
        bias: (K,) of eq. 3, metres.
        depth: (T, K) ``σ_z``, metres; infinite without both landmarks.
    """

    pixels: Tensor
    whitening: Tensor
    bones: Tensor
    gain: Tensor
    bias: Tensor
    depth: Tensor

    @staticmethod
    def of(landmarks: Landmarks, names: Sequence[str]) -> LandmarkNoise:
        """Return the noise of landmarks, in the order of ``names``.

        Raises:
            InputError: no frame has a person.
        """
        at = landmarks.indices(names)
        confidence = np.nan_to_num(landmarks.confidence[:, at])
        of_hand = np.array(["_hand_" in name for name in names], bool)
        of_face = np.array([name in _FACE for name in names], bool)
        seen = np.isfinite(landmarks.pixels[:, at]).all(2)
        seen &= confidence >= np.where(of_hand, HAND_CONFIDENCE, SMALLEST_CONFIDENCE)
        sizes = person_sizes(landmarks)
        share = np.where(of_hand, HAND_SHARE, BODY_SHARE) * sizes[:, None]
        share = np.where(of_face, share * face_factors(landmarks)[:, None], share)
        misfit = size_misfits(sizes)[:, None]
        square = share**2 + misfit**2 + np.nan_to_num(landmarks.spread[:, at]) ** 2
        hand_offset = _hand_offsets(landmarks, names, sizes / REFERENCE_HEIGHT)
        square = square / np.clip(confidence, SMALLEST_CONFIDENCE, 1) ** 2
        pixels = np.sqrt(square + (hand_offset * sizes[:, None] / REFERENCE_HEIGHT) ** 2)
        pixels = np.where(seen, pixels, np.inf)
        known = list(_bones(names))
        bones = np.array([pair for pair, _ in known], int).reshape(-1, 2)
        has_depth = seen & np.isfinite(landmarks.metric[:, at]).all(2)
        both = has_depth[:, bones].all(2)
        sigma = np.hypot([bone.sigma for _, bone in known], hand_offset[:, bones].max(2))
        sigma = np.hypot(sigma, misfit / sizes[:, None] * REFERENCE_HEIGHT)
        depth = np.where(both, sigma, np.inf)
        tensor = lambda x: torch.from_numpy(np.asarray(x, np.float32))
        return LandmarkNoise(
            tensor(pixels),
            tensor(_whitening(landmarks.pixels[:, at].astype(float), pixels, names)),
            torch.from_numpy(bones),
            tensor([bone.gain for _, bone in known]),
            tensor([bone.bias for _, bone in known]),
            tensor(depth),
        )


def face_factors(landmarks: Landmarks) -> np.ndarray:
    """Return the factor on errors of the face's points in each frame (T,), from the front 1.

    The network's metres tell where the face looks: from the middle of the ears to the nose. Without
    them the factor is 1.
    """
    wanted = ("nose", "left_ear", "right_ear")
    if not set(wanted) <= set(landmarks.names):
        return np.ones(len(landmarks))
    nose, *ears = landmarks.metric[:, landmarks.indices(wanted)].astype(float).swapaxes(0, 1)
    ahead = nose - np.mean(ears, axis=0)
    cosine = -ahead[:, 2] / np.maximum(np.linalg.norm(ahead, axis=1), 1e-9)
    away = ((SEEN_FACE - cosine) / (1 + SEEN_FACE)).clip(0, 1)
    return 1 + (HIDDEN_FACE - 1) * np.nan_to_num(away)


def _whitening(x: np.ndarray, sigma: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return ``σ Σ^-1/2`` of eq. 2 (T, P, 2, 2) for points (T, P, 2).

    A limb that is shorter than ``σ`` in the picture has no direction: its covariance stays round.
    """
    whitening = np.tile(np.eye(2), (*sigma.shape, 1, 1))
    for point, other in _ends(OTHER_END.items(), names):
        limb = x[:, point] - x[:, other]
        length = np.hypot(*limb.T)
        seen = length > sigma[:, point]
        u = limb[seen] / length[seen, None]
        whitening[seen, point] -= (1 - 1 / ALONG_LIMB) * u[:, :, None] * u[:, None]
    return whitening


def _hand_offsets(
    landmarks: Landmarks, names: Sequence[str], pixels_per_metre: np.ndarray
) -> np.ndarray:
    """Return ``hand_offset`` (T, P) of eq. 1, metres; ``pixels_per_metre`` is (T,)."""
    offsets, every = np.zeros((len(landmarks), len(names))), list(landmarks.names)
    for side in ("left", "right"):
        pair = f"{side}_wrist", f"{side}_hand_wrist"
        if not set(pair) <= set(every):
            continue
        wrist, hand = landmarks.indices(pair)
        apart = landmarks.pixels[:, wrist].astype(float) - landmarks.pixels[:, hand]
        confidence = np.nan_to_num(landmarks.confidence[:, wrist]).clip(SMALLEST_CONFIDENCE, 1)
        usual = 2 * (BODY_SHARE * REFERENCE_HEIGHT) ** 2 / confidence
        beyond = (np.square(apart).sum(1) / pixels_per_metre**2 - usual).clip(0)
        of_hand = [name.startswith(f"{side}_hand_") for name in names]
        offsets[:, of_hand] = np.sqrt(np.nan_to_num(beyond))[:, None]
    return offsets


def person_sizes(landmarks: Landmarks) -> np.ndarray:
    """Return ``S`` (T,), the pixels of 1.7 m; frames without a person take the median.

    It is the scale between pixels and the network's metres, by least squares over the body.

    Raises:
        InputError: no frame has a person.
    """
    body = [k for k, name in enumerate(landmarks.names) if "_hand_" not in name]
    x, m = landmarks.pixels[:, body].astype(float), landmarks.metric[:, body, :2].astype(float)
    seen = np.isfinite(x).all(2) & np.isfinite(m).all(2)
    weights = (seen / np.maximum(seen.sum(1, keepdims=True), 1))[..., None]
    x, m = np.where(seen[..., None], x, 0), np.where(seen[..., None], m, 0)
    x, m = x - (weights * x).sum(1, keepdims=True), m - (weights * m).sum(1, keepdims=True)
    along, square = (weights * x * m).sum((1, 2)), (weights * m * m).sum((1, 2))
    usable = (seen.sum(1) >= 4) & (along > 0)
    if not usable.any():
        raise InputError("landmarks: no frame has a person; expected at least four points of one")
    sizes = REFERENCE_HEIGHT * along / np.maximum(square, 1e-9)
    return np.where(usable, sizes, np.median(sizes[usable]))


def median_sizes(sizes: np.ndarray) -> np.ndarray:
    """Return the running median (T,) of the sizes ``S`` (T,).

    It reaches equally far to both sides, so that it follows a person who comes nearer.
    """
    last, n = len(sizes) - 1, SIZE_MEDIAN_FRAMES
    reach = [min(n, t, last - t) for t in range(len(sizes))]
    return np.array([np.median(sizes[t - n : t + n + 1]) for t, n in enumerate(reach)])


def size_misfits(sizes: np.ndarray) -> np.ndarray:
    """Return the misfit (T,) of the sizes ``S`` (T,), pixels.

    It is ``√((S - median)² - usual²)``, and zero for a usual deviation from the running median.
    """
    median = median_sizes(sizes)
    off = np.abs(sizes - median)
    usual = np.maximum(USUAL_DEVIATIONS * np.median(off), USUAL_CHANGE * median)
    return np.sqrt((off**2 - usual**2).clip(0))


def misplaced_frames(landmarks: Landmarks) -> list[int]:
    """Return the frames in which the network misplaced the whole person, by their misfit.

    Raises:
        InputError: no frame has a person.
    """
    sizes = person_sizes(landmarks)
    wrong = size_misfits(sizes) > MISPLACED * median_sizes(sizes)
    return np.flatnonzero(wrong & np.isfinite(landmarks.pixels).any((1, 2))).tolist()


def correlated_frames(landmarks: Landmarks, dt: float, hand: str | None = None) -> Tensor:
    """Return ``m`` (T,) of eq. 4: how many frames count as one.

    Args:
        landmarks: of T frames.
        dt: seconds between frames.
        hand: "left" or "right": compare the landmarks of this hand; None: of the body.

    Raises:
        InputError: no frame has a person.
    """
    compared = lambda name: f"{hand}_hand_" in name if hand else "_hand_" not in name
    columns = [k for k, name in enumerate(landmarks.names) if compared(name)]
    share = HAND_SHARE if hand else BODY_SHARE
    pixels_per_metre = person_sizes(landmarks)[:, None, None] / REFERENCE_HEIGHT
    x = landmarks.pixels[:, columns].astype(float) / pixels_per_metre
    seen = np.isfinite(x).all(2).astype(float)
    x = np.where(seen[..., None] > 0, x, 0)
    x = (x - x.sum(1, keepdims=True) / np.maximum(seen.sum(1), 1)[:, None, None]) * seen[..., None]
    square = np.square(x).sum(2) @ seen.T
    apart = square + square.T - 2 * np.einsum("tpc,kpc->tk", x, x)
    apart = np.maximum(apart, 0) / np.maximum(seen @ seen.T, 1)
    count = np.exp(-apart / (4 * (share * REFERENCE_HEIGHT) ** 2)) @ seen.any(1)
    return torch.from_numpy(np.maximum(count, max(1.0, LANDMARK_CORRELATION_SECONDS / dt)))


def independent_points(names: Sequence[str], group_hands: bool) -> Tensor:
    """Return the weight of each landmark (P,): the points of a group together count as few.

    Points of the face err together, and with ``group_hands`` the points of a hand, too.
    """
    groups = [_group(name, group_hands) for name in names]
    share = lambda group: min(1.0, POINTS_OF_GROUP / groups.count(group)) if group else 1.0
    return torch.tensor([share(group) for group in groups])


def _group(name: str, group_hands: bool) -> str | None:
    """Return the name of the group whose points err together; None for other landmarks."""
    if name in _FACE:
        return "face"
    return name[: name.index("_hand_")] if group_hands and "_hand_" in name else None


def _bones(names: Sequence[str]) -> Iterator[tuple[tuple[int, int], BoneDepth]]:
    """Yield each bone between the landmarks: the indices of its ends, and its depth model."""
    every = dict(BONES)
    for finger, parts in _FINGER_POINTS.items():
        points = [f"hand_{finger}_{part}" for part in parts]
        every |= {pair: PHALANX for pair in zip(points, points[1:], strict=False)}
    for pair, bone in every.items():
        for ends in _ends([pair], names):
            yield ends, bone


def _ends(pairs: Iterable[tuple[str, str]], names: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Yield pairs of names as indices, for both sides unless the names say one."""
    at = {name: k for k, name in enumerate(names)}
    for pair in pairs:
        for side in ("left", "right"):
            one, other = (name if name in at else f"{side}_{name}" for name in pair)
            if one in at and other in at and (side == "left" or {one, other} != set(pair)):
                yield at[one], at[other]
