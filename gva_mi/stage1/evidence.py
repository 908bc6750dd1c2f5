"""What a video says of poses: landmarks, their depths, standing feet and upright people.

With points ``X`` in the camera's axes (:class:`PosedPoints`) and errors in units
of their standard deviations (:mod:`gva_mi.observe.landmark_noise`), a frame costs

1. ``t_2(S_p (π(X_p) - x_p) / σ_p)``                             pixels, of every landmark
2. ``t_1((gain (z_j - z_i) + bias - s (m_j - m_i)) / σ_z)``             depths, of every bone
3. ``-log p(up · X_q + floor)``                                  soles stand or swing
4. ``t_2(off_trunk / σ_u)``                                      the trunk is upright, on average
5. ``min_s t_2(off_balance / σ_b, s / σ_s)``                     the body's mass is above the feet

divided by ``m``, the frames that count as one
(:func:`gva_mi.observe.landmark_noise.correlated_frames`). ``S`` is the aspect of that noise,
``off`` and ``s`` are those of :class:`gva_mi.stage1.upright.Leaning`, ``t_d`` is that of
Student's t distribution in d dimensions, ``(ν + d)/2 log(1 + |r|²/ν)``, and ``p`` that of eq. 2 of
:mod:`gva_mi.prior.ground`.

To start with, landmarks in metres take the place of (1) and (2), because 3D points leave no doubt
which way a limb points:

6. ``|X_p - X_pelvis - s m_p|² / 2 σ_m²``
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.body.smplx import BodyModel
from gva_mi.core.cpu import sqrt
from gva_mi.observe.landmark_noise import LandmarkNoise, independent_points
from gva_mi.observe.rig import LandmarkRig
from gva_mi.prior.error_model import FREEDOM, T_PEAK
from gva_mi.stage1.normal_equations import Free, Stage1State
from gva_mi.stage1.upright import MASSES, SHARE_SPREAD, Leaning, above_one_another

METRIC = 0.1  # σ_m, metres
UPRIGHT, BALANCE = 0.2, 0.05  # σ_u and σ_b, radians
LEAST_DEPTH = 0.2  # metres; nearer points count as if they were there
STAND, UNEVEN, LIFT = 0.7, 0.02, 0.12  # w, σ, λ of (3); share, metres, metres
SOLES = 4  # points after the landmarks; then the joints that have mass
_COUNT = len(PARENTS)


class EvidenceRows(NamedTuple):
    """Errors of n frames: energy in nats, and weighted squares with the same slope."""

    energy: Tensor  # ()
    residuals: Tensor  # (n, N)
    weights: Tensor  # (n, N)
    jacobian: Tensor | None  # (n, N, F + S), if asked for


@dataclass(frozen=True)
class LandmarkEvidence:
    """Evidence of T frames for some unknowns.

    Attributes:
        free: the unknowns.
        points: P landmarks, then the soles and the joints of ``MASSES`` if the person travels.
        K: (3, 3) the camera, pixels.
        pixels: (T, P, 2) landmarks.
        precision: (T, P) ``1 / σ²``; zero without a landmark.
        aspect: (T, P, 2, 2) ``S``.
        bones: (K, 2) and ``gain`` (K,).
        deep: (T, K) ``s (m_j - m_i) - bias``, and ``deep_precision`` (T, K).
        metric: (T, P, 3) ``s m``, of the body alone; NaN elsewhere.
        correlated: (T,) ``m``, the frames that count as one.
        starting: whether (6) takes the place of (1) and (2).
    """

    free: Free
    points: PointSet
    K: Tensor
    pixels: Tensor
    precision: Tensor
    aspect: Tensor
    bones: Tensor
    gain: Tensor
    deep: Tensor
    deep_precision: Tensor
    metric: Tensor
    correlated: Tensor
    starting: bool = False

    def of(self, some: slice) -> LandmarkEvidence:
        """Select frames."""
        names = "pixels", "precision", "aspect", "deep", "deep_precision", "metric", "correlated"
        return replace(self, **{name: getattr(self, name)[some] for name in names})

    def rows(self, state: Stage1State, derive: bool) -> Iterator[EvidenceRows]:
        """Yield the terms for the frames of a state."""
        P = self.pixels.shape[1]
        offsets = torch.nn.functional.pad(state.offsets, (0, 0, 0, len(self.points.rest) - P))
        posed = PosedPoints.of(self.points, state.rotations, state.place, state.betas, offsets)
        D = self._derivatives(posed) if derive else None
        if self.starting:
            yield self._metric(posed, D)
            return
        yield self._pixels(posed, D, state)
        yield self._depths(posed, D)
        if self.free.travels:
            yield self._ground(posed, D, state)
            yield self._upright(posed, D, state)

    def _derivatives(self, posed: PosedPoints) -> Tensor:
        """Return those of all points by all columns, (n, P, 3, F + S)."""
        free, F = self.free, self.free.per_frame
        n, P = posed.X.shape[:2]
        D = posed.X.new_zeros(n, P, 3, F + free.shared)
        first = 3 * free.travels
        if free.travels:
            D[..., :3] = torch.eye(3, dtype=D.dtype)
        D[..., first:F] = posed.by_joints(free.joints).flatten(3)
        offsets = F + free.first_of_offsets
        if free.betas:
            D[..., F : F + free.betas] = posed.by_betas()[..., : free.betas]
        A = posed.by_offsets()
        for k, p in enumerate(free.offsets):
            D[:, p, :, offsets + 3 * k : offsets + 3 * k + 3] = A[:, p]
        return D

    def _t(self, r: Tensor, precision: Tensor, d: int) -> tuple[Tensor, Tensor]:
        """Return energy and weights of errors (n, N, d) with precision (n, N)."""
        square = r.square().sum(-1) * precision / FREEDOM
        correlated = self.correlated[:, None]
        energy = (FREEDOM + d) / 2 * (torch.log1p(square) / correlated).sum()
        weights = (FREEDOM + d) / (FREEDOM * (1 + square)) * precision / correlated
        return energy, weights

    def _pixels(self, posed: PosedPoints, D: Tensor | None, state: Stage1State) -> EvidenceRows:
        P = self.pixels.shape[1]
        X, z = posed.X[:, :P], posed.X[:, :P, 2:].clamp_min(LEAST_DEPTH)
        f = torch.stack([self.K[0, 0], self.K[1, 1]]) * state.focal.exp()
        rays = X[..., :2] / z
        r = torch.where(self.precision[..., None] > 0, f * rays + self.K[:2, 2] - self.pixels, 0)
        r = (self.aspect @ r[..., None])[..., 0]
        energy, weights = self._t(r, self.precision, 2)
        weights = weights[..., None].expand(-1, -1, 2).flatten(1)
        if D is None:
            return EvidenceRows(energy, r.flatten(1), weights, None)
        own = D[:, :P]
        J = (own[:, :, :2] - rays[..., None] * own[:, :, 2:]) * (f / z)[..., None]
        if self.free.camera:
            J[..., self.free.per_frame + self.free.first_of_camera] = f * rays
        return EvidenceRows(energy, r.flatten(1), weights, (self.aspect @ J).flatten(1, 2))

    def _depths(self, posed: PosedPoints, D: Tensor | None) -> EvidenceRows:
        i, j = self.bones.unbind(1)
        z = posed.X[..., 2]
        r = torch.where(self.deep_precision > 0, self.gain * (z[:, j] - z[:, i]) - self.deep, 0)
        energy, weights = self._t(r[..., None], self.deep_precision, 1)
        J = None if D is None else self.gain[:, None] * (D[:, j, 2] - D[:, i, 2])
        return EvidenceRows(energy, r, weights, J)

    def _metric(self, posed: PosedPoints, D: Tensor | None) -> EvidenceRows:
        P = self.pixels.shape[1]
        known = self.metric.isfinite()
        r = torch.where(known, posed.X[:, :P] - posed.places[:, :1] - self.metric, 0).flatten(1)
        weights = known.to(r).flatten(1) / (METRIC**2 * self.correlated[:, None])
        energy = (weights * r.square()).sum() / 2
        if D is None:
            return EvidenceRows(energy, r, weights, None)
        D = D[:, :P].clone()
        D[..., :3] = 0
        return EvidenceRows(energy, r, weights, D.flatten(1, 2))

    def _ground(self, posed: PosedPoints, D: Tensor | None, state: Stage1State) -> EvidenceRows:
        P = self.pixels.shape[1]
        X, (up, by_up) = posed.X[:, P : P + SOLES], state.upward()
        h = X @ up + state.floor
        x = h / UNEVEN
        on = STAND * T_PEAK / UNEVEN * (1 + x.square() / FREEDOM) ** (-(FREEDOM + 1) / 2)
        below = torch.sigmoid(-x)
        off = (1 - STAND) / LIFT * (1 - below) * torch.exp(-h.clamp_min(0) / LIFT)
        stands = on / (on + off)
        energy = -((on + off).log() / self.correlated[:, None]).sum()
        curve = stands * (FREEDOM + 1) / (FREEDOM + x.square()) / UNEVEN**2
        slope = curve * h + (1 - stands) * ((h > 0) / LIFT - below / UNEVEN)
        curve = curve + (1 - stands) * (below * (1 - below)) / UNEVEN**2 + 1.0
        rows = EvidenceRows(energy, slope / curve, curve / self.correlated[:, None], None)
        if D is None:
            return rows
        J = torch.einsum("nqcu,c->nqu", D[:, P : P + SOLES], up)
        if self.free.camera:
            first = self.free.per_frame + self.free.first_of_camera + 1
            J[..., first : first + 2] += X @ by_up
            J[..., first + 2] += 1
        return rows._replace(jacobian=J)

    def _upright(self, posed: PosedPoints, D: Tensor | None, state: Stage1State) -> EvidenceRows:
        first, (up, by_up) = self.pixels.shape[1] + SOLES, state.upward()
        leaning = Leaning.of(posed.X[:, first:], up, BALANCE)
        costs = torch.nn.functional.pad(leaning.share * BALANCE / SHARE_SPREAD, (1, 0))
        precision = up.new_tensor([UPRIGHT, BALANCE]).expand(len(costs), -1) ** -2
        r = leaning.off
        energy, weights = self._t(torch.cat([r, costs[..., None]], 2), precision, 2)
        weights = weights[..., None].expand(-1, -1, 3).flatten(1)
        if D is None:
            return EvidenceRows(energy, r.flatten(1), weights, None)
        J = leaning.slopes(D[:, first:])
        if self.free.camera:
            start = self.free.per_frame + self.free.first_of_camera + 1
            J[..., start : start + 2] += leaning.slopes_by_up(by_up)
        return EvidenceRows(energy, r.flatten(1), weights, J.flatten(1, 2))


def landmark_points(body: BodyModel, rig: LandmarkRig, more: bool) -> PointSet:
    """Return the points of a rig on its body; with ``more`` also soles and joints with mass."""
    joints, rest, directions = rig.joints, rig.rest, rig.directions
    if more:
        v = body.v_template
        moves = body.shape_directions[:, : 3 * len(v)].view(-1, 3, len(v))
        for side in ("left", "right"):
            for kind in ("ankle", "foot"):
                joint = JOINTS.index(f"{side}_{kind}")
                own = body.weights[:, joint] > 0.5
                lowest = int(torch.where(own, v[:, 1], torch.inf).argmin())
                joints = torch.cat([joints, torch.tensor([joint])])
                rest = torch.cat([rest, v[[lowest]]])
                directions = torch.cat([directions, moves[:, None, :, lowest]], 1)
        heavy = [JOINTS.index(name) for name in MASSES]
        growth = body.shape_joints.view(len(moves), -1, 3)
        places = above_one_another(torch.cat([body.j_template[None], growth])[:, heavy])
        parents = [max(int(body.parents[j]), 0) for j in heavy]
        joints, rest = torch.cat([joints, torch.tensor(parents)]), torch.cat([rest, places[0]])
        directions = torch.cat([directions, places[1:]], 1)
    return PointSet.of(body, joints, rest, directions)


def landmark_evidence(
    body: BodyModel,
    rig: LandmarkRig,
    free: Free,
    data: tuple[Tensor, Tensor, LandmarkNoise],
    K: Tensor,
    correlated: Tensor,
) -> LandmarkEvidence:
    """Collect the evidence of landmarks.

    Args:
        body, rig: P landmarks on a body.
        free: the unknowns.
        data: pixels (T, P, 2), scaled metres (T, P, 3), and their noise.
        K: (3, 3) of the camera.
        correlated: (T,) ``m``, the frames that count as one.
    """
    pixels, metric, noise = data
    i, j = noise.bones.unbind(1)
    deep = metric[:, j, 2] - metric[:, i, 2] - noise.bias
    of_hand = torch.tensor(["_hand_" in name for name in rig.names])
    double = lambda x: x.double()
    return LandmarkEvidence(
        free,
        landmark_points(body, rig, free.travels),
        double(K),
        double(pixels),
        double(noise.pixels) ** -2 * independent_points(rig.names, hands_together=False).double(),
        double(noise.aspect),
        noise.bones,
        double(noise.gain),
        double(deep),
        double(noise.depth) ** -2,
        double(metric).where(~of_hand[None, :, None], torch.nan),
        correlated,
    )


@dataclass(frozen=True)
class PointSet:
    """P points that hang on joints, and the joints at rest; float64.

    Attributes:
        joints: (P,) indices.
        rest: (P, 3), and ``directions`` (B, P, 3), metres.
        skeleton: (55, 3), and ``growth`` (B, 55, 3), metres: joints of the mean person, per beta.
        above: (P, 55) whether a joint moves a point.
    """

    joints: Tensor
    rest: Tensor
    directions: Tensor
    skeleton: Tensor
    growth: Tensor
    above: Tensor

    @staticmethod
    def of(body: BodyModel, joints: Tensor, rest: Tensor, directions: Tensor) -> PointSet:
        """Take points of a body: what they hang on (P,), (P, 3) and (B, P, 3)."""
        ancestors = torch.eye(_COUNT, dtype=torch.bool)
        for joint, parent in enumerate(PARENTS[1:], start=1):
            ancestors[joint] |= ancestors[parent]
        growth = body.shape_joints.view(-1, _COUNT, 3)
        numbers = (rest, directions, body.j_template, growth)
        return PointSet(joints, *(x.double() for x in numbers), ancestors[joints])


@dataclass(frozen=True)
class PosedPoints:
    """P points on a posed body in n frames, with derivatives by pose, shape and constant offsets.

    With the transform ``[A_d | t_d]`` of the joint ``d`` that a point hangs on, the joints' places
    ``p_j``, and the axes ``Ω_j`` about which unknowns turn joint ``j``,

    1. ``X = A_d (x + o) + t_d``
    2. ``∂X/∂r_j = -[X - p_j]× Ω_j``                            for ``j`` = ``d`` and its ancestors
    3. ``Ω_j = A_parent J_l(r_j)``,  ``J_l(r) = I + b [r]× + c [r]×²``; ``Ω_0 = A_0`` of the root
    4. ``∂X/∂β = A_d ∂x/∂β + Σ_j (A_parent - A_j) ∂J_j/∂β``        ``A_parent`` of the root: zero
    5. ``∂X/∂o = A_d``

    Joints change by what is added to their axis-angle; the root, which may turn all around, is
    rotated further instead: ``R_0 exp(δ)``. It is placed by its joint, so ``A_parent`` is zero
    there in (4).

    Attributes:
        points: what they are.
        X: (n, P, 3) metres.
        A: (n, 55, 3, 3) rotations of the joints.
        places: (n, 55, 3) of the joints, metres.
        rotations: (n, 55, 3).
    """

    points: PointSet
    X: Tensor
    A: Tensor
    places: Tensor
    rotations: Tensor

    @staticmethod
    def of(
        points: PointSet, rotations: Tensor, place: Tensor, betas: Tensor, offsets: Tensor
    ) -> PosedPoints:
        """Pose points (eq. 1).

        Args:
            points: P.
            rotations: (n, 55, 3) axis-angle.
            place: (n, 3) of the root joint, metres.
            betas: (B,).
            offsets: (P, 3) metres.
        """
        joints = points.skeleton + torch.einsum("b,bjc->jc", betas, points.growth)
        x = points.rest + torch.einsum("b,bpc->pc", betas, points.directions) + offsets
        T = turn_joints(rotations, joints[None], PARENTS, place - joints[0])[1]
        A, t = T[..., :3, :3], T[..., :3, 3]
        d = points.joints
        X = (A[:, d] @ x[:, :, None])[..., 0] + t[:, d]
        return PosedPoints(points, X, A, (A @ joints[:, :, None])[..., 0] + t, rotations)

    def by_joints(self, joints: Sequence[int]) -> Tensor:
        """Return eq. 2, (n, P, 3, F, 3), of F joints."""
        some = list(joints)
        r = self.rotations[:, some]
        parents = [PARENTS[j] for j in some]
        above = self.A[:, parents]  # of the root: overwritten below
        axes = above @ _left_jacobian(r)
        if 0 in some:
            axes[:, some.index(0)] = self.A[:, 0]
        arm = self.X[:, :, None] - self.places[:, None, some]
        arm = arm * self.points.above[:, some, None]
        moved = torch.linalg.cross(axes.mT[:, None], arm[:, :, :, None])  # rows: axes
        return moved.permute(0, 1, 4, 2, 3)

    def by_betas(self) -> Tensor:
        """Return eq. 4, (n, P, 3, B)."""
        it = self.points
        above = torch.cat([torch.zeros_like(self.A[:, :1]), self.A[:, list(PARENTS[1:])]], 1)
        moved = (above - self.A) @ it.growth.permute(1, 2, 0)
        moved = torch.einsum("pj,njcb->npcb", it.above.to(moved), moved)
        return moved + self.by_offsets() @ it.directions.permute(1, 2, 0)

    def by_offsets(self) -> Tensor:
        """Return eq. 5, (n, P, 3, 3)."""
        return self.A[:, self.points.joints]


def _left_jacobian(r: Tensor) -> Tensor:
    """Return ``J_l`` (..., 3, 3) of axis-angles (..., 3)."""
    square = r.square().sum(-1)[..., None, None]
    angle = sqrt(square) / torch.pi
    b = torch.sinc(angle / 2).square() / 2
    c = torch.where(square > 1e-8, (1 - torch.sinc(angle)) / square.clamp_min(1e-12), 1 / 6)
    zero = torch.zeros_like(r[..., 0])
    x, y, z = r.unbind(-1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    return torch.eye(3, dtype=r.dtype) + b * cross + c * (cross @ cross)
