"""Ground contact: standing soles share one plane, and rest or slide steadily.

Images hardly show whether a leg tilts toward the camera, but heel and ball then hang in the air, or
in the ground. Points ``q`` of the soles (:class:`Soles`) are at ``x_kq`` in frame ``k``, and above
the ground by

1. ``h_kq = up · x_kq - s_1 (e_1 · x_kq) - s_2 (e_2 · x_kq) - c_q``

with ``up`` the mean direction in which the person is upright, ``e_1``, ``e_2`` at right angles to
it, the slopes ``s``, and a level ``c`` for heels and another for balls, because shoes have heels.
Each point stands, or swings:

2. ``p(h) = w t(h / σ) / σ + (1 - w) σ⁺(h / σ) e^(-max(h, 0) / λ) / λ``

with Student's ``t``, the share ``w`` of the time that feet stand, the unevenness ``σ`` of the
ground and the poses, the usual lift ``λ``, and the logistic function ``σ⁺``. ``s``, ``c``, ``w``,
``σ`` and ``λ`` maximise the likelihood of the video's points (expectation maximisation). Without
one ground plane, as on stairs, ``σ`` is large, and the term weak. With ``r_kq`` the probability
that a point stands, poses cost

3. ``E = -Σ_kq log p(h_kq) / m + Σ_kq r_k-1,q r_kq r_k+1,q cost(x_k-1,q - 2 x_kq + x_k+1,q)``

in which ``m`` frames count as one, and ``cost`` is that of :mod:`gva_mi.prior.process`.
Standing points may slide at constant velocity, as on a turntable: penalising steps instead of their
changes would stop that turn. How much steps may change is what images show sideways of the foot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.body.smplx import Rest
from gva_mi.body.so3 import to_matrix
from gva_mi.core.cpu import sqrt
from gva_mi.prior.error_model import FREEDOM, T_PEAK
from gva_mi.prior.process import EXCURSION_FRAMES, excursions, mean_square, step_cost

SOLE = 0.012  # m above the lowest vertex: what still touches the ground
MEMORY = 6.0  # m, frames for which a point's height error lasts
TILT = 0.15  # standard deviation of the slopes: how far from upright people are on average
HEELS = 0.015  # the same of the levels' difference, m
EVEN, UNEVEN = 0.004, 0.08  # least and largest σ, m
LEAST_LIFT = 0.05  # λ, m
LEAST_SHARE = 0.05  # of the points that stand, and of those that swing
LEAST_CHANGE = 0.001  # m, of a step
BEND = 0.2  # change of a step, relative to its length: a turntable's turn per frame, radians
ROUNDS = 40  # of expectation maximisation

_CHAIN = [JOINTS.index("pelvis")] + [
    JOINTS.index(f"{side}_{name}")
    for name in ("hip", "knee", "ankle", "foot")
    for side in ("left", "right")
]
_PARENTS = tuple(_CHAIN.index(PARENTS[j]) if PARENTS[j] in _CHAIN else -1 for j in _CHAIN)
_KINDS = ("ankle", "foot")  # whose lowest points are heels and balls


@dataclass(frozen=True)
class Soles:
    """The heels and balls of a person's feet, and the joints that move them."""

    joints: Tensor  # (9, 3) of pelvis and legs at rest, metres
    points: Tensor  # (4, 3) at rest, metres: heels, then balls, each left and right

    @staticmethod
    def of(rest: Rest, weights: Tensor) -> Soles:
        """Find them in the T-pose, upright along y, by skinning weights (V, 55)."""
        vertices, points = rest.vertices.detach(), []
        low = vertices[:, 1].min() + SOLE
        for kind in _KINDS:
            for side in ("left", "right"):
                joint = JOINTS.index(f"{side}_{kind}")
                own = vertices[(weights[:, joint] > 0.5) & (vertices[:, 1] < low)]
                # A body without such vertices has a point below the joint.
                below = rest.joints.detach()[joint] * own.new_tensor([1, 0, 1])
                below[1] = vertices[:, 1].min()
                points.append(own.mean(0) if len(own) else below)
        return Soles(rest.joints.detach()[_CHAIN], torch.stack(points))

    def places(self, rotations: Tensor, transl: Tensor) -> Tensor:
        """Return the points (n, 4, 3), world, metres, in poses of all joints; differentiable."""
        maps = turn_joints(rotations[:, _CHAIN], self.joints, _PARENTS, transl)[1]
        of_feet = maps[:, -len(self.points) :]
        return (of_feet[..., :3, :3] @ self.points[..., None])[..., 0] + of_feet[..., :3, 3]


@dataclass(frozen=True)
class ContactStats:
    """How the feet touch the ground in a video (eq. 2)."""

    spread: float  # σ, metres
    share: float  # w
    lift: float  # λ, metres


@dataclass(frozen=True)
class Ground:
    """The ground plane of a video, and how its person stands on it."""

    soles: Soles
    axes: Tensor  # (3, 3) rows ``up``, ``e_1``, ``e_2``, world
    plane: Tensor  # (4,) ``s_1``, ``s_2``, and ``c`` of heels and of balls, metres
    contact: ContactStats  # ``σ``, ``w`` and ``λ``
    square_change: Tensor  # (n - 2, 4) of the steps of each point, square metres
    stay: Tensor  # (n - 2, 4) the product of three ``r``, of each of these changes

    @staticmethod
    @torch.no_grad()
    def under(soles: Soles, pose: Pose, times: Tensor, R_camera_world: Tensor) -> Ground:
        """Fit the ground to poses of n frames; images show motions sideways, across the camera."""
        places = soles.places(pose.rotations, pose.transl)
        axes = _axes(pose)
        height = (places @ axes[0]).view(len(places), 2, 2)
        level = height.transpose(0, 1).flatten(1).quantile(0.2, dim=1)
        plane = torch.cat([level.new_zeros(2), level])
        start = ContactStats(UNEVEN / 2, 0.7, 2 * LEAST_LIFT)
        square = _square_change(places @ R_camera_world.T[:, :2], times)
        ground = Ground(soles, axes, plane, start, square, torch.ones_like(square))
        for _ in range(ROUNDS):
            ground = ground._updated(places)
        stands = ground.stands(places)
        return replace(ground, stay=stands[2:] * stands[1:-1] * stands[:-2])

    def energy(self, rotations: Tensor, transl: Tensor, times: Tensor) -> Tensor:
        """Return eq. 3; see :class:`gva_mi.prior.inference.PriorTerm`."""
        places = self.soles.places(rotations, transl)
        on, off = self._probabilities(self.heights(places))
        changes = _steps(places, times).diff(dim=0)
        slid = self.stay * step_cost(changes, self.square_change)
        return -(on + off).log().sum() / MEMORY + slid.sum()

    def heights(self, places: Tensor) -> Tensor:
        """Return eq. 1 (n, 4) of points (n, 4, 3), metres."""
        return places @ self.axes[0] - self._unknowns(places) @ self.plane

    def stands(self, places: Tensor) -> Tensor:
        """Return ``r`` (n, 4): the probability that each of the points (n, 4, 3) stands."""
        on, off = self._probabilities(self.heights(places))
        return on / (on + off)

    def _unknowns(self, places: Tensor) -> Tensor:
        """Return what ``plane`` multiplies in eq. 1 (n, 4, 4)."""
        heels = places.new_tensor([[1, 0], [1, 0], [0, 1], [0, 1]])
        return torch.cat([places @ self.axes[1:].T, heels.expand(len(places), 4, 2)], dim=-1)

    def _probabilities(self, h: Tensor) -> tuple[Tensor, Tensor]:
        """Return the two terms of eq. 2, each (n, 4)."""
        it = self.contact
        t = (1 + (h / it.spread).square() / FREEDOM) ** (-(FREEDOM + 1) / 2)
        swings = torch.sigmoid(h / it.spread) * torch.exp(-h.clamp_min(0) / it.lift)
        return it.share * T_PEAK * t / it.spread, (1 - it.share) * swings / it.lift

    def _weights(self, h: Tensor, stands: Tensor) -> Tensor:
        """Return the weights (n, 4) of square heights in the M-step."""
        return stands * (FREEDOM + 1) / (FREEDOM + (h / self.contact.spread).square())

    def _plane(self, places: Tensor) -> Tensor:
        """Return the MAP slopes and levels, given which points stand."""
        A = self._unknowns(places).double()
        weights = self._weights(self.heights(places), self.stands(places)).double()
        weights = weights / (MEMORY * self.contact.spread**2)
        height = (places @ self.axes[0]).double()
        held = A.new_zeros(4, 4)
        held[:2, :2] = torch.eye(2) / TILT**2
        held[2:, 2:] = (2 * torch.eye(2) - 1) / HEELS**2
        held = held + 1e-6 * torch.eye(4)  # if no point stands, the levels are undetermined
        curved = torch.einsum("nq,nqi,nqj->ij", weights, A, A) + held
        pull = torch.einsum("nq,nqi,nq->i", weights, A, height)
        return torch.cholesky_solve(pull[:, None], torch.linalg.cholesky(curved))[:, 0].to(places)

    def _updated(self, places: Tensor) -> Ground:
        """Return the ground after one round of expectation maximisation."""
        moved = replace(self, plane=self._plane(places))
        h = moved.heights(places)
        stands = moved.stands(places)
        of_ground = moved._weights(h, stands)
        spread = sqrt((of_ground * h.square()).sum() / stands.sum().clamp_min(1e-6))
        lift = ((1 - stands) * h.clamp_min(0)).sum() / (1 - stands).sum().clamp_min(1e-6)
        contact = ContactStats(
            spread=min(max(float(spread), EVEN), UNEVEN),
            share=min(max(float(stands.mean()), LEAST_SHARE), 1 - LEAST_SHARE),
            lift=max(float(lift), LEAST_LIFT),
        )
        return replace(moved, contact=contact)


def _steps(places: Tensor, times: Tensor) -> Tensor:
    """Return the steps per frame (n - 1, 4, d) of points (n, 4, d)."""
    return places.diff(dim=0) / times.diff().to(places)[:, None, None]


def _square_change(aside: Tensor, times: Tensor) -> Tensor:
    """Return how much steps may change (n - 2, 4), from sideways positions (n, 4, 2)."""
    steps = _steps(aside, times)
    changes = excursions(steps.diff(dim=0), EXCURSION_FRAMES)
    bends = BEND * (steps[1:] + steps[:-1]) / 2
    square = (changes.square() + bends.square()).mean(-1)
    # Of heel and ball alone, one may move along the line of sight.
    of_foot = square.view(-1, 2, 2).amax(1).repeat(1, 2)
    return mean_square(of_foot, times[: len(square)].to(square)) + LEAST_CHANGE**2


def _axes(pose: Pose) -> Tensor:
    """Return the median upright direction, and two at right angles (3, 3)."""
    upright = to_matrix(pose.rotations[:, 0])[:, :, 1]
    up = torch.nn.functional.normalize(upright.median(0).values, dim=0)
    other = torch.eye(3).to(up)[int(up.abs().argmin())]
    first = torch.nn.functional.normalize(torch.linalg.cross(up, other), dim=0)
    return torch.stack([up, first, torch.linalg.cross(up, first)])
