"""Evidence from masks and normals: the data term of Eq. 8.

    1. L_data = L_normal + λ1 L_silhouette
    2. L_normal = Σ_known pixels |N - N_pred|_1 / 3 / area
    3. L_silhouette = Σ_pixels |S - S_pred| / area
    4. c log(1 + L_silhouette / c) in its place, if the mask may be much in error

with the normals ``N`` (H, W, 3) and the mask ``S`` (H, W) of the frame, and of the rendered body.
All terms are divided by the person's area in pixels, so that weights do not depend on size or
resolution. A frame without normals has eq. 3 alone, with a higher weight.

**Normals** are compared inside the mask alone; where the body exceeds it, eq. 3 counts. If ``N``
were zero there, thin parts that a mask misses would count twice, and hands would rather hide in
front of the trunk.

**Masks of a video** are made by a network. They miss a hand in front of wood of its colour, or have
a part of the background beside it. How much such a mask errs is not known. If all sizes of errors
from ``c`` upward are equally probable, its likelihood is eq. 4: a close-up that no pose explains
hardly pulls.

**Half the outline.** Masks are rendered with one ray through the centre of each pixel. Among the
pixels that the rendered outline crosses, those whose centre it covers differ from the frame's mask,
and pull with slope 1. The others agree with it, and the slope of ``|x|`` at 0 counts as 0. So the
derivative of eq. 3 is half of the true one, everywhere along the outline: a constant factor, which
λ1 includes. Squares would give the whole derivative, but Eq. 8 prints none. Within the soft edge of
a mask the slopes on the two sides of the outline, 1 and -1, cancel, and eq. 3 does not pull;
shrinking leaves edges that are soft for one pixel. The factor also holds for the outline's part of
eq. 2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.nn.functional import normalize

from gva_mi.splat import Camera
from gva_mi.subject.crop import (
    Extent,
    NoEvidence,
    ScaledCrop,
    bounds,
    gather,
    mask_extent,
    person_extent,
    points_extent,
)
from gva_mi.subject.video import FrameWithoutPicture, Video

SILHOUETTE_ALONE = 3.0  # factor on λ1 in frames without normals, by eye
EVIDENCE_CROP_MARGIN = 0.15  # on each side of the box around the person, share of it; by eye
_BODY_NAME = "its stage-1 body"  # how messages call the body that a camera does not see
_NORMAL_CHANNELS = torch.tensor([1.0, 1.0, 1.0, 0.0])  # which channels of a rendering are normals


@dataclass(frozen=True)
class MaskAndNormals:
    """Mask and normals of one frame, cropped to the person's surroundings and shrunk."""

    camera: Camera  # of the crop
    mask: Tensor  # (H, W) in [0, 1]
    normals: Tensor | None  # (H, W, 3) unit, zero outside the mask
    area: float  # of the person, pixels
    robust_scale: float | None = None  # c of eq. 4, share of the area; None: eq. 3

    @staticmethod
    def of(outline: FrameWithoutPicture, scale: float, points: Tensor) -> MaskAndNormals:
        """Crop a frame to a box around its mask and the stage-1 body, and shrink it.

        Args:
            outline: of the frame, as the video gives it.
            scale: pixels of the result per pixel of the video, at most 1; see
                :func:`common_scale`.
            points: (V, 3) world, the body in its stage-1 pose.

        Raises:
            NoEvidence: the mask is empty, or the camera does not see the body.
        """
        camera, corners = outline.camera, points.numpy().astype(np.float64)
        extent = person_extent(outline.mask, camera, corners, _BODY_NAME)
        crop = ScaledCrop.around(extent, camera, scale, EVIDENCE_CROP_MARGIN)
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
        """Crop to the mask and a body (V, 3), world, metres: nothing differs beyond."""
        size = np.array([self.camera.width, self.camera.height])
        try:
            extent = points_extent(body.numpy().astype(np.float64), self.camera, _BODY_NAME)
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
        if self.robust_scale is not None:
            of_silhouette = self.robust_scale * torch.log1p(of_silhouette / self.robust_scale)
        return SILHOUETTE_ALONE * silhouette * of_silhouette

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
        known = known.to(target) * _NORMAL_CHANNELS[-channels:]
        of_normals, of_mask = _Differences.apply(image, target, known)
        return of_normals / (3 * self.area), of_mask / self.area


def common_scale(
    video: Video, frames: Iterable[int], size: int, body_at: Callable[[FrameWithoutPicture], Tensor]
) -> float:
    """Return the scale at which all frames of a video are compared, at most 1.

    With one scale for all frames, a pixel has the same weight in each. The largest person among the
    frames gets ``size`` pixels on the longer side. A person's size is the smaller one of mask and
    stage-1 body, because a mask may have specks far from the person, and a body may be too near.

    Args:
        video: whose frames.
        frames: numbers of the frames that are used.
        size: pixels of the longer side of the largest person.
        body_at: the vertices (V, 3) of the body in a frame's stage-1 pose, world, metres.
    """

    def look(outline: FrameWithoutPicture) -> float:
        camera = outline.camera
        body = points_extent(body_at(outline).double().numpy(), camera, _BODY_NAME)
        low, high = (np.clip(x, 0, (camera.width, camera.height)) for x in (body.low, body.high))
        return min(Extent(low, high).longer, mask_extent(outline.mask).longer)

    found: dict[int, float] = {}
    gather(frames, video.absent, video.outlines, look, found)
    return min(1.0, size / max(found.values(), default=size))


class _Differences(torch.autograd.Function):
    """``Σ |x - y|`` of known normals and of the mask; ``x`` (H, W, 4 or 1) is the rendering.

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
