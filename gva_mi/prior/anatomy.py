"""Anatomical limits: hinges bend about one axis and within a range; finger joints bend together.

A knee, an elbow or a finger joint bends about one axis, and hardly turns about the other two.
Single-frame estimators respect this only loosely, and small images show little of it. Let
``x = log R`` be the rotation of a joint in the axes of the rest pose, and ``b`` the bone that it
moves. A hinge that bends toward ``d`` has the axes

1. ``bend = b × d``,  ``aside = bend × b``,  ``twist = b``    (unit vectors)

The angles that should be zero are linear in ``x``: ``a_q = Σ_i A_qi · x_i``. They are

2. ``aside · x`` and ``twist · x`` of every hinge,
3. ``bend · (x_3 - 2/3 x_2)`` of every finger: its last joint follows the middle one (Rijpkema and
   Girard, *Computer Animation of Knowledge-Based Human Grasping*, 1991).

Real hinges are not perfect, and the joints of a body model are not the joints of a skeleton. So
each angle may have a constant offset, and a smaller offset that varies slowly. Its covariance ``K``
has the form of eq. 2 of :mod:`gva_mi.prior.error_model`. A motion costs

4. ``E = Σ_q a_q · K_q⁻¹ a_q / 2 + Σ_hinges Σ_k max(low - bend · x, bend · x - high, 0)² / 2 m σ²``

in nats for the whole clip. The second term penalises bends beyond the limits ``low`` and ``high``
of :data:`HINGES`. In it ``m`` frames count as one, because errors of neighbouring frames agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS

# m of eq. 4, frames over which the varying offset is correlated. Chosen: 0.2 s of a 30 Hz video.
CORRELATED_FRAMES = 6.0
LIMIT_SIGMA_DEGREES = 5.0  # σ of eq. 4; chosen: the limits of HINGES are rounded
WHITE_OFFSET_DEGREES = 1.0  # added to K, so that it is not singular; chosen below all AngleSpreads
LAST_JOINT_RATIO = 2 / 3  # bend of a finger's last joint over its middle joint: eq. 3


@dataclass(frozen=True)
class AngleSpread:
    """Standard deviations of an angle that should be zero, degrees."""

    constant: float  # of the constant offset
    varying: float  # of the offset that varies with the pose


LAST_JOINT_SPREAD = AngleSpread(12.0, 6.0)  # of eq. 3; chosen as wide as a knuckle's aside


@dataclass(frozen=True)
class Hinge:
    """How far a kind of hinge may turn about its axes (eq. 1), degrees; None: any angle."""

    aside: AngleSpread | None
    twist: AngleSpread | None
    bend: tuple[float, float] | None  # low and high: from full extension to full flexion


class HingeAxes(NamedTuple):
    """The axes of one joint (eq. 1), unit vectors (3,)."""

    kind: str  # key of HINGES
    bend: Tensor
    aside: Tensor
    twist: Tensor


# Ranges of bends: anatomy textbooks, rounded outward. Spreads are chosen: knees and fingers are
# better hinges than elbows and knuckles.
HINGES: Mapping[str, Hinge] = MappingProxyType(
    {
        "knee": Hinge(AngleSpread(5, 3), AngleSpread(8, 4), (-5, 155)),
        "elbow": Hinge(AngleSpread(10, 5), None, (-10, 155)),  # a forearm twists
        "toes": Hinge(AngleSpread(5, 3), AngleSpread(5, 3), None),
        "knuckle": Hinge(AngleSpread(12, 6), AngleSpread(6, 3), (-35, 105)),
        "finger": Hinge(AngleSpread(6, 3), AngleSpread(6, 3), (-10, 120)),
        "thumb": Hinge(None, AngleSpread(10, 5), None),
    }
)
_FOUR_FINGERS = ("index", "middle", "ring", "pinky")


@dataclass
class Anatomy:
    """The prior of one body: angles that should be zero, and limits of bends.

    Attributes:
        A: (Q, J, 3) coefficients of eq. 2 and 3.
        spreads: of the Q angles.
        bends: (H, J, 3) coefficients of the bend of each hinge that has limits.
        limits: (H, 2) low and high, radians.
    """

    A: Tensor
    spreads: Sequence[AngleSpread]
    bends: Tensor
    limits: Tensor
    _precisions: dict[tuple[AngleSpread, bytes], Tensor] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(joints: Tensor) -> Anatomy:
        """Derive the prior from joints (J, 3) at rest, metres; joints without a bone are free."""
        rows, spreads, bends, limits = [], [], [], []

        def add_angle(spread: AngleSpread, *parts: tuple[int, Tensor]) -> None:
            row = torch.zeros(len(JOINTS), 3)
            for joint, axis in parts:
                row[joint] = axis
            rows.append(row)
            spreads.append(spread)

        hinges = _hinges(joints.detach().float())
        for joint, axes in hinges.items():
            hinge = HINGES[axes.kind]
            if hinge.aside is not None:
                add_angle(hinge.aside, (joint, axes.aside))
            if hinge.twist is not None:
                add_angle(hinge.twist, (joint, axes.twist))
            if hinge.bend is not None:
                bends.append(torch.zeros(len(JOINTS), 3))
                bends[-1][joint] = axes.bend
                limits.append(np.radians(hinge.bend).tolist())
        for side in ("left", "right"):
            for finger in _FOUR_FINGERS:
                middle, last = (JOINTS.index(f"{side}_{finger}{k}") for k in (2, 3))
                if middle in hinges and last in hinges:
                    following = middle, -LAST_JOINT_RATIO * hinges[middle].bend
                    add_angle(LAST_JOINT_SPREAD, (last, hinges[last].bend), following)
        empty = torch.zeros(0, len(JOINTS), 3)
        A, bends = (torch.stack(x) if x else empty for x in (rows, bends))
        return Anatomy(A, spreads, bends, torch.tensor(limits).view(-1, 2))

    def energy(self, rotations: Tensor, transl: Tensor | None, times: Tensor) -> Tensor:
        """Return eq. 4; see :class:`gva_mi.prior.inference.PriorTerm`."""
        angles = torch.einsum("qjc,njc->qn", self.A, rotations)
        total = rotations.new_zeros(())
        for spread, indices in self._angles_of_spread.items():
            a = angles[indices]
            total = total + (a * (a @ self._precision(spread, times))).sum() / 2
        bend = torch.einsum("hjc,njc->nh", self.bends, rotations)
        past = (self.limits[:, 0] - bend).clamp_min(0) + (bend - self.limits[:, 1]).clamp_min(0)
        sigma = np.radians(LIMIT_SIGMA_DEGREES)
        return total + past.square().sum() / (2 * CORRELATED_FRAMES * sigma**2)

    def conditioned(self, rotations: Tensor, covariance: Tensor, times: Tensor) -> Tensor:
        """Condition a Gaussian of rotations on eq. 2 and 3; return the new mean (n, J, 3).

        Args:
            rotations: (n, J, 3) the mean before, axis-angle.
            covariance: (J, n, n) of each coordinate, float64; zero for joints that stay.
            times: (n,) frame numbers.
        """
        bent = rotations.double()
        for row, spread in zip(self.A.double(), self.spreads, strict=True):
            parts = row.any(1).nonzero()[:, 0].tolist()
            if not bool(covariance[parts].any()):
                continue
            a = torch.einsum("jc,njc->n", row[parts], bent[:, parts])
            of_angle = torch.einsum("j,jkl->kl", row[parts].square().sum(1), covariance[parts])
            total = of_angle + _covariance(spread, times)
            pull = torch.cholesky_solve(a[:, None], torch.linalg.cholesky(total))[:, 0]
            for joint in parts:
                bent[:, joint] -= (covariance[joint] @ pull)[:, None] * row[joint]
        return bent.to(rotations.dtype)

    @cached_property
    def _angles_of_spread(self) -> dict[AngleSpread, Tensor]:
        """Indices of the angles that have the same spread, which share one precision."""
        indices = lambda spread: [q for q, own in enumerate(self.spreads) if own == spread]
        return {x: torch.tensor(indices(x)) for x in dict.fromkeys(self.spreads)}

    def _precision(self, spread: AngleSpread, times: Tensor) -> Tensor:
        key = spread, times.numpy().tobytes()
        if key not in self._precisions:
            factor = torch.linalg.cholesky(_covariance(spread, times))
            self._precisions[key] = torch.cholesky_inverse(factor).float()
        return self._precisions[key]


def _covariance(spread: AngleSpread, times: Tensor) -> Tensor:
    """Return ``K`` (n, n) of an angle at times (n,), float64, square radians."""
    x = 3**0.5 * (times[:, None] - times).abs().double() / CORRELATED_FRAMES
    varying = spread.varying**2 * (1 + x) * torch.exp(-x)
    white = WHITE_OFFSET_DEGREES**2 * torch.eye(len(times), dtype=torch.float64)
    return np.radians(1) ** 2 * (spread.constant**2 + varying + white)


def _hinges(joints: Tensor) -> dict[int, HingeAxes]:
    """Return the axes (eq. 1) of every hinge of the body, by joint."""
    at = {name: joints[i] for i, name in enumerate(JOINTS)}
    hinges = {}

    def add(name: str, kind: str, bone: Tensor, toward: Tensor) -> None:
        b = torch.nn.functional.normalize(bone, dim=0)
        bend = torch.linalg.cross(b, toward)
        if float(bend.norm()) > 1e-6:
            bend = torch.nn.functional.normalize(bend, dim=0)
            aside = torch.linalg.cross(bend, b)
            hinges[JOINTS.index(name)] = HingeAxes(kind, bend, aside, b)

    # Each foot points outward, but the mean of both points to where knees bend.
    ahead = sum(at[f"{side}_foot"] - at[f"{side}_ankle"] for side in ("left", "right"))
    for side in ("left", "right"):
        shin = at[f"{side}_ankle"] - at[f"{side}_knee"]
        forward = ahead - (ahead @ shin) / (shin @ shin).clamp_min(1e-12) * shin
        add(f"{side}_knee", "knee", shin, -forward)
        add(f"{side}_foot", "toes", forward, -shin)
        add(f"{side}_elbow", "elbow", at[f"{side}_wrist"] - at[f"{side}_elbow"], forward)
        wrist, index, pinky = (at[f"{side}_{x}"] for x in ("wrist", "index1", "pinky1"))
        palm = torch.linalg.cross(pinky - wrist, index - wrist)
        palm = palm if side == "left" else -palm
        for finger in _FOUR_FINGERS:
            points = [at[f"{side}_{finger}{k}"] for k in (1, 2, 3)]
            first, second = points[1] - points[0], points[2] - points[1]
            add(f"{side}_{finger}1", "knuckle", first, palm)
            add(f"{side}_{finger}2", "finger", second, palm)
            add(f"{side}_{finger}3", "finger", second, palm)
        for k in (2, 3):
            bone = at[f"{side}_thumb3"] - at[f"{side}_thumb2"]
            add(f"{side}_thumb{k}", "thumb", bone, palm)
    return hinges
