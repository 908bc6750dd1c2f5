"""Regions of a picture that metrics are taken on, besides the whole picture.

* **Person**: the bounding box of the mask, with a margin of :data:`MASK_BOX_MARGIN`. A metric of
  the whole picture depends on how much background there is.
* **Hands**: a square of :data:`HAND_SIDE` around wrist and finger joints. It counts if a quarter of
  the hand's vertices are visible, half of what a hand in front of the body shows, and if the square
  lies in the picture.
* **Face**: a square of :data:`FACE_SIDE` around jaw and eyes. It counts if the face looks toward
  the camera and the square lies in the picture.

Boxes do not depend on the avatar, so all avatars are compared on the same pixels: they come from
the ground-truth pose if there is one, and else from the video's pose.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch

from gva_mi.body.pose import EYES, HANDS, JAW_AND_EYES, JOINTS, WRISTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.mesh.mesh_scene import seen_vertices
from gva_mi.splat import Camera
from gva_mi.subject.crop import Box
from gva_mi.subject.ground_truth import truth_of
from gva_mi.subject.video import Video

MASK_BOX_MARGIN = 0.03  # share of the longer side of the mask's box; chosen: holds the outline
HAND_SIDE = 0.28  # metres, of a hand's box; chosen: holds an open hand
FACE_SIDE = 0.26  # metres, of the face's box; chosen: holds a head
SMALLEST_REGION_SIDE = 16  # pixels of a box, which the metrics' networks need
VISIBLE_SHARE = 0.25  # of a hand's vertices; chosen: half of what a hand in front shows

HEAD = JOINTS.index("head")

Detail = Literal["hands", "face"]


def person_box(mask: np.ndarray, margin: float = MASK_BOX_MARGIN) -> Box:
    """Return the box around a mask (H, W) that is not empty, inside the picture."""
    height, width = mask.shape
    rows, columns = (np.flatnonzero((mask > 0.5).any(axis)) for axis in (1, 0))
    more = round(margin * max(np.ptp(rows), np.ptp(columns)))
    left, right = _at_least(columns[0] - more, columns[-1] + 1 + more, width)
    top, bottom = _at_least(rows[0] - more, rows[-1] + 1 + more, height)
    return Box(left, top, right, bottom)


def box_around(camera: Camera, joints: np.ndarray, metres: float) -> Box | None:
    """Return a square around joints (n, 3), world; None if the picture's edge cuts it.

    Args:
        camera: of the picture.
        joints: in the middle, metres.
        metres: of a side, which is at least SMALLEST_REGION_SIDE pixels long.
    """
    R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
    depth = float((joints @ R.T + t)[:, 2].mean())
    if depth <= 0:
        return None
    u, v = camera.project(joints).mean(0)
    side = max(SMALLEST_REGION_SIDE, round(camera.fx * metres / depth))
    left, top = round(u - side / 2), round(v - side / 2)
    fits = left >= 0 and top >= 0 and left + side <= camera.width and top + side <= camera.height
    return Box(left, top, left + side, top + side) if fits else None


@dataclass(frozen=True)
class Details:
    """Poses that locate hands and face of the person in a video."""

    body: BodyModel
    pose: Pose
    shape: Shape
    cameras: list[Camera]
    _found: dict[int, list[tuple[Detail, Box]]] = field(default_factory=dict, init=False)

    @staticmethod
    def of(video: Video, body: BodyModel) -> Details:
        """Use the ground truth of a synthetic video, else the poses the video was opened with."""
        if (truth := truth_of(video, body)) is not None:
            return Details(truth.body, truth.pose, truth.shape, truth.cameras)
        return Details(body, video.pose, video.shape, video.cameras)

    def boxes(self, frame: int) -> list[tuple[Detail, Box]]:
        """Return the boxes of visible hands, and of a visible face, in a frame."""
        if frame not in self._found:
            self._found[frame] = list(self._boxes(frame))
        return self._found[frame]

    @torch.no_grad()
    def _boxes(self, frame: int) -> Iterator[tuple[Detail, Box]]:
        posed, camera = self.body(self.pose[frame], self.shape), self.cameras[frame]
        seen = seen_vertices(posed.vertices[0], self.body.faces, camera.position[None])[0]
        joints, weights = posed.joints[0].double().numpy(), self.body.weights
        for wrist, fingers in zip(WRISTS, HANDS.values(), strict=True):
            of_hand = weights[:, fingers].sum(1) + weights[:, wrist] > 0.5
            box = box_around(camera, joints[np.r_[wrist, fingers]], HAND_SIDE)
            if box is not None and seen[of_hand].float().mean() >= VISIBLE_SHARE:
                yield "hands", box
        looks = joints[EYES].mean(0) - joints[HEAD]
        box = box_around(camera, joints[JAW_AND_EYES], FACE_SIDE)
        if box is not None and looks @ (camera.position - joints[HEAD]) > 0:
            yield "face", box


def _at_least(low: int, high: int, size: int) -> tuple[int, int]:
    """Grow a span to the smallest side, inside the picture."""
    grown = max(0, SMALLEST_REGION_SIDE - (high - low))
    low, high = low - grown // 2, high + grown - grown // 2
    return max(0, int(low)), min(size, int(high))
