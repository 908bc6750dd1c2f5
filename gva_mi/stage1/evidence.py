"""What a video says of poses: landmarks, their depths, standing feet and upright people.

With points ``X`` in the camera's axes (:class:`gva_mi.stage1.posed_points.PosedPoints`) and errors
in units of their standard deviations (:mod:`gva_mi.observe.landmark_noise`), a frame costs

1. ``t_2(S_p (π(X_p) - x_p) / σ_p)``                             pixels of every landmark
2. ``t_1((gain (z_j - z_i) + bias - s (m_j - m_i)) / σ_z)``      depths of every bone
3. ``-log p(up · X_q + floor)``                                  soles stand or swing
4. ``t_2(lean_trunk / σ_u)``                                     the trunk is upright, on average
5. ``min_s t_2(lean_balance / σ_b, s / σ_s)``                    the body's mass is above the feet

divided by ``m``, the frames that count as one
(:func:`gva_mi.observe.landmark_noise.correlated_frames`). ``S`` is the whitening of landmark
errors, ``lean`` and ``s`` are defined in :class:`gva_mi.stage1.leaning.Leaning`, and ``p`` in eq. 2
of :mod:`gva_mi.prior.ground`. ``t_d`` is the cost of Student's t distribution in d dimensions,
``(ν + d)/2 log(1 + |r|²/ν)``.

The starting problem compares landmarks in metres instead of (1) and (2), because 3D points leave no
doubt which way a limb points:

6. ``|X_p - X_pelvis - s m_p|² / 2 σ_m²``
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from gva_mi.body.pose import JOINTS
from gva_mi.body.smplx import BodyModel
from gva_mi.observe.landmark_noise import LandmarkNoise, independent_points
from gva_mi.observe.rig import LandmarkRig
from gva_mi.prior.error_model import STUDENT_DOF, STUDENT_PEAK
from gva_mi.stage1.leaning import MASS_SHARES, SHARE_SIGMA, Leaning, upright_at_rest
from gva_mi.stage1.posed_points import PointSet, PosedPoints
from gva_mi.stage1.unknowns import Stage1State, Unknowns

METRIC_SIGMA = 0.1  # σ_m, metres; chosen by eye
TRUNK_SIGMA, BALANCE_SIGMA = 0.2, 0.05  # σ_u and σ_b, radians; chosen by eye
NEAREST_DEPTH = 0.2  # metres; nearer points are projected as if there; chosen: people are farther
# w, σ and λ of eq. 2 of gva_mi.prior.ground: share, metres, metres; chosen by eye.
STANDING_SHARE, GROUND_SIGMA, MEAN_LIFT = 0.7, 0.02, 0.12
SOLE_COUNT = 4  # points of the soles after the landmarks; then follow the joints that have mass


class EvidenceRows(NamedTuple):
    """One term in n frames: its energy, and weighted squares with the same slope."""

    energy: Tensor  # () nats
    residuals: Tensor  # (n, N)
    weights: Tensor  # (n, N)
    jacobian: Tensor | None  # (n, N, F + S); None if it was not needed


@dataclass(frozen=True)
class LandmarkEvidence:
    """Evidence of T frames for the unknowns of one problem.

    Attributes:
        unknowns: of the problem.
        points: P landmarks; then the soles and the joints of ``MASS_SHARES`` if the person travels.
        K: (3, 3) the camera, pixels.
        pixels: (T, P, 2) landmarks.
        precision: (T, P) ``1 / σ²``; zero without a landmark.
        whitening: (T, P, 2, 2) ``S``.
        bones: (K, 2) from and to, landmarks.
        gain: (K,).
        depths: (T, K) ``s (m_j - m_i) - bias``, metres.
        depth_precision: (T, K) ``1 / σ_z²``; zero without both landmarks.
        metric: (T, P, 3) ``s m`` of the body, metres; NaN elsewhere.
        correlated: (T,) ``m``, the frames that count as one.
        starting: whether (6) takes the place of all other terms.
    """

    unknowns: Unknowns
    points: PointSet
    K: Tensor
    pixels: Tensor
    precision: Tensor
    whitening: Tensor
    bones: Tensor
    gain: Tensor
    depths: Tensor
    depth_precision: Tensor
    metric: Tensor
    correlated: Tensor
    starting: bool = False

    def of(self, frames: slice) -> LandmarkEvidence:
        """Select frames."""
        names = (
            "pixels",
            "precision",
            "whitening",
            "depths",
            "depth_precision",
            "metric",
            "correlated",
        )
        return replace(self, **{name: getattr(self, name)[frames] for name in names})

    def posed(self, state: Stage1State) -> PosedPoints:
        """Pose the points; soles and joints with mass have no offsets."""
        offsets = pad(state.offsets, (0, 0, 0, len(self.points.rest) - len(state.offsets)))
        place = state.pelvis_position
        return PosedPoints.of(self.points, state.rotations, place, state.betas, offsets)

    def rows(self, state: Stage1State, derive: bool) -> Iterator[EvidenceRows]:
        """Yield the terms at a state of the same frames; with ``derive`` also their derivatives."""
        posed = self.posed(state)
        D = self._derivatives(posed) if derive else None
        if self.starting:
            yield self._metric(posed, D)
            return
        yield self._pixels(posed, D, state)
        yield self._depths(posed, D)
        if self.unknowns.travels:
            yield self._ground(posed, D, state)
            yield self._upright(posed, D, state)

    def _derivatives(self, posed: PosedPoints) -> Tensor:
        """Return the derivatives of points with respect to all columns, (n, P, 3, F + S)."""
        unknowns, F = self.unknowns, self.unknowns.per_frame
        n, P = posed.X.shape[:2]
        D = posed.X.new_zeros(n, P, 3, F + unknowns.shared)
        first = 3 * unknowns.travels
        if unknowns.travels:
            D[..., :3] = torch.eye(3, dtype=D.dtype)
        D[..., first:F] = posed.by_joints(unknowns.joints).flatten(3)
        offsets = F + unknowns.offsets_column
        if unknowns.betas:
            D[..., F : F + unknowns.betas] = posed.by_betas()[..., : unknowns.betas]
        A = posed.by_offsets()
        for k, p in enumerate(unknowns.offsets):
            D[:, p, :, offsets + 3 * k : offsets + 3 * k + 3] = A[:, p]
        return D

    def _t(self, r: Tensor, precision: Tensor, d: int) -> tuple[Tensor, Tensor]:
        """Return ``t_d`` of errors (n, N, d) with precision (n, N), and the weights of squares."""
        square = r.square().sum(-1) * precision / STUDENT_DOF
        correlated = self.correlated[:, None]
        energy = (STUDENT_DOF + d) / 2 * (torch.log1p(square) / correlated).sum()
        weights = (STUDENT_DOF + d) / (STUDENT_DOF * (1 + square)) * precision / correlated
        return energy, weights

    def _pixels(self, posed: PosedPoints, D: Tensor | None, state: Stage1State) -> EvidenceRows:
        """Return eq. 1."""
        P = self.pixels.shape[1]
        X, z = posed.X[:, :P], posed.X[:, :P, 2:].clamp_min(NEAREST_DEPTH)
        f = torch.stack([self.K[0, 0], self.K[1, 1]]) * state.log_focal_scale.exp()
        rays = X[..., :2] / z
        r = torch.where(self.precision[..., None] > 0, f * rays + self.K[:2, 2] - self.pixels, 0)
        r = (self.whitening @ r[..., None])[..., 0]
        energy, weights = self._t(r, self.precision, 2)
        weights = weights[..., None].expand(-1, -1, 2).flatten(1)
        if D is None:
            return EvidenceRows(energy, r.flatten(1), weights, None)
        of_points = D[:, :P]
        J = (of_points[:, :, :2] - rays[..., None] * of_points[:, :, 2:]) * (f / z)[..., None]
        if self.unknowns.camera:
            J[..., self.unknowns.per_frame + self.unknowns.camera_column] = f * rays
        return EvidenceRows(energy, r.flatten(1), weights, (self.whitening @ J).flatten(1, 2))

    def _depths(self, posed: PosedPoints, D: Tensor | None) -> EvidenceRows:
        """Return eq. 2."""
        i, j = self.bones.unbind(1)
        z = posed.X[..., 2]
        r = torch.where(self.depth_precision > 0, self.gain * (z[:, j] - z[:, i]) - self.depths, 0)
        energy, weights = self._t(r[..., None], self.depth_precision, 1)
        J = None if D is None else self.gain[:, None] * (D[:, j, 2] - D[:, i, 2])
        return EvidenceRows(energy, r, weights, J)

    def _metric(self, posed: PosedPoints, D: Tensor | None) -> EvidenceRows:
        """Return eq. 6."""
        P = self.pixels.shape[1]
        known = self.metric.isfinite()
        r = torch.where(known, posed.X[:, :P] - posed.places[:, :1] - self.metric, 0).flatten(1)
        weights = known.to(r).flatten(1) / (METRIC_SIGMA**2 * self.correlated[:, None])
        energy = (weights * r.square()).sum() / 2
        if D is None:
            return EvidenceRows(energy, r, weights, None)
        D = D[:, :P].clone()
        D[..., :3] = 0
        return EvidenceRows(energy, r, weights, D.flatten(1, 2))

    def _ground(self, posed: PosedPoints, D: Tensor | None, state: Stage1State) -> EvidenceRows:
        """Return eq. 3."""
        P = self.pixels.shape[1]
        X, (up, by_up) = posed.X[:, P : P + SOLE_COUNT], state.upward()
        h = X @ up + state.floor
        x = h / GROUND_SIGMA
        t = (1 + x.square() / STUDENT_DOF) ** (-(STUDENT_DOF + 1) / 2)
        standing = STANDING_SHARE * STUDENT_PEAK / GROUND_SIGMA * t
        below, falls = torch.sigmoid(-x), torch.exp(-h.clamp_min(0) / MEAN_LIFT)
        swinging = (1 - STANDING_SHARE) / MEAN_LIFT * (1 - below) * falls
        stands = standing / (standing + swinging)
        energy = -((standing + swinging).log() / self.correlated[:, None]).sum()
        curve = stands * (STUDENT_DOF + 1) / (STUDENT_DOF + x.square()) / GROUND_SIGMA**2
        slope = curve * h + (1 - stands) * ((h > 0) / MEAN_LIFT - below / GROUND_SIGMA)
        curve = curve + (1 - stands) * (below * (1 - below)) / GROUND_SIGMA**2 + 1.0
        rows = EvidenceRows(energy, slope / curve, curve / self.correlated[:, None], None)
        if D is None:
            return rows
        J = torch.einsum("nqcu,c->nqu", D[:, P : P + SOLE_COUNT], up)
        if self.unknowns.camera:
            first = self.unknowns.per_frame + self.unknowns.camera_column + 1
            J[..., first : first + 2] += X @ by_up
            J[..., first + 2] += 1
        return rows._replace(jacobian=J)

    def _upright(self, posed: PosedPoints, D: Tensor | None, state: Stage1State) -> EvidenceRows:
        """Return eq. 4 and 5."""
        first, (up, by_up) = self.pixels.shape[1] + SOLE_COUNT, state.upward()
        leaning = Leaning.of(posed.X[:, first:], up, BALANCE_SIGMA)
        costs = pad(leaning.share * BALANCE_SIGMA / SHARE_SIGMA, (1, 0))
        precision = up.new_tensor([TRUNK_SIGMA, BALANCE_SIGMA]).expand(len(costs), -1) ** -2
        r = leaning.lean
        energy, weights = self._t(torch.cat([r, costs[..., None]], 2), precision, 2)
        weights = weights[..., None].expand(-1, -1, 3).flatten(1)
        if D is None:
            return EvidenceRows(energy, r.flatten(1), weights, None)
        J = leaning.slopes(D[:, first:])
        if self.unknowns.camera:
            start = self.unknowns.per_frame + self.unknowns.camera_column + 1
            J[..., start : start + 2] += leaning.slopes_by_up(by_up)
        return EvidenceRows(energy, r.flatten(1), weights, J.flatten(1, 2))


def landmark_points(body: BodyModel, rig: LandmarkRig, whole_body: bool) -> PointSet:
    """Return the points of a rig; with ``whole_body`` also the soles and the joints with mass."""
    joints, rest, directions = rig.joints, rig.rest, rig.directions
    if whole_body:
        v = body.v_template
        moves = body.shape_directions[:, : 3 * len(v)].view(-1, 3, len(v))
        for side in ("left", "right"):
            for kind in ("ankle", "foot"):
                joint = JOINTS.index(f"{side}_{kind}")
                follows = body.weights[:, joint] > 0.5
                lowest = int(torch.where(follows, v[:, 1], torch.inf).argmin())
                joints = torch.cat([joints, torch.tensor([joint])])
                rest = torch.cat([rest, v[[lowest]]])
                directions = torch.cat([directions, moves[:, None, :, lowest]], 1)
        heavy = [JOINTS.index(name) for name in MASS_SHARES]
        growth = body.shape_joints.view(len(moves), -1, 3)
        places = upright_at_rest(torch.cat([body.j_template[None], growth])[:, heavy])
        parents = [max(int(body.parents[j]), 0) for j in heavy]
        joints, rest = torch.cat([joints, torch.tensor(parents)]), torch.cat([rest, places[0]])
        directions = torch.cat([directions, places[1:]], 1)
    return PointSet.of(body, joints, rest, directions)


def landmark_evidence(
    body: BodyModel,
    rig: LandmarkRig,
    unknowns: Unknowns,
    *,
    pixels: Tensor,
    metric: Tensor,
    noise: LandmarkNoise,
    K: Tensor,
    correlated: Tensor,
) -> LandmarkEvidence:
    """Collect the evidence of landmarks.

    Args:
        body: of the poses.
        rig: P landmarks on it.
        unknowns: of the problem.
        pixels: (T, P, 2) landmarks.
        metric: (T, P, 3) landmarks in metres, scaled to the body.
        noise: of the landmarks.
        K: (3, 3) of the camera.
        correlated: (T,) ``m``, the frames that count as one.
    """
    i, j = noise.bones.unbind(1)
    depths = metric[:, j, 2] - metric[:, i, 2] - noise.bias
    of_hand = torch.tensor(["_hand_" in name for name in rig.names])
    independent = independent_points(rig.names, group_hands=False)
    return LandmarkEvidence(
        unknowns=unknowns,
        points=landmark_points(body, rig, unknowns.travels),
        K=K.double(),
        pixels=pixels.double(),
        precision=noise.pixels.double() ** -2 * independent.double(),
        whitening=noise.whitening.double(),
        bones=noise.bones,
        gain=noise.gain.double(),
        depths=depths.double(),
        depth_precision=noise.depth.double() ** -2,
        metric=metric.double().where(~of_hand[None, :, None], torch.nan),
        correlated=correlated,
    )
