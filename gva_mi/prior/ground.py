"""Ground contact: the soles of standing feet share one plane, and rest or slide steadily.

Images hardly show whether a leg tilts toward the camera, but then heel and ball hang in the air, or
sink into the ground. The points ``q`` of the soles (:class:`Soles`) are at ``x_kq`` in frame ``k``.
Their height above the ground is

1. ``h_kq = up · x_kq - s_1 (e_1 · x_kq) - s_2 (e_2 · x_kq) - c_q``

with ``up`` the mean upright direction of the person, ``e_1`` and ``e_2`` at right angles to it, the
slopes ``s``, and a level ``c`` for heels and another for balls, because shoes have heels. Each
point stands or swings:

2. ``p(h) = w t(h / σ) / σ + (1 - w) σ⁺(h / σ) e^(-max(h, 0) / λ) / λ``

with Student's ``t``, the share ``w`` of the time that feet stand, the unevenness ``σ`` of the
ground and the poses, the mean lift ``λ`` of swinging feet, and the logistic function ``σ⁺``.
``s``, ``c``, ``w``, ``σ`` and ``λ`` maximise the likelihood of the video's points (expectation
maximisation). Without one ground plane, as on stairs, ``σ`` is large, and the term weak. With
``r_kq`` the probability that a point stands, poses cost

3. ``E = -Σ_kq log p(h_kq) / m + Σ_kq r_k-1,q r_kq r_k+1,q cost(x_k-1,q - 2 x_kq + x_k+1,q)``

In it ``m`` frames count as one, and ``cost`` is eq. 5 of :mod:`gva_mi.prior.process`. Standing
points may slide at constant velocity, as on a turntable: a penalty on the steps themselves would
stop that turn. How much steps may change is estimated from their motion across the camera's view,
which images show well.
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
from gva_mi.prior.error_model import STUDENT_DOF, STUDENT_PEAK
from gva_mi.prior.process import EXCURSION_FRAMES, excursions, mean_square, step_cost

SOLE_HEIGHT = 0.012  # metres above the lowest vertex; chosen: what still touches the ground
CORRELATED_FRAMES = 6.0  # m of eq. 3: errors of heights are correlated. Chosen, as for angles
SLOPE_SIGMA = 0.15  # of the slopes s; chosen: how far people are from upright on average
HEEL_SIGMA = 0.015  # metres, of the difference between the levels c; chosen: heels of usual shoes
SMALLEST_UNEVENNESS, LARGEST_UNEVENNESS = 0.004, 0.08  # metres, range of σ; by eye
SMALLEST_LIFT = 0.05  # metres, least λ; chosen: a swinging foot clears the ground
SMALLEST_SHARE = 0.05  # least share of standing points, and of swinging ones; chosen: neither is 0
SMALLEST_STEP_CHANGE = 0.001  # metres, least deviation of changes of steps; chosen: not zero
TURN_PER_FRAME = 0.2  # radians: by so much a step may bend in a frame; chosen: a turntable's turn
EM_ROUNDS = 40  # rounds of expectation maximisation; chosen by eye

_LEG_JOINTS = [JOINTS.index("pelvis")] + [
    JOINTS.index(f"{side}_{name}")
    for name in ("hip", "knee", "ankle", "foot")
    for side in ("left", "right")
]
_PLACES = {joint: k for k, joint in enumerate(_LEG_JOINTS)}
_LEG_PARENTS = tuple(_PLACES.get(PARENTS[joint], -1) for joint in _LEG_JOINTS)
_SOLE_JOINTS = ("ankle", "foot")  # move the heel and the ball


@dataclass(frozen=True)
class Soles:
    """The heels and balls of a person's feet, and the joints that move them."""

    joints: Tensor  # (9, 3) of pelvis and legs at rest, metres
    points: Tensor  # (4, 3) at rest, metres: heels, then balls, each left and right

    @staticmethod
    def of(rest: Rest, weights: Tensor) -> Soles:
        """Find the points in the T-pose, upright along y, by skinning weights (V, 55)."""
        vertices, points = rest.vertices.detach(), []
        low = vertices[:, 1].min() + SOLE_HEIGHT
        for kind in _SOLE_JOINTS:
            for side in ("left", "right"):
                joint = JOINTS.index(f"{side}_{kind}")
                sole = vertices[(weights[:, joint] > 0.5) & (vertices[:, 1] < low)]
                # A body without such vertices has a point below the joint.
                below = rest.joints.detach()[joint] * sole.new_tensor([1, 0, 1])
                below[1] = vertices[:, 1].min()
                points.append(sole.mean(0) if len(sole) else below)
        return Soles(rest.joints.detach()[_LEG_JOINTS], torch.stack(points))

    def places(self, rotations: Tensor, transl: Tensor) -> Tensor:
        """Return the points (n, 4, 3) in n poses, world, metres; differentiable."""
        maps = turn_joints(rotations[:, _LEG_JOINTS], self.joints, _LEG_PARENTS, transl)[1]
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
    """The ground plane of a video, and how its person stands on it.

    Attributes:
        soles: of the person.
        axes: (3, 3) rows ``up``, ``e_1``, ``e_2``, world.
        plane: (4,) ``s_1``, ``s_2``, and ``c`` of heels and of balls, metres.
        contact: ``σ``, ``w`` and ``λ``.
        square_change: (n - 2, 4) mean square change of each point's steps, square metres.
        three_stand: (n - 2, 4) product of the three ``r`` in eq. 3.
    """

    soles: Soles
    axes: Tensor
    plane: Tensor
    contact: ContactStats
    square_change: Tensor
    three_stand: Tensor

    @staticmethod
    @torch.no_grad()
    def under(soles: Soles, pose: Pose, times: Tensor, R_camera_world: Tensor) -> Ground:
        """Fit the ground to poses of n frames at ``times`` (n,)."""
        places = soles.places(pose.rotations, pose.transl)
        axes = _axes(pose)
        height = (places @ axes[0]).view(len(places), 2, 2)
        level = height.transpose(0, 1).flatten(1).quantile(0.2, dim=1)
        plane = torch.cat([level.new_zeros(2), level])
        start = ContactStats(LARGEST_UNEVENNESS / 2, 0.7, 2 * SMALLEST_LIFT)
        square = _square_change(places @ R_camera_world.T[:, :2], times)
        ground = Ground(soles, axes, plane, start, square, torch.ones_like(square))
        for _ in range(EM_ROUNDS):
            ground = ground._em_round(places)
        stands = ground.stands(places)
        return replace(ground, three_stand=stands[2:] * stands[1:-1] * stands[:-2])

    def energy(self, rotations: Tensor, transl: Tensor, times: Tensor) -> Tensor:
        """Return eq. 3; see :class:`gva_mi.prior.inference.PriorTerm`."""
        places = self.soles.places(rotations, transl)
        standing, swinging = self._probabilities(self.heights(places))
        changes = _steps(places, times).diff(dim=0)
        slid = self.three_stand * step_cost(changes, self.square_change)
        return -(standing + swinging).log().sum() / CORRELATED_FRAMES + slid.sum()

    def heights(self, places: Tensor) -> Tensor:
        """Return the heights (n, 4) of points (n, 4, 3), eq. 1, metres."""
        return places @ self.axes[0] - self._coefficients(places) @ self.plane

    def stands(self, places: Tensor) -> Tensor:
        """Return ``r`` (n, 4): the probability that each of the points (n, 4, 3) stands."""
        standing, swinging = self._probabilities(self.heights(places))
        return standing / (standing + swinging)

    def _coefficients(self, places: Tensor) -> Tensor:
        """Return the coefficients (n, 4, 4) of ``plane`` in eq. 1."""
        heels = places.new_tensor([[1, 0], [1, 0], [0, 1], [0, 1]])
        return torch.cat([places @ self.axes[1:].T, heels.expand(len(places), 4, 2)], dim=-1)

    def _probabilities(self, h: Tensor) -> tuple[Tensor, Tensor]:
        """Return the two terms of eq. 2, standing and swinging, each (n, 4)."""
        contact = self.contact
        t = (1 + (h / contact.spread).square() / STUDENT_DOF) ** (-(STUDENT_DOF + 1) / 2)
        swings = torch.sigmoid(h / contact.spread) * torch.exp(-h.clamp_min(0) / contact.lift)
        stands = contact.share * STUDENT_PEAK * t / contact.spread
        return stands, (1 - contact.share) * swings / contact.lift

    def _weights(self, h: Tensor, stands: Tensor) -> Tensor:
        """Return the weights (n, 4) of squared heights in the M-step."""
        return stands * (STUDENT_DOF + 1) / (STUDENT_DOF + (h / self.contact.spread).square())

    def _plane(self, places: Tensor) -> Tensor:
        """Return the MAP slopes and levels, given which points stand."""
        A = self._coefficients(places).double()
        weights = self._weights(self.heights(places), self.stands(places)).double()
        weights = weights / (CORRELATED_FRAMES * self.contact.spread**2)
        height = (places @ self.axes[0]).double()
        precision = A.new_zeros(4, 4)
        precision[:2, :2] = torch.eye(2) / SLOPE_SIGMA**2
        precision[2:, 2:] = (2 * torch.eye(2) - 1) / HEEL_SIGMA**2
        # If no point stands, the levels are undetermined.
        precision = precision + 1e-6 * torch.eye(4)
        curved = torch.einsum("nq,nqi,nqj->ij", weights, A, A) + precision
        pull = torch.einsum("nq,nqi,nq->i", weights, A, height)
        return torch.cholesky_solve(pull[:, None], torch.linalg.cholesky(curved))[:, 0].to(places)

    def _em_round(self, places: Tensor) -> Ground:
        """Return the ground after one round of expectation maximisation."""
        moved = replace(self, plane=self._plane(places))
        h = moved.heights(places)
        stands = moved.stands(places)
        of_ground = moved._weights(h, stands)
        spread = sqrt((of_ground * h.square()).sum() / stands.sum().clamp_min(1e-6))
        lift = ((1 - stands) * h.clamp_min(0)).sum() / (1 - stands).sum().clamp_min(1e-6)
        contact = ContactStats(
            spread=min(max(float(spread), SMALLEST_UNEVENNESS), LARGEST_UNEVENNESS),
            share=min(max(float(stands.mean()), SMALLEST_SHARE), 1 - SMALLEST_SHARE),
            lift=max(float(lift), SMALLEST_LIFT),
        )
        return replace(moved, contact=contact)


def _steps(places: Tensor, times: Tensor) -> Tensor:
    """Return the steps per frame (n - 1, 4, d) of points (n, 4, d)."""
    return places.diff(dim=0) / times.diff().to(places)[:, None, None]


def _square_change(aside: Tensor, times: Tensor) -> Tensor:
    """Return the mean square change of steps (n - 2, 4), from places (n, 4, 2) across the view."""
    steps = _steps(aside, times)
    changes = excursions(steps.diff(dim=0), EXCURSION_FRAMES)
    bends = TURN_PER_FRAME * (steps[1:] + steps[:-1]) / 2
    square = (changes.square() + bends.square()).mean(-1)
    # The larger one of heel and ball: one of them may move along the line of sight.
    of_foot = square.view(-1, 2, 2).amax(1).repeat(1, 2)
    return mean_square(of_foot, times[: len(square)].to(square)) + SMALLEST_STEP_CHANGE**2


def _axes(pose: Pose) -> Tensor:
    """Return the median upright direction and two directions at right angles, as rows (3, 3)."""
    upright = to_matrix(pose.rotations[:, 0])[:, :, 1]
    up = torch.nn.functional.normalize(upright.median(0).values, dim=0)
    other = torch.eye(3).to(up)[int(up.abs().argmin())]
    first = torch.nn.functional.normalize(torch.linalg.cross(up, other), dim=0)
    return torch.stack([up, first, torch.linalg.cross(up, first)])
