"""Close-ups: evidence of hands and feet at the video's own resolution.

At the scale at which a person is compared, a hand is a few pixels wide, and its silhouette shows
little of its fingers. If the video has more pixels, they are used:

1. The surroundings of the person are stored once (:class:`FinePicture`), on a grid on which a hand
   at its usual distance is :data:`HAND_PIXELS` long, or on the video's own grid if it is coarser.
2. A close-up is a box of that picture around the part's vertices in the current pose, with half of
   the part's length added on each side. It is cropped anew for each pose, which costs nothing.
3. It is compared as the whole person is (:mod:`gva_mi.refine.image_evidence`), divided by the
   part's mean area in pixels over all view directions: ``A / 4`` in square metres for a convex
   surface ``A`` (Cauchy), times ``fx fy / z²``. So a hand counts the same, edge-on or flat.

The whole mesh is rendered, so everything else in a close-up is compared too, such as a sleeve or
the trunk. A hidden part gets no gradient.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, WRISTS, Pose, Shape
from gva_mi.body.skinning import finger_weights
from gva_mi.body.smplx import BodyModel
from gva_mi.refine.image_evidence import MaskAndNormals
from gva_mi.splat import Camera
from gva_mi.subject.cameras import depths
from gva_mi.subject.crop import Box, Extent
from gva_mi.subject.video import FrameWithoutPicture

HAND_PIXELS = 44  # length of a hand in close-ups, if the video has as many; chosen by eye
BORDER_SHARE = 0.5  # of a part's length, added on each side (2); by eye
SMALLEST_CLOSE_UP_SIDE = 8  # pixels; chosen: a smaller close-up is at the edge of the image
# Least ratio of a close-up's scale to that of the person's image. Chosen: below, it adds nothing.
SMALLEST_CLOSE_UP_GAIN = 1.25
STORED_UNIT = 127  # length of a stored normal, of int8
# c of eq. 4 of image_evidence, for hands in masks of videos, share of the area; chosen by eye.
HAND_ROBUST_SCALE = 0.1


class WeightedView(NamedTuple):
    """Evidence of the whole person or of a close-up, with the weight of its loss."""

    weight: float
    seen: MaskAndNormals


@dataclass(frozen=True)
class FinePicture:
    """A person's surroundings at the resolution of close-ups (1), in 8 bits to save memory."""

    camera: Camera  # of the crop
    mask: Tensor  # (H, W) uint8, 255 where the person is
    normals: Tensor | None  # (H, W, 3) int8, 127 times the unit vector; zero outside the mask
    of_video: bool = False  # whether a network made the mask from a video

    @staticmethod
    def of(
        outline: FrameWithoutPicture, scale: float, points: Tensor, of_video: bool = False
    ) -> FinePicture:
        """Crop a frame as :meth:`MaskAndNormals.of` does, and store it in 8 bits."""
        fine = MaskAndNormals.of(outline, scale, points)
        mask, normals = (255 * fine.mask).round().to(torch.uint8), None
        if fine.normals is not None:
            normals = (STORED_UNIT * fine.normals).round().to(torch.int8)
        return FinePicture(fine.camera, mask, normals, of_video)

    def cut(self, box: Box, area: float, robust_scale: float | None = None) -> MaskAndNormals:
        """Return the evidence in a box; its losses are divided by ``area``, pixels."""
        normals = None
        if self.normals is not None:
            normals = normalize(box.cut(self.normals).float(), dim=-1)
        camera, mask = box.cut_camera(self.camera), box.cut(self.mask).float() / 255
        return MaskAndNormals(camera, mask, normals, area, robust_scale)


@dataclass(frozen=True, eq=False)
class BodyPart:
    """A hand or a foot."""

    name: str  # "hand" or "foot"
    vertices: Tensor  # (n,) which of the body's
    length: float  # metres, at rest
    area: float  # of its surface, square metres


def close_ups(
    picture: FinePicture, parts: Mapping[BodyPart, float], vertices: Tensor, person: MaskAndNormals
) -> list[WeightedView]:
    """Return the close-ups of a frame, at most one for each part.

    Args:
        picture: of the frame.
        parts: hands and feet, with the weights of their losses.
        vertices: (V, 3) the body in its current pose, world, metres; not differentiated.
        person: the evidence of the whole person, whose image contains all close-ups.
    """
    found = [(w, _close_up(picture, part, vertices, person.camera)) for part, w in parts.items()]
    return [WeightedView(weight, seen) for weight, seen in found if seen is not None]


def _close_up(
    picture: FinePicture, part: BodyPart, vertices: Tensor, whole: Camera
) -> MaskAndNormals | None:
    """Return the close-up of a part; None if the camera ``whole`` does not see the part."""
    camera = picture.camera
    points = vertices[part.vertices].double().numpy()
    depth = camera.depths(points)
    if depth.min() <= 0:
        return None
    pixels, per_metre = camera.project(points), camera.fx * camera.fy / depth.mean() ** 2
    border = BORDER_SHARE * part.length * per_metre**0.5
    scale = camera.fx / whole.fx
    low = np.array([camera.cx - scale * whole.cx, camera.cy - scale * whole.cy])
    high = low + scale * np.array([whole.width, whole.height])
    ends = pixels.min(0) - border, pixels.max(0) + border
    extent = Extent(*(np.clip(end, low, high) for end in ends))
    if (extent.high - extent.low).min() < SMALLEST_CLOSE_UP_SIDE:
        return None
    box = extent.box(0, np.array([camera.width, camera.height]))
    missed = picture.of_video and part.name == "hand"  # feet are in a video's masks
    return picture.cut(box, part.area / 4 * per_metre, HAND_ROBUST_SCALE if missed else None)


def parts_of(body: BodyModel) -> list[BodyPart]:
    """Return hands and feet: vertices that wrist and fingers, or ankle and toes, move most."""
    parts = []
    for side, fingers in (("left", LEFT_HAND), ("right", RIGHT_HAND)):
        hand = [JOINTS.index(f"{side}_wrist"), *range(fingers.start, fingers.stop)]
        foot = [JOINTS.index(f"{side}_{name}") for name in ("ankle", "foot")]
        for name, joints in (("hand", hand), ("foot", foot)):
            inside = body.weights[:, joints].sum(1) > 0.5
            vertices = body.v_template[inside]
            a, b, c = body.v_template[body.faces[inside[body.faces].all(1)]].unbind(1)
            area = float(torch.linalg.cross(b - a, c - a).norm(dim=1).sum()) / 2
            length = float((vertices.amax(0) - vertices.amin(0)).max())
            parts.append(BodyPart(name, inside.nonzero()[:, 0], length, area))
    return parts


def close_up_scale(
    body: BodyModel, pose: Pose, shape: Shape, cameras: Sequence[Camera], person_scale: float
) -> float | None:
    """Return the scale of :class:`FinePicture` (1); None if close-ups would show no more.

    Args:
        body, shape: the person.
        pose: T frames of stage 1.
        cameras: of the T frames.
        person_scale: the scale at which the whole person is compared.
    """
    pelvis = (body.rest(shape).joints[0] + pose.transl).double().numpy()
    depth = depths(cameras, pelvis)
    focal = np.array([camera.fx for camera in cameras])
    if not (depth > 0).any():
        return None
    hand = parts_of(body)[0].length * float(np.median((focal / depth)[depth > 0]))
    scale = min(1.0, HAND_PIXELS / hand)
    return scale if scale >= SMALLEST_CLOSE_UP_GAIN * person_scale else None


def hand_vertices(weights: Tensor) -> Tensor:
    """Return which vertices (V,) wrists and fingers move by more than half."""
    return finger_weights(weights) + weights[:, WRISTS].sum(1) > 0.5
