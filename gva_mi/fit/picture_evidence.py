"""Picture evidence for poses: an avatar composited on a frame is compared with the frame.

For an avatar in a pose of one frame:

    1. P = C + (1 - A) I
    2. L = (|P - I| + λα |A - S| + λs (1 - SSIM(P, I))) · H W / Σ S

=============  ==================  =============================================================
symbol         code name           meaning
=============  ==================  =============================================================
C (H, W, 3)    ``image.color``     the render on black, which is what the avatar adds
A (H, W)       ``image.alpha``     how much of the picture the avatar covers
I (H, W, 3)    ``self.picture``    the picture, cut to the person's surroundings
S (H, W)       ``self.mask``       the mask; dividing by its sum makes weights independent of the
                                   person's size
=============  ==================  =============================================================

with ``|·|`` a mean over the image. If the picture were cut out by its mask instead, as in the
paper's Eq. 9, outlines and poses would follow the mask's errors: the loss falls, but the avatar
comes no closer to the person. Eq. 1 uses the mask only to say where an avatar should be.

Pictures keep their resolution. In smaller ones the avatar's outline differs from those it was
trained on, and poses would compensate in depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.core.options import Metres, Weight, Within, options_of
from gva_mi.data.crop import NoEvidence, person_extent
from gva_mi.data.pictures import in_8_bits
from gva_mi.data.video import Frame
from gva_mi.fit.faces import Face
from gva_mi.fit.renders import DRAWN
from gva_mi.fit.ssim import ssim
from gva_mi.pose.optimize import DescentOptions, Learn, PartFrames, Passes, PriorWeight
from gva_mi.pose.prior.anatomy import Anatomy
from gva_mi.splat import Camera, render

MARGIN = 0.1  # share of the box around the person, added on each side
SMALLEST_SIDE = 16  # pixels of that box


@options_of("track")
class PhotometricOptions(DescentOptions):
    """Options of photometric tracking."""

    passes: Passes = 10  # how often every frame is visited
    alpha: Weight = 0.5  # λα, weight of the avatar's outline against the mask
    ssim: Weight = 0.1  # λs, weight of 1 - SSIM
    learn: Learn = 3  # passes before the prior is fitted to the corrections
    prior_weight: PriorWeight = 0.001  # weight of the prior beside the pictures
    step: Metres = 0.0005  # metres that a joint moves the skin beyond it, in a first step
    translation_lr: Metres = 0.0003  # metres in a first step
    # Standard deviations of an expression in such a step; 0: jaw and expression stay as given.
    expression_lr: Annotated[float, Within(0, 1)] = 0.02
    part: PartFrames = 240  # frames fitted together; a longer video is cut into clips

    command: ClassVar[str] = "track"
    decay: ClassVar[float] = 0.1


@dataclass(frozen=True)
class PictureAndMask:
    """One frame, cut to the person, kept as 8 bits to save memory."""

    camera: Camera  # of this part
    picture: Tensor  # (H, W, 3) uint8
    mask: Tensor  # (H, W) uint8

    @staticmethod
    def of(frame: Frame, points: np.ndarray) -> PictureAndMask:
        """Cut a frame to the box around its mask and some points (N, 3) of the world.

        Raises:
            NoEvidence: the mask is empty, or the camera does not see the points.
        """
        extent = person_extent(frame.mask, frame.camera, points, "its avatar")
        box = extent.box(MARGIN, np.array([frame.camera.width, frame.camera.height]))
        if min(box.width, box.height) < SMALLEST_SIDE:
            raise NoEvidence("it shows too little of the person")
        return PictureAndMask(
            box.cut_camera(frame.camera),
            torch.from_numpy(in_8_bits(box.cut(frame.image))),
            torch.from_numpy(in_8_bits(box.cut(frame.mask))),
        )

    def loss(self, avatar: Avatar, pose: Pose, weights: PhotometricOptions) -> Tensor:
        """Return the loss of a pose of one frame (eq. 2)."""
        picture, mask = self.picture.float() / 255, self.mask.float() / 255
        image = render(avatar(pose), self.camera, DRAWN)
        over = image.color + (1 - image.alpha)[..., None] * picture
        loss = (over - picture).abs().mean()
        if weights.alpha:
            loss = loss + weights.alpha * (image.alpha - mask).abs().mean()
        if weights.ssim:
            loss = loss + weights.ssim * (1 - ssim(over, picture))
        return loss * mask.numel() / mask.sum()


class PictureEvidence:
    """Pictures of some frames under one avatar: a :class:`gva_mi.pose.optimize.Evidence`.

    The avatar is fixed, so frames share no unknowns; the leaves beside their poses are their faces.

    Attributes:
        face: corrections of jaw and expression.
    """

    soles: None = None
    distance_shown: bool = True  # the avatar's size shows it
    surface_known: bool = True  # the avatar is the surface
    unseen: Sequence[int] = ()

    def __init__(
        self,
        avatar: Avatar,
        seen: Mapping[int, PictureAndMask],
        options: PhotometricOptions,
        face: Face,
        arms: Tensor,
    ) -> None:
        """Compare poses with some frames, at least one, by number; ``face`` is of the same frames.

        ``arms`` (J,) are lever arms of the person's joints, metres.
        """
        self._avatar, self._seen, self._options = avatar, seen, options
        self.face, self._arms = face, arms
        self.frames = sorted(seen)
        self.camera = seen[self.frames[0]].camera
        self.anatomy = Anatomy.of(avatar.rig.joints)

    def loss(self, frames: Sequence[int], pose: Pose) -> Tensor:
        """Return the mean of eq. 2 over some frames in these poses, with their faces."""
        pose = self.face.corrected(pose, [self.frames.index(k) for k in frames])
        losses = [
            self._seen[k].loss(self._avatar, pose[i], self._options) for i, k in enumerate(frames)
        ]
        return torch.stack(losses).mean()

    @property
    def shared(self) -> Sequence[tuple[Tensor, float]]:
        """The leaves of the faces."""
        return self.face.leaves(self._arms, self._options)

    def enable_details(self) -> None:
        """Fit the prior of the faces to their corrections; pictures are complete from the start."""
        self.face = self.face.with_updated_prior(self.face.found())

    def energy(self) -> Tensor | float:
        """Return the energy of the faces."""
        return self._options.prior_weight * self.face.energy()
