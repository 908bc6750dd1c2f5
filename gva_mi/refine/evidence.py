"""Evidence from masks and normals, also of hands and feet in close-ups: the data term of Eq. 8.

    1. L_data = L_normal + λ1 L_silhouette
    2. L_normal = Σ_known pixels |N - N_pred|_1 / 3 / area
    3. L_silhouette = Σ_pixels |S - S_pred| / area
    4. c log(1 + L_silhouette / c) in its place, where masks may err much

with the normals ``N`` (H, W, 3) and the mask ``S`` (H, W) of the frame, and those of the rendered
body. Normals are compared inside the mask alone; where the body exceeds it, eq. 3 counts. If ``N``
were zero there, thin parts that a mask misses would count twice, and hands would rather hide in
front of the trunk. A frame without normals has eq. 3 alone, with a higher weight. All terms are
divided by the person's area in pixels, so that weights do not depend on size or resolution.

Masks that a network made of a video miss a hand before wood of its colour, or have a part of the
background beside it. How much such a mask errs is not known. If all sizes from ``c`` upward are as
probable, its likelihood is eq. 4: a close-up that no pose explains hardly pulls.

Half the outline: masks are rendered with one ray through the centre of each pixel. Of the pixels
that the rendered outline crosses, those whose centre it covers differ from the frame's mask, and
pull with slope 1; the others agree with it, and the slope of ``|x|`` at 0 counts as 0. So the
derivative of eq. 3 is half of the true one, everywhere along the outline: a constant factor, which
λ1 includes. Squares would give the whole derivative, but Eq. 8 prints none. Within the soft edge of
a mask the slopes on the two sides of the outline, 1 and -1, cancel, and eq. 3 does not pull;
shrinking leaves edges that are soft for one pixel. The factor also holds for the outline's part of
eq. 2.

Close-ups show hands and feet at the video's own resolution, cropped around the current pose. At
the scale at which a person is compared, a hand is a few pixels wide, and its silhouette shows
little of its fingers. If the video has more pixels, they are used:

5. The surroundings of the person are stored once, on a grid on which a hand, at its usual distance,
   is :data:`HAND_SIZE` pixels long; or on the video's own grid if that is coarser.
6. A close-up is a box of that image around the part's vertices ``P`` in the current pose, with half
   of the part's length added on each side. It is cropped anew for each pose, which costs nothing.
7. It is compared as the whole person is, divided by the part's mean area in pixels over all view
   directions: ``A / 4`` in square metres for a convex surface ``A`` (Cauchy), times ``fx fy / z²``.
   So a hand counts the same, edge-on or flat.

The whole mesh is rendered, so whatever else a close-up shows, such as a sleeve or the trunk, is
compared too. A hidden part gets no gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.nn.functional import normalize

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, WRISTS, Pose, Shape
from gva_mi.body.skinning import finger_weights
from gva_mi.body.smplx import BodyModel
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera
from gva_mi.subject.cameras import depths
from gva_mi.subject.crop import (
    Box,
    Extent,
    NoEvidence,
    ScaledCrop,
    bounds,
    gather,
    mask_extent,
    person_extent,
    points_extent,
)
from gva_mi.subject.video import Outline, Video

ALONE = 3.0  # weight of a silhouette without normals
MARGIN = 0.15  # of the box around the person, added on each side
SHOWN = "its stage-1 body"
_NORMALS = torch.tensor([1.0, 1.0, 1.0, 0.0])  # which channels of a rendering are normals

FrameLoss = tuple[float, Tensor | None]  # and its gradient (V, 3) by the body, if it is needed
HAND_SIZE = 44  # pixels of a hand's length in close-ups, if the video has as many
BORDER = 0.5  # of a part's length, added on each side (6)
SMALLEST_SIDE = 8  # pixels of a close-up; below, a part is at the edge of the image
GAIN = 1.25  # pixels of a close-up per pixel of the person's image, at least; below nothing is won
UNIT = 127  # of a stored normal
CLEAR = 0.1  # c of eq. 4, for hands in the masks of videos: of a hand's area


@dataclass(frozen=True)
class MaskAndNormals:
    """The evidence of one frame, cropped to the person's surroundings and shrunk."""

    camera: Camera  # of the part that was cut out
    mask: Tensor  # (H, W) in [0, 1]
    normals: Tensor | None  # (H, W, 3) unit, zero outside the mask
    area: float  # of the person, pixels
    clear: float | None = None  # c of eq. 4, of the area; None: eq. 3

    @staticmethod
    def of(outline: Outline, scale: float, points: Tensor) -> MaskAndNormals:
        """Crop a frame to a box around its mask and the body's stage-1 vertices, and shrink it.

        Args:
            outline: of the frame, as the video gives it.
            scale: pixels of the result per pixel of the video, at most 1; see
                :func:`common_scale`.
            points: (V, 3) world, the body in its stage-1 pose.

        Raises:
            NoEvidence: the mask is empty, or the camera does not see the body.
        """
        camera, corners = outline.camera, points.numpy().astype(np.float64)
        extent = person_extent(outline.mask, camera, corners, SHOWN)
        crop = ScaledCrop.around(extent, camera, scale, MARGIN)
        part = crop.cover(*outline.mask.shape)
        mask = crop.shrink(outline.mask[part], part)
        normals = outline.normals(part)
        if normals is not None:
            # Means of unit vectors are shorter than 1. They are normalised, and dropped where the
            # mask covers less than half of the pixel.
            normals = normalize(crop.shrink(normals, part), dim=-1)
            normals = normals * (mask > 0.5)[..., None]
        return MaskAndNormals(crop.cut_camera(camera), mask, normals, float(mask.sum()))

    @cached_property
    def _extent(self) -> Extent:
        """Of the mask, however faint."""
        return Extent(*bounds(self.mask.numpy() > 0).reshape(2, 2))

    def around(self, body: Tensor) -> MaskAndNormals:
        """Return the part that shows the mask or a body (V, 3), world: beyond, nothing differs."""
        size = np.array([self.camera.width, self.camera.height])
        try:
            extent = points_extent(body.numpy().astype(np.float64), self.camera, SHOWN)
        except NoEvidence:
            return self
        box = self._extent.joined(Extent(extent.low - 1, extent.high + 1)).box(0, size)
        return replace(
            self,
            camera=box.cut_camera(self.camera),
            mask=box.cut(self.mask),
            normals=None if self.normals is None else box.cut(self.normals),
        )

    def loss(self, image: Tensor, silhouette: float) -> Tensor:
        """Return eq. 1 of a rendering (H, W, 4) of normals and mask.

        Args:
            image: as :meth:`gva_mi.mesh.mesh_scene.MeshScene.render` gives it; of a frame without
                normals perhaps the mask alone (H, W, 1).
            silhouette: λ1.
        """
        of_normals, of_silhouette = self._losses(image)
        if self.normals is not None:
            return of_normals + silhouette * of_silhouette
        if self.clear is not None:
            of_silhouette = self.clear * torch.log1p(of_silhouette / self.clear)
        return ALONE * silhouette * of_silhouette

    def normal_loss(self, image: Tensor) -> Tensor:
        """Return eq. 2 of a rendering (H, W, 4); zero for a frame without normals."""
        return self._losses(image)[0]

    def silhouette_loss(self, image: Tensor) -> Tensor:
        """Return eq. 3 of a rendering (H, W, 4); its derivative is half of the true one."""
        return self._losses(image)[1]

    def _losses(self, image: Tensor) -> tuple[Tensor, Tensor]:
        normals, channels = self.normals, image.shape[-1]
        if normals is None:
            normals = self.mask.new_zeros(*self.mask.shape, channels - 1)
        target = torch.cat([normals, self.mask[..., None]], dim=-1)
        known = normals.any(-1, keepdim=True)  # inside a mask they may be missing, too
        known = known.to(target) * _NORMALS[-channels:]
        of_normals, of_mask = _Differences.apply(image, target, known)
        return of_normals / (3 * self.area), of_mask / self.area


def common_scale(
    video: Video, frames: Iterable[int], size: int, body_at: Callable[[Outline], Tensor]
) -> float:
    """Return the scale at which all frames of a video are compared, at most 1.

    With one scale for all frames a pixel, and with it a weight, means the same in each. The largest
    person among the frames gets ``size`` pixels on the longer side. A person's size is the smaller
    one of mask and stage-1 body, because a mask may have specks far from the person, and a body may
    stand too close.

    Args:
        video: whose frames.
        frames: numbers of the frames that are used.
        size: pixels of the longer side of the largest person.
        body_at: the vertices (V, 3) of the body in a frame's stage-1 pose, world, metres.
    """

    def look(outline: Outline) -> float:
        camera = outline.camera
        body = points_extent(body_at(outline).double().numpy(), camera, SHOWN)
        low, high = (np.clip(x, 0, (camera.width, camera.height)) for x in (body.low, body.high))
        return min(Extent(low, high).longer, mask_extent(outline.mask).longer)

    found: dict[int, float] = {}
    gather(frames, video.absent, video.outlines, look, found)
    return min(1.0, size / max(found.values(), default=size))


def mean_of_losses(vertices: Tensor, losses: Callable[[Tensor], list[FrameLoss]]) -> Tensor:
    """Return the mean of frames' losses, differentiable in the vertices (B, V, 3).

    ``losses`` computes them, with their gradients if any is needed, from detached vertices.
    """
    return _MeanLoss.apply(vertices, losses)


def frame_loss(
    scene: MeshScene,
    body: Tensor,
    views: Sequence[tuple[float, MaskAndNormals]],
    silhouette: float,
    differentiated: bool,
) -> FrameLoss:
    """Return the sum of eq. 1 over a frame's weighted views, and its gradient by the body.

    The gradient is computed with the loss, while the scene shows the body: moving the mesh a second
    time would cost as much as a rendering. For the same reason all views are rendered together.

    Args:
        scene: in which the body is rendered.
        body: (V, 3) world, metres.
        views: the whole person and close-ups, with their weights.
        silhouette: λ1.
        differentiated: whether the gradient (V, 3) is needed; otherwise it is None.
    """
    (weight, person), *close_ups = views
    picture, views = person.camera, [(weight, person.around(body.detach())), *close_ups]
    with torch.set_grad_enabled(differentiated):
        body = body.detach().contiguous().requires_grad_(differentiated)
        normals = any(seen.normals is not None for _, seen in views)
        images = scene.render_crops(body, picture, [seen.camera for _, seen in views], normals)
        loss = sum(
            weight * seen.loss(image, silhouette)
            for (weight, seen), image in zip(views, images, strict=True)
        )
        gradient = torch.autograd.grad(loss, body)[0] if differentiated else None
    return float(loss.detach()), gradient


@dataclass(frozen=True)
class FinePicture:
    """A person's surroundings at the resolution of close-ups (5), in 8 bits to save memory."""

    camera: Camera  # of the part that was cut out
    mask: Tensor  # (H, W) uint8, 255 where the person is
    normals: Tensor | None  # (H, W, 3) int8, 127 times the unit vector; zero outside the mask
    of_video: bool = False  # whether the mask is a video's

    @staticmethod
    def of(outline: Outline, scale: float, points: Tensor, of_video: bool = False) -> FinePicture:
        """Crop a frame as :meth:`MaskAndNormals.of` does; ``of_video``: its mask is a video's."""
        fine = MaskAndNormals.of(outline, scale, points)
        normals = None if fine.normals is None else (UNIT * fine.normals).round().to(torch.int8)
        return FinePicture(
            fine.camera, (255 * fine.mask).round().to(torch.uint8), normals, of_video
        )

    def cut(self, box: Box, area: float, clear: float | None = None) -> MaskAndNormals:
        """Return the evidence in a box, its losses divided by an area in pixels."""
        normals = None
        if self.normals is not None:
            normals = normalize(box.cut(self.normals).float(), dim=-1)
        camera, mask = box.cut_camera(self.camera), box.cut(self.mask).float() / 255
        return MaskAndNormals(camera, mask, normals, area, clear)


@dataclass(frozen=True, eq=False)
class BodyPart:
    """A hand or a foot."""

    name: str  # "hand" or "foot"
    vertices: Tensor  # (n,) which of the body's
    length: float  # metres, at rest
    area: float  # of its surface, square metres


def close_ups(
    picture: FinePicture, parts: Mapping[BodyPart, float], vertices: Tensor, person: MaskAndNormals
) -> list[tuple[float, MaskAndNormals]]:
    """Return a frame's close-ups with their weights, at most one for each part.

    Args:
        picture: of the frame.
        parts: hands and feet, with the weights of their losses.
        vertices: (V, 3) the body in its current pose, world, metres; not differentiated.
        person: the evidence of the whole person, whose image contains all close-ups.
    """
    found = [(w, _close_up(picture, part, vertices, person.camera)) for part, w in parts.items()]
    return [(weight, seen) for weight, seen in found if seen is not None]


def _close_up(
    picture: FinePicture, part: BodyPart, vertices: Tensor, whole: Camera
) -> MaskAndNormals | None:
    """Return eq. 6 and 7; None if the part is outside what the camera ``whole`` sees."""
    camera = picture.camera
    points = vertices[part.vertices].double().numpy()
    depth = points @ camera.T_camera_world[2, :3] + camera.T_camera_world[2, 3]
    if depth.min() <= 0:
        return None
    pixels, per_metre = camera.project(points), camera.fx * camera.fy / depth.mean() ** 2
    border = BORDER * part.length * per_metre**0.5
    scale = camera.fx / whole.fx
    low = np.array([camera.cx - scale * whole.cx, camera.cy - scale * whole.cy])
    high = low + scale * np.array([whole.width, whole.height])
    ends = pixels.min(0) - border, pixels.max(0) + border
    extent = Extent(*(np.clip(end, low, high) for end in ends))
    if (extent.high - extent.low).min() < SMALLEST_SIDE:
        return None
    box = extent.box(0, np.array([camera.width, camera.height]))
    missed = picture.of_video and part.name == "hand"  # feet are in a video's masks
    return picture.cut(box, part.area / 4 * per_metre, CLEAR if missed else None)


def parts_of(body: BodyModel) -> list[BodyPart]:
    """Return hands and feet: what wrists and fingers, ankles and toes move by more than half."""
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
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    cameras: Sequence[Camera],
    person_scale: float,
) -> float | None:
    """Return the scale of :class:`FinePicture` (5); None if close-ups would show no more.

    Args:
        body, shape: the person.
        pose: T frames of stage 1.
        cameras: of the T frames.
        person_scale: at which the whole person is compared.
    """
    pelvis = (body.rest(shape).joints[0] + pose.transl).double().numpy()
    depth = depths(cameras, pelvis)
    focal = np.array([camera.fx for camera in cameras])
    if not (depth > 0).any():
        return None
    hand = parts_of(body)[0].length * float(np.median((focal / depth)[depth > 0]))
    scale = min(1.0, HAND_SIZE / hand)
    return scale if scale >= GAIN * person_scale else None


def hand_vertices(weights: Tensor) -> Tensor:
    """Return which vertices (V,) wrists and fingers move by more than half."""
    return finger_weights(weights) + weights[:, WRISTS].sum(1) > 0.5


class _Differences(torch.autograd.Function):
    """``Σ |x - y|`` of known normals and of the mask, by the rendering ``x`` (H, W, 4 or 1).

    All channels are compared in one go, because torch is slow at three of four.
    """

    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, y: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
        difference = x - y
        ctx.save_for_backward(difference, known)
        size = difference.abs()
        return (size * known).sum(), size[..., -1].sum()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, normals: Tensor, mask: Tensor) -> tuple[Tensor, None, None]:
        difference, known = ctx.saved_tensors
        slope = known * normals
        slope[..., -1] = mask
        return slope.mul_(difference.sign()), None, None


class _MeanLoss(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx, vertices: Tensor, losses: Callable[[Tensor], list[FrameLoss]]
    ) -> Tensor:
        found, gradients = zip(*losses(vertices.detach()), strict=True)
        if ctx.needs_input_grad[0]:
            ctx.save_for_backward(torch.stack(gradients) / len(found))
        return vertices.new_tensor(sum(found) / len(found))

    @staticmethod
    def backward(ctx: FunctionCtx, grad_loss: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return grad_loss * gradient, None
