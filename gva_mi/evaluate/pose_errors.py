"""Errors of estimated poses against the ground truth, frame by frame.

Errors are mean distances between points ``x`` of the estimated body and the same points ``y`` of
the true body, over a region ``R`` (whole body, hands, feet, fingers):

    1. e_R = mean_i |x_i - y_i|
    2. a_R = mean_i |(x_i - x_pelvis) - (y_i - y_pelvis)|            pelvis-aligned
    3. f   = mean_i |W_xᵀ (x_i - x_wrist) - W_yᵀ (y_i - y_wrist)|     fingers, W: wrist rotation
    4. d_j = z · (x_j - y_j)                                         z: the camera's axis

(2) removes the depth of the whole person, which one camera hardly sees. (3) removes everything the
arm does, and leaves the bending of the fingers and the size of the hand. (4) is signed: a positive
mean says that a limb is too far away.

If the true body is the fitted one, the points are its vertices. A foreign body has other vertices:
then the points are the joints: 22 of the body, and the joints of hands and feet.

A predicted covariance ``C`` of a joint's place (:mod:`gva_mi.refine.uncertainty`) is calibrated if
90 % of the true errors ``e`` lie within its 90 % region:

    5. eᵀ C⁻¹ e <= χ²_3(0.9)

All errors are taken on the bare body: the displacement for clothes is not part of a pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, ROOT_AND_BODY, WRISTS, Pose, Shape
from gva_mi.body.smplx import BodyModel, Posed
from gva_mi.core.cpu import one_torch_thread, sqrt
from gva_mi.prior.error_model import GROUPS
from gva_mi.refine.close_ups import hand_vertices
from gva_mi.refine.uncertainty import Uncertainty
from gva_mi.subject.ground_truth import GroundTruth

_FRAMES_AT_A_TIME = 16  # chosen: their vertices fit in memory


def _pair(joint: str) -> list[int]:
    return [JOINTS.index(f"{side}_{joint}") for side in ("left", "right")]


_ANKLES = _pair("ankle")
_FEET = _ANKLES + _pair("foot")


@torch.no_grad()
def pose_errors(
    body: BodyModel, found: tuple[Pose, Shape], truth: GroundTruth
) -> dict[str, Tensor]:
    """Measure estimated poses of the fitted body, some frames at a time.

    Returns:
        Errors (T,), millimetres, in the order of files: ``body``, ``hands``, ``feet`` (eq. 1), the
        same with ``_aligned`` (eq. 2), ``joints`` (eq. 1 over the 22 joints of the body),
        ``fingers`` (eq. 3), ``pelvis_depth``, ``ankles_depth``, ``wrists_depth`` (eq. 4, mean of
        both sides).
    """
    (pose, shape), points = found, _Points.of(body, truth.foreign)
    axes = torch.from_numpy(np.stack([c.T_camera_world[2, :3] for c in truth.cameras]))
    parts: list[dict[str, Tensor]] = []
    with one_torch_thread():
        for start in range(0, len(truth.pose), _FRAMES_AT_A_TIME):
            frames = slice(start, start + _FRAMES_AT_A_TIME)
            x = body(pose[frames], shape)
            y = truth.body(truth.pose[frames], truth.shape)
            parts.append(points.errors(x, y) | _depths(x, y, axes[frames].to(x.joints)))
    return {name: 1e3 * torch.cat([part[name] for part in parts]) for name in parts[0]}


REGION_RADIUS = 6.2514  # χ²_3(0.9): nine of ten squares of three normal numbers are smaller


@torch.no_grad()
def within_region(
    body: BodyModel, found: tuple[Pose, Shape], truth: GroundTruth, uncertainty: Uncertainty
) -> dict[tuple[str, str], Tensor]:
    """Compare true errors of the joints of the body with their predicted covariances.

    Returns:
        (T,) by region and metric: share of joints with eq. 5, pelvis-aligned, of each group of
        joints and of all (``joints``); and of all, root mean squares, mm, true and predicted.
    """
    pose, shape = found
    with one_torch_thread():
        x, y = _joints(body, pose, shape), _joints(truth.body, truth.pose, truth.shape)
    e, C = (x - x[:, :1]) - (y - y[:, :1]), uncertainty.aligned[:, 1 : ROOT_AND_BODY.stop]
    e = e[:, 1 : ROOT_AND_BODY.stop].to(C)
    inside = ((torch.linalg.solve(C, e) * e).sum(2) <= REGION_RADIUS).double()
    groups = {name: [j - 1 for j in joints] for name, joints in GROUPS.items()}
    groups = {name: joints for name, joints in groups.items() if name not in ("pelvis", "fingers")}
    groups["joints"] = list(range(e.shape[1]))
    shares = {
        (name, "in 90 % region"): inside[:, joints].mean(1) for name, joints in groups.items()
    }
    rms = lambda square: 1e3 * sqrt(square.mean(1))
    return shares | {
        ("joints", "rms, mm"): rms(e.square().sum(2)),
        ("joints", "predicted rms, mm"): rms(C.diagonal(dim1=2, dim2=3).sum(2)),
    }


def _joints(body: BodyModel, pose: Pose, shape: Shape) -> Tensor:
    """Return the joints (T, 55, 3), posed some frames at a time."""
    starts = range(0, len(pose), _FRAMES_AT_A_TIME)
    parts = (body(pose[start : start + _FRAMES_AT_A_TIME], shape) for start in starts)
    return torch.cat([part.joints for part in parts])


def means(errors: dict[str, Tensor]) -> dict[str, float]:
    """Average errors over the frames."""
    return {name: float(error.mean()) for name, error in errors.items()}


@dataclass(frozen=True)
class _Points:
    """Points that two bodies share, and the region of each."""

    vertices: bool  # the points are vertices, else joints
    regions: Tensor  # (3, N) body, hands, feet; rows sum to 1
    fingers: tuple[Tensor, Tensor]  # indices of the fingers' points, left and right

    @staticmethod
    def of(body: BodyModel, foreign: bool) -> _Points:
        weights = torch.eye(len(JOINTS)) if foreign else body.weights  # a joint follows itself
        whole = torch.ones(len(weights))
        if foreign:
            whole[ROOT_AND_BODY.stop :] = 0
        moved_by = lambda joints: weights[:, joints].sum(1) > 0.5
        regions = torch.stack([whole, hand_vertices(weights).float(), moved_by(_FEET).float()])
        left, right = (moved_by(hand).nonzero()[:, 0] for hand in (LEFT_HAND, RIGHT_HAND))
        return _Points(not foreign, regions / regions.sum(1, keepdim=True), (left, right))

    def _of(self, posed: Posed) -> Tensor:
        return posed.vertices if self.vertices else posed.joints

    def errors(self, x: Posed, y: Posed) -> dict[str, Tensor]:
        """Evaluate eq. 1 to 3, each (T,), metres."""
        apart = self._of(x) - self._of(y)
        aligned = apart - (x.joints[:, :1] - y.joints[:, :1])
        free, put = (d.norm(dim=2) @ self.regions.to(d).T for d in (apart, aligned))
        fingers = self._in_wrist_frame(x) - self._in_wrist_frame(y)
        names = [region + end for end in ("", "_aligned") for region in ("body", "hands", "feet")]
        found = dict(zip(names, (*free.T, *put.T), strict=True))
        found["joints"] = _joints_apart(x, y).norm(dim=2).mean(1)
        return found | {"fingers": fingers.norm(dim=2).mean(1)}

    def _in_wrist_frame(self, posed: Posed) -> Tensor:
        """Return the fingers' points (T, n, 3) relative to their wrist."""
        points, parts = self._of(posed), []
        for fingers, wrist in zip(self.fingers, WRISTS, strict=True):
            turn = posed.T_world_rest[:, wrist, :3, :3]
            parts.append((points[:, fingers] - posed.joints[:, [wrist]]) @ turn)
        return torch.cat(parts, 1)


def _joints_apart(x: Posed, y: Posed) -> Tensor:
    """Return the errors (T, 22, 3) of root and body; finger joints would outnumber them."""
    return (x.joints - y.joints)[:, ROOT_AND_BODY]


def _depths(x: Posed, y: Posed, axes: Tensor) -> dict[str, Tensor]:
    """Evaluate eq. 4, each (T,), metres; ``axes`` (T, 3) are the cameras'."""
    deep = torch.einsum("tjc,tc->tj", _joints_apart(x, y), axes)
    return {
        "pelvis_depth": deep[:, 0],
        "ankles_depth": deep[:, _ANKLES].mean(1),
        "wrists_depth": deep[:, WRISTS].mean(1),
    }
