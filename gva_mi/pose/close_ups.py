"""Close-ups: hands and feet at the picture's own resolution, cut where the pose has them now.

At the scale at which a person is compared, a hand is a few pixels wide, and its silhouette tells
little of its fingers. Where the video has more pixels, it is asked for them:

1. The surroundings of the person are kept once, on a grid on which a hand of the body, at its usual
   distance, is ``hand_size`` pixels long; or on the video's own grid, where that is coarser.
2. A close-up is a box of that picture around the part's vertices ``P`` in the current pose, with
   half of the part's length more on each side. Nothing is computed but which pixels these are, so
   it is cut anew for each pose that is compared.
3. It is compared as the whole person is (:mod:`gva_mi.pose.evidence`), divided by the area in
   pixels that the part covers in the mean over all directions: for a convex surface ``A``, that is
   ``A / 4`` in square metres (Cauchy), times ``fx fy / z²``. So a hand seen edge-on counts no more
   than one seen flat, and one behind the back no more than one in front.

Whatever else is seen in a close-up, a sleeve or the trunk behind, is compared too: the whole mesh
is rendered. A part that is hidden gets no gradient.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Outline
from gva_mi.pose.crop import Box, Crop, Extent, person_extent
from gva_mi.pose.evidence import MARGIN, SHOWN, MaskAndNormals
from gva_mi.splat import Camera

BORDER = 0.5  # of a part's length, added on each side (2)
SMALLEST_SIDE = 8  # pixels of a close-up; of less a part is at the edge of the picture
GAIN = 1.25  # pixels of a close-up for one of the person's picture, at least; less gains nothing
UNIT = 127  # of a stored normal


@dataclass(frozen=True)
class FinePicture:
    """The surroundings of a person at the resolution of close-ups (1); in 8 bits, for videos are
    long."""

    camera: Camera  # of the part that was cut out
    mask: Tensor  # (H, W) uint8, 255 where the person is
    normals: Tensor | None  # (H, W, 3) int8, 127 times the unit vector; zero outside the mask

    @staticmethod
    def of(outline: Outline, scale: float, points: Tensor) -> FinePicture:
        """Cut a frame to its person, as the person's own evidence is cut.

        Args:
            outline: of the frame.
            scale: pixels of the result for one of the video, at most 1.
            points: (V, 3) world, the body in its stage-1 pose.

        Raises:
            NoEvidence: the mask is empty, or the body is not seen by the camera.
        """
        extent = person_extent(outline.mask, outline.camera, points.double().numpy(), SHOWN)
        crop = Crop.around(extent, outline.camera, scale, MARGIN)
        part = crop.cover(*outline.mask.shape)
        mask, normals = crop.shrink(outline.mask[part], part), outline.normals(part)
        if normals is not None:
            unit = torch.nn.functional.normalize(crop.shrink(normals, part), dim=-1)
            normals = (UNIT * unit * (mask > 0.5)[..., None]).round().to(torch.int8)
        mask = (255 * mask).round().to(torch.uint8)
        return FinePicture(crop.cut_camera(outline.camera), mask, normals)

    def cut(self, box: Box, area: float) -> MaskAndNormals:
        """The evidence in a box, whose losses are divided by an area in pixels."""
        normals = None
        if self.normals is not None:
            normals = torch.nn.functional.normalize(box.cut(self.normals).float(), dim=-1)
        return MaskAndNormals(
            box.cut_camera(self.camera), box.cut(self.mask).float() / 255, normals, area
        )


@dataclass(frozen=True)
class Part:
    """A hand or a foot."""

    name: str  # "hand" or "foot"
    vertices: Tensor  # (n,) which of the body's
    length: float  # metres, at rest
    area: float  # of its surface, square metres


class CloseUps:
    """Close-ups of the hands and feet of one body in the pictures of some frames."""

    def __init__(
        self, pictures: Mapping[int, FinePicture], body: BodyModel, weights: Mapping[str, float]
    ) -> None:
        """Look at the body's parts.

        Args:
            pictures: of frames by number; other frames have no close-ups.
            body: whose vertices will be given.
            weights: of a part's loss, by its name; parts of weight 0 are not looked at.
        """
        self._pictures = pictures
        self._parts = [(weights[p.name], p) for p in parts_of(body) if weights[p.name] > 0]

    def of(
        self, frame: int, vertices: Tensor, person: MaskAndNormals
    ) -> list[tuple[float, MaskAndNormals]]:
        """The close-ups of a frame with their weights, at most one for each part.

        Args:
            frame: its number.
            vertices: (V, 3) the body in its current pose, world, metres; not differentiated.
            person: the evidence of the whole person, whose picture holds all close-ups.
        """
        picture = self._pictures.get(frame)
        if picture is None:
            return []
        found = (
            (weight, self._of_part(picture, part, vertices, person.camera))
            for weight, part in self._parts
        )
        return [(weight, seen) for weight, seen in found if seen is not None]

    def _of_part(
        self, picture: FinePicture, part: Part, vertices: Tensor, whole: Camera
    ) -> MaskAndNormals | None:
        """Eq. 2 and 3; None where the part is out of the picture."""
        camera = picture.camera
        points = vertices[part.vertices].double().numpy()
        depth = points @ camera.T_camera_world[2, :3] + camera.T_camera_world[2, 3]
        if depth.min() <= 0:
            return None
        pixels, per_metre = camera.project(points), camera.fx * camera.fy / depth.mean() ** 2
        border = BORDER * part.length * per_metre**0.5
        extent = Extent(pixels.min(0) - border, pixels.max(0) + border)
        low, high = _seen_by(whole, camera)
        extent = Extent(np.clip(extent.low, low, high), np.clip(extent.high, low, high))
        if (extent.high - extent.low).min() < SMALLEST_SIDE:
            return None
        return picture.cut(
            extent.box(0, np.array([camera.width, camera.height])), part.area / 4 * per_metre
        )


def parts_of(body: BodyModel) -> list[Part]:
    """Hands and feet: what is moved by more than half by wrists and fingers, ankles and toes."""
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
            parts.append(Part(name, inside.nonzero()[:, 0], length, area))
    return parts


def close_up_scale(
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    cameras: Sequence[Camera],
    person_scale: float,
    hand_size: int,
) -> float | None:
    """The scale of :class:`FinePicture` (1); None where close-ups would show no more.

    Args:
        body: whose hands are seen.
        pose: T frames of stage 1.
        shape: of the person.
        cameras: of the T frames.
        person_scale: at which the whole person is compared.
        hand_size: pixels of a hand's length.
    """
    pelvis = (body.rest(shape).joints[0] + pose.transl).double().numpy()
    T = np.stack([camera.T_camera_world for camera in cameras])
    depth = (T[:, 2, :3] * pelvis).sum(1) + T[:, 2, 3]
    focal = np.array([camera.fx for camera in cameras])
    if not (depth > 0).any():
        return None
    hand = parts_of(body)[0].length * float(np.median((focal / depth)[depth > 0]))
    scale = min(1.0, hand_size / hand)
    return scale if scale >= GAIN * person_scale else None


def _seen_by(whole: Camera, camera: Camera) -> Sequence[np.ndarray]:
    """The corners, low and high (2,), of what a camera sees, in the pixels of another one."""
    scale = camera.fx / whole.fx
    low = np.array([camera.cx - scale * whole.cx, camera.cy - scale * whole.cy])
    return low, low + scale * np.array([whole.width, whole.height])
