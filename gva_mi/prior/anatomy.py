"""Anatomical limits: hinges bend about one axis and within a range, fingers bend as one.

A knee, an elbow or a finger joint bends about one axis, and hardly turns about the other two.
Single-frame estimators know that only loosely, and images of this size show little of it. With
``x = log R`` of all joints, in the axes of the rest pose, and the bone ``b`` that a joint moves,
the axes of a hinge that bends toward ``d`` are

1. ``bend = b × d``,  ``aside = bend × b``,  ``twist = b``    (unit vectors)

and the angles that should be zero are linear in ``x``: ``a_q = Σ_i A_qi · x_i``, one of

2. ``aside · x`` and ``twist · x`` of a hinge,
3. ``bend · (x_3 - 2/3 x_2)`` of a finger, whose last joint follows the middle one (Rijpkema and
   Girard, *Computer Animation of Knowledge-Based Human Grasping*, 1991).

Hinges are not perfect, and a body model's joints are not those of a skeleton: each angle may have a
constant offset, and a smaller one that varies slowly, so its covariance ``K`` has the form of
:mod:`gva_mi.prior.error_model`. A motion costs

4. ``E = Σ_q a_q · K_q⁻¹ a_q / 2 + Σ_hinges Σ_k max(low - bend · x, bend · x - high, 0)² / 2 m σ²``

in nats for the whole clip. The second term penalises bends beyond ``low`` and ``high``
(:data:`HINGES`); in it ``m`` frames count as one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS

MEMORY = 6.0  # m, frames for which the varying offset of an angle lasts
PAST_LIMIT = 5.0  # σ, degrees
LEAST = 1.0  # degrees of white offset; keeps K from being singular
FOLLOWS = 2 / 3  # bend of a finger's last joint, relative to the middle one's


@dataclass(frozen=True)
class Freedom:
    """Standard deviations of an angle, degrees."""

    always: float  # of the constant offset
    varying: float  # of the one that varies with the pose


FOLLOWING = Freedom(12.0, 6.0)  # eq. 3


@dataclass(frozen=True)
class Hinge:
    """How freely a kind of joint turns, degrees; None: freely."""

    aside: Freedom | None
    twist: Freedom | None
    bend: tuple[float, float] | None  # from full extension to full flexion


# Ranges of motion are those of anatomy textbooks, rounded outward.
HINGES: Mapping[str, Hinge] = MappingProxyType(
    {
        "knee": Hinge(Freedom(5, 3), Freedom(8, 4), (-5, 155)),
        "elbow": Hinge(Freedom(10, 5), None, (-10, 155)),  # the forearm may twist along
        "toes": Hinge(Freedom(5, 3), Freedom(5, 3), None),
        "knuckle": Hinge(Freedom(12, 6), Freedom(6, 3), (-35, 105)),
        "finger": Hinge(Freedom(6, 3), Freedom(6, 3), (-10, 120)),
        "thumb": Hinge(None, Freedom(10, 5), None),
    }
)
_FOUR = ("index", "middle", "ring", "pinky")


@dataclass
class Anatomy:
    """The angles that a body's joints should keep at zero, and their limits."""

    A: Tensor  # (Q, J, 3) of eq. 2 and 3
    freedoms: Sequence[Freedom]  # Q of them
    bends: Tensor  # (H, J, 3) of hinges that have limits
    limits: Tensor  # (H, 2) low and high, radians
    _precisions: dict[tuple[Freedom, bytes], Tensor] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(joints: Tensor) -> Anatomy:
        """Derive it from joints (J, 3) at rest; joints without a bone are free."""
        rows, freedoms, bends, limits = [], [], [], []

        def held(freedom: Freedom, *parts: tuple[int, Tensor]) -> None:
            row = torch.zeros(len(JOINTS), 3)
            for joint, axis in parts:
                row[joint] = axis
            rows.append(row)
            freedoms.append(freedom)

        axes = _hinges(joints.detach().float())
        for joint, (kind, bend, aside, twist) in axes.items():
            hinge = HINGES[kind]
            if hinge.aside is not None:
                held(hinge.aside, (joint, aside))
            if hinge.twist is not None:
                held(hinge.twist, (joint, twist))
            if hinge.bend is not None:
                bends.append(torch.zeros(len(JOINTS), 3))
                bends[-1][joint] = bend
                limits.append(np.radians(hinge.bend).tolist())
        for side in ("left", "right"):
            for finger in _FOUR:
                middle, last = (JOINTS.index(f"{side}_{finger}{k}") for k in (2, 3))
                if middle in axes and last in axes:
                    held(FOLLOWING, (last, axes[last][1]), (middle, -FOLLOWS * axes[middle][1]))
        empty = torch.zeros(0, len(JOINTS), 3)
        A, bends = (torch.stack(x) if x else empty for x in (rows, bends))
        return Anatomy(A, freedoms, bends, torch.tensor(limits).view(-1, 2))

    def energy(self, rotations: Tensor, transl: Tensor | None, times: Tensor) -> Tensor:
        """Return eq. 4; see :class:`gva_mi.prior.inference.PriorTerm`."""
        angles = torch.einsum("qjc,njc->qn", self.A, rotations)
        total = rotations.new_zeros(())
        for freedom, which in self._alike.items():
            a = angles[which]
            total = total + (a * (a @ self._precision(freedom, times))).sum() / 2
        bend = torch.einsum("hjc,njc->nh", self.bends, rotations)
        past = (self.limits[:, 0] - bend).clamp_min(0) + (bend - self.limits[:, 1]).clamp_min(0)
        return total + past.square().sum() / (2 * MEMORY * np.radians(PAST_LIMIT) ** 2)

    def conditioned(self, rotations: Tensor, covariance: Tensor, times: Tensor) -> Tensor:
        """Return the mean rotations (n, J, 3) of a Gaussian, conditioned on eq. 2 and 3.

        Given are the unconditioned mean, axis-angle, at times (n,), and the covariance (J, n, n) of
        each coordinate, float64, which is zero for joints that stay.
        """
        found = rotations.double()
        for row, freedom in zip(self.A.double(), self.freedoms, strict=True):
            parts = row.any(1).nonzero()[:, 0].tolist()
            if not bool(covariance[parts].any()):
                continue
            a = torch.einsum("jc,njc->n", row[parts], found[:, parts])
            spread = torch.einsum("j,jkl->kl", row[parts].square().sum(1), covariance[parts])
            off = _covariance(freedom, times)
            pull = torch.cholesky_solve(a[:, None], torch.linalg.cholesky(spread + off))[:, 0]
            for joint in parts:
                found[:, joint] -= (covariance[joint] @ pull)[:, None] * row[joint]
        return found.to(rotations.dtype)

    @cached_property
    def _alike(self) -> dict[Freedom, Tensor]:
        """The angles of each freedom."""
        numbers = lambda freedom: [q for q, own in enumerate(self.freedoms) if own == freedom]
        return {f: torch.tensor(numbers(f)) for f in dict.fromkeys(self.freedoms)}

    def _precision(self, freedom: Freedom, times: Tensor) -> Tensor:
        key = freedom, times.numpy().tobytes()
        if key not in self._precisions:
            factor = torch.linalg.cholesky(_covariance(freedom, times))
            self._precisions[key] = torch.cholesky_inverse(factor).float()
        return self._precisions[key]


def _covariance(freedom: Freedom, times: Tensor) -> Tensor:
    """Return ``K`` (n, n) float64, square radians."""
    x = 3**0.5 * (times[:, None] - times).abs().double() / MEMORY
    varying = freedom.varying**2 * (1 + x) * torch.exp(-x)
    K = freedom.always**2 + varying + LEAST**2 * torch.eye(len(times), dtype=torch.float64)
    return np.radians(1) ** 2 * K


def _hinges(joints: Tensor) -> dict[int, tuple[str, Tensor, Tensor, Tensor]]:
    """Return eq. 1 of every hinge: its kind, and the axes ``bend``, ``aside`` and ``twist``."""
    at = {name: joints[i] for i, name in enumerate(JOINTS)}
    found = {}

    def add(name: str, kind: str, bone: Tensor, toward: Tensor) -> None:
        b = torch.nn.functional.normalize(bone, dim=0)
        bend = torch.linalg.cross(b, toward)
        if float(bend.norm()) > 1e-6:
            bend = torch.nn.functional.normalize(bend, dim=0)
            found[JOINTS.index(name)] = (kind, bend, torch.linalg.cross(bend, b), b)

    # Toes point outward, but the mean of both feet points to where knees bend.
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
        for finger in _FOUR:
            points = [at[f"{side}_{finger}{k}"] for k in (1, 2, 3)]
            first, second = points[1] - points[0], points[2] - points[1]
            add(f"{side}_{finger}1", "knuckle", first, palm)
            add(f"{side}_{finger}2", "finger", second, palm)
            add(f"{side}_{finger}3", "finger", second, palm)
        for k in (2, 3):
            bone = at[f"{side}_thumb3"] - at[f"{side}_thumb2"]
            add(f"{side}_thumb{k}", "thumb", bone, palm)
    return found
