"""How far found poses are from the true ones, frame by frame.

Errors are mean distances of points ``x`` of the found body from the same points ``y`` of the true
one, over a region ``R``: the whole body, the hands, the feet, the fingers,

    1. e_R = mean_i |x_i - y_i|
    2. a_R = mean_i |(x_i - x_pelvis) - (y_i - y_pelvis)|            "aligned"
    3. f   = mean_i |W_xᵀ (x_i - x_wrist) - W_yᵀ (y_i - y_wrist)|     fingers, W: turn of the wrist
    4. d_j = z · (x_j - y_j)                                         z: the camera's axis

(2) leaves out the depth of the whole person, which one camera hardly sees. (3) leaves out all that
the arm does: what is left is how the fingers are bent, and how large the hand is. (4) has a sign,
and its mean does not hide a limb that always leans one way: above zero is too far away.

Where the true body is the fitted one the points are its vertices. A foreign body has other ones;
then they are the joints that every body has, 22 of the body, and those of hands and feet, and the
surfaces are compared by the mean distance of each one's vertices from the other
(:mod:`gva_mi.pose.evaluation.surface_distance`), both ways:

    5. s_R = (mean_i d(y_i, found) + mean_i d(x_i, true)) / 2

All is measured on the bare body: the displacement for clothes is no part of a pose.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel, Posed
from gva_mi.data.truth import Truth
from gva_mi.pose.displacement import hand_vertices
from gva_mi.pose.evaluation.surface_distance import surface_distances
from gva_mi.threads import one_torch_thread

_BODY_JOINTS = 22
_SAMPLES = 500  # vertices of a region whose distance from the other surface is taken


def _pair(joint: str) -> list[int]:
    return [JOINTS.index(f"{side}_{joint}") for side in ("left", "right")]


_ANKLES, _WRISTS = _pair("ankle"), _pair("wrist")
_FEET = _ANKLES + _pair("foot")


@dataclass(frozen=True)
class PoseErrors:
    """Errors in T frames, each (T,), millimetres; None where a figure is not measured."""

    body: Tensor  # eq. 1
    hands: Tensor
    feet: Tensor
    body_aligned: Tensor  # eq. 2
    hands_aligned: Tensor
    feet_aligned: Tensor
    joints: Tensor  # eq. 1 of the 22 joints of the body
    joints_aligned: Tensor
    fingers: Tensor  # eq. 3
    pelvis_depth: Tensor  # eq. 4
    ankles_depth: Tensor  # of both in the mean
    wrists_depth: Tensor
    surface: Tensor | None = None  # eq. 5, of foreign bodies
    hands_surface: Tensor | None = None
    feet_surface: Tensor | None = None

    def means(self) -> dict[str, float]:
        """Means over the frames of what was measured, by name."""
        of_frames = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: float(x.mean()) for name, x in of_frames.items() if x is not None}

    def of(self, frames: list[int]) -> PoseErrors:
        """The errors in some of the frames."""
        some = lambda x: None if x is None else x[frames]
        return PoseErrors(*(some(getattr(self, field.name)) for field in fields(self)))


@torch.no_grad()
def pose_errors(
    body: BodyModel, found: tuple[Pose, Shape], truth: Truth, batch: int = 16
) -> PoseErrors:
    """Errors of found poses against the true ones, ``batch`` frames at a time.

    Args:
        body: the one that was fitted.
        found: its poses.
        truth: of the video.
        batch: frames that are posed together.
    """
    points = _Points.of(body, truth.foreign)
    axes = torch.from_numpy(np.stack([c.T_camera_world[2, :3] for c in truth.cameras]))
    parts: list[dict[str, Tensor]] = []
    with one_torch_thread():
        for start in range(0, len(truth.pose), batch):
            some = slice(start, start + batch)
            x = body(found[0][some], found[1])
            y = truth.body(truth.pose[some], truth.shape)
            part = points.errors(x, y) | _joint_errors(x, y, axes[some].to(x.joints))
            if truth.foreign:
                part |= _surface_errors((x.vertices, body), (y.vertices, truth.body))
            parts.append(part)
    whole = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    return PoseErrors(**{name: 1e3 * error for name, error in whole.items()})


@dataclass(frozen=True)
class _Points:
    """The points that two bodies share, and which region each belongs to."""

    vertices: bool  # or the joints
    regions: Tensor  # (3, N) body, hands, feet; rows sum to 1
    fingers: tuple[Tensor, Tensor]  # numbers of the points of the left and the right hand's

    @staticmethod
    def of(body: BodyModel, foreign: bool) -> _Points:
        # A joint is a point that follows itself alone.
        weights = torch.eye(len(JOINTS)) if foreign else body.weights
        whole = torch.ones(len(weights))
        if foreign:
            whole[_BODY_JOINTS:] = 0
        regions = torch.stack(
            [whole, hand_vertices(weights).float(), (weights[:, _FEET].sum(1) > 0.5).float()]
        )
        fingers = [
            (weights[:, hand].sum(1) > 0.5).nonzero()[:, 0] for hand in (LEFT_HAND, RIGHT_HAND)
        ]
        return _Points(not foreign, regions / regions.sum(1, keepdim=True), tuple(fingers))

    def _of(self, posed: Posed) -> Tensor:
        return posed.vertices if self.vertices else posed.joints

    def errors(self, x: Posed, y: Posed) -> dict[str, Tensor]:
        """Equations 1 to 3 (T,), metres."""
        apart = self._of(x) - self._of(y)
        aligned = apart - (x.joints[:, :1] - y.joints[:, :1])
        free, put = (d.norm(dim=2) @ self.regions.to(d).T for d in (apart, aligned))
        fingers = self._in_wrists_frame(x) - self._in_wrists_frame(y)
        names = ("body", "hands", "feet")
        return (
            dict(zip(names, free.T, strict=True))
            | dict(zip((f"{name}_aligned" for name in names), put.T, strict=True))
            | {"fingers": fingers.norm(dim=2).mean(1)}
        )

    def _in_wrists_frame(self, posed: Posed) -> Tensor:
        """The fingers' points (T, n, 3) as the hand itself has them."""
        points, parts = self._of(posed), []
        for fingers, wrist in zip(self.fingers, _WRISTS, strict=True):
            turn = posed.T_world_rest[:, wrist, :3, :3]
            parts.append((points[:, fingers] - posed.joints[:, [wrist]]) @ turn)
        return torch.cat(parts, 1)


def _joint_errors(x: Posed, y: Posed, axes: Tensor) -> dict[str, Tensor]:
    """Equations 1, 2 and 4 of joints (T,), metres.

    Args:
        x, y: the found and the true body.
        axes: (T, 3) where the camera looks.
    """
    apart = (x.joints - y.joints)[:, :_BODY_JOINTS]
    deep = torch.einsum("tjc,tc->tj", apart, axes)
    return {
        "joints": apart.norm(dim=2).mean(1),
        "joints_aligned": (apart - apart[:, :1]).norm(dim=2).mean(1),
        "pelvis_depth": deep[:, 0],
        "ankles_depth": deep[:, _ANKLES].mean(1),
        "wrists_depth": deep[:, _WRISTS].mean(1),
    }


def _surface_errors(
    found: tuple[Tensor, BodyModel], true: tuple[Tensor, BodyModel]
) -> dict[str, Tensor]:
    """Equation 5 (T,) by region, metres; of (T, V, 3) vertices and the body they belong to."""
    both = [(x.double().numpy(), body.faces.numpy(), _samples(body)) for x, body in (found, true)]
    names = ("surface", "hands_surface", "feet_surface")
    table = np.zeros((len(found[0]), len(names)))
    for (x, _, samples), (y, faces, _) in (both, both[::-1]):
        ends = np.cumsum([len(s) for s in samples])[:-1]
        every = np.concatenate(samples)
        for row, points, vertices in zip(table, x, y, strict=True):
            distances = surface_distances(points[every], vertices, faces)
            row += [0.5 * part.mean() for part in np.split(distances, ends)]
    return dict(zip(names, torch.from_numpy(table).T.float(), strict=True))


def _samples(body: BodyModel) -> list[np.ndarray]:
    """Numbers of vertices of body, hands and feet, evenly many of each."""
    regions = _Points.of(body, foreign=False).regions > 0
    every = [region.nonzero()[:, 0].numpy() for region in regions]
    return [v[np.linspace(0, len(v) - 1, min(len(v), _SAMPLES)).astype(int)] for v in every]
