"""Photometric tracking: poses fitted to the pictures through the splatted avatar.

A fixed avatar is a better judge of poses than a bare body because it has the person's clothes and
colours. All frames together descend (:mod:`gva_mi.refine.optimize`) on

    1. L = mean_k L_k(R_k exp(δ_k), t_k + τ_k) + E(δ, τ)

where ``E`` is the energy of the rotations δ of all joints and of the shifts τ under their prior
(:mod:`gva_mi.refine.corrections`, with the initial poses as its stage 1). Jaw and expression are
corrected along (:mod:`gva_mi.fit.faces`). ``L_k`` compares the avatar with the picture of a frame:

    2. P   = C + (1 - A) I
    3. L_k = (|P - I| + λα |A - S| + λs (1 - SSIM(P, I))) · H W / Σ S

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
comes no closer to the person. Eq. 2 uses the mask only to say where an avatar should be.

Initial poses are those the avatar was trained under, or others of the same person: an avatar from
one video tracks its person through another. Tracked poses are fitted to the pictures they are
evaluated on, so scores of test frames under them have a separate row.

Pictures of a tall person are shrunk first, to :data:`PERSON_PIXELS` of height or a little more:
poses are as good, and take half the time or less. A long video is cut into overlapping clips
(:mod:`gva_mi.refine.clips`), which are fitted separately because distant frames share no unknowns.

Tracking writes two files into the subject's folder::

    poses_photometric.npz   poses of all frames, and the displaced surface's offsets
    photometric.json        losses, frames that keep their pose, options, versions
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import AVATAR_SPLATTING, Avatar
from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import Rest
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.cpu import one_thread, one_torch_thread
from gva_mi.core.options import Metres, PythonOnly, Weight, Within, options_of
from gva_mi.core.spill_cache import SpillCache
from gva_mi.core.stamp import write_record
from gva_mi.core.tasks import Helpers
from gva_mi.fit.faces import Face
from gva_mi.fit.losses import ssim
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.clips import cut, join
from gva_mi.refine.frame_losses import with_gradient
from gva_mi.refine.optimize import (
    DescentOptions,
    Learn,
    PartFrames,
    Passes,
    PriorWeight,
    descend,
    worse_frames,
)
from gva_mi.refine.vector_adam import lever_arms
from gva_mi.splat import Camera, render
from gva_mi.subject.crop import NoEvidence, gather, person_extent
from gva_mi.subject.pictures import in_8_bits
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Frame, Video

PERSON_BOX_MARGIN = 0.1  # share of the box, added on each side; chosen: poses may move there
SMALLEST_PERSON_BOX_SIDE = 16  # pixels of that box; chosen: below it a picture says little


@options_of("track")
class PhotometricOptions(DescentOptions):
    """Options of photometric tracking."""

    passes: Passes = 10  # how often every frame is visited
    alpha: PythonOnly[Weight] = 0.5  # λα, weight of the avatar's outline against the mask
    ssim: PythonOnly[Weight] = 0.1  # λs, weight of 1 - SSIM
    learn: PythonOnly[Learn] = 3  # passes before the prior is fitted to the corrections
    prior_weight: PythonOnly[PriorWeight] = 0.001  # weight of the prior beside the pictures
    # Metres that a joint moves the skin beyond it, in a first step.
    step: PythonOnly[Metres] = 0.0005
    translation_lr: PythonOnly[Metres] = 0.0003  # metres in a first step
    # Standard deviations of an expression in such a step; 0: jaw and expression stay as given.
    expression_lr: PythonOnly[Annotated[float, Within(0, 1)]] = 0.02
    # Frames fitted together; a longer video is cut into clips.
    part: PythonOnly[PartFrames] = 240

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
        box = extent.box(PERSON_BOX_MARGIN, np.array([frame.camera.width, frame.camera.height]))
        if min(box.width, box.height) < SMALLEST_PERSON_BOX_SIDE:
            raise NoEvidence("it shows too little of the person")
        return PictureAndMask(
            box.cut_camera(frame.camera),
            torch.from_numpy(in_8_bits(box.cut(frame.image))),
            torch.from_numpy(in_8_bits(box.cut(frame.mask))),
        )

    def loss(self, avatar: Avatar, pose: Pose, weights: PhotometricOptions) -> Tensor:
        """Return the loss of a pose of one frame (eq. 3)."""
        picture, mask = self.picture.float() / 255, self.mask.float() / 255
        image = render(avatar(pose), self.camera, AVATAR_SPLATTING)
        over = image.color + (1 - image.alpha)[..., None] * picture
        loss = (over - picture).abs().mean()
        if weights.alpha:
            loss = loss + weights.alpha * (image.alpha - mask).abs().mean()
        if weights.ssim:
            loss = loss + weights.ssim * (1 - ssim(over, picture))
        return loss * mask.numel() / mask.sum()


class FramePose(NamedTuple):
    """The pose of one frame."""

    frame: int
    arrays: list[np.ndarray]  # rotations (1, 55, 3), transl (1, 3), expression (1, E)
    share: float | None  # of the frame in the loss of a step; None: no gradient is needed


class PictureLosses:
    """Losses of frames (eq. 3), computed in this process."""

    def __init__(
        self,
        record: dict[str, Any],
        seen: Mapping[int, PictureAndMask],
        options: PhotometricOptions,
    ) -> None:
        """Compare the avatar of a record with frames, by number."""
        self._avatar = Avatar.from_record(record).requires_grad_(False)
        self._seen, self._options = seen, options

    def __call__(self, poses: Sequence[FramePose]) -> list[tuple[float, list[np.ndarray]]]:
        """Return the loss of each pose, and the gradient of its share with respect to arrays."""
        return [self._loss(*pose) for pose in poses]

    def _loss(
        self, frame: int, arrays: list[np.ndarray], share: float | None
    ) -> tuple[float, list[np.ndarray]]:
        with torch.set_grad_enabled(share is not None):
            leaves = [torch.from_numpy(x).requires_grad_(share is not None) for x in arrays]
            loss = self._seen[frame].loss(self._avatar, Pose(*leaves), self._options)
            if share is None:
                return float(loss), []
            of_share = loss.new_tensor(share)
            gradient = torch.autograd.grad(loss, leaves, of_share, materialize_grads=True)
        return float(loss.detach()), [x.numpy() for x in gradient]


class PictureEvidence:
    """Evidence on the poses of a clip from its pictures, :class:`gva_mi.refine.optimize.Evidence`.

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
        losses: Callable[[Sequence[FramePose]], list[tuple[float, list[np.ndarray]]]],
        options: PhotometricOptions,
        face: Face,
        arms: Tensor,
    ) -> None:
        """Compare poses with some frames, at least one, by number; ``face`` is of the same frames.

        ``losses`` are :class:`PictureLosses`; ``arms`` (J,) are lever arms of the person's joints,
        metres.
        """
        self._losses, self._options = losses, options
        self.face, self._arms = face, arms
        self.frames = sorted(seen)
        self.camera = seen[self.frames[0]].camera
        self.anatomy = Anatomy.of(avatar.rig.joints)

    def loss(self, frames: Sequence[int], pose: Pose) -> Tensor:
        """Return the mean of eq. 3 over some frames in these poses, with their faces."""
        pose = self.face.corrected(pose, [self.frames.index(k) for k in frames])
        arrays = pose.rotations, pose.transl, pose.expression

        def mean(differentiated: bool) -> tuple[Tensor, list[Tensor]]:
            share = 1 / len(frames) if differentiated else None
            of_frame = lambda i: [x.detach()[i : i + 1].numpy() for x in arrays]
            found = self._losses([FramePose(k, of_frame(i), share) for i, k in enumerate(frames)])
            losses, gradients = zip(*found, strict=True)
            whole = lambda parts: torch.from_numpy(np.concatenate(parts))
            return pose.transl.new_tensor(losses).mean(), [
                whole(parts) for parts in zip(*gradients, strict=True)
            ]

        return with_gradient(mean, *arrays)

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


SHARED_LOSSES = 300  # of frames, from which helper processes pay; chosen by eye
HEIGHT_FRAMES = 16  # masks whose median says how tall the person is; chosen: enough for one
PERSON_PIXELS = 300  # height; chosen: poses that are fitted to a taller person are hardly better
FITTED = "poses fitted to the pictures"  # row of scores under such poses


@dataclass(frozen=True)
class FittedPoses:
    """Result of photometric tracking."""

    pose: Pose  # all frames of the video
    losses_before: Tensor  # (T,) L_k at the initial poses; NaN: frame not used
    losses: Tensor  # (T,) L_k at the fitted poses
    kept: dict[int, str]  # frames that keep their initial pose, and why
    seconds_per_frame: float  # of the frames used


def fit_poses(
    avatar: Avatar,
    video: Video,
    options: PhotometricOptions = PhotometricOptions(),  # noqa: B008 (frozen)
    frames: Sequence[int] | None = None,
    progress: Progress | None = None,
    helpers: Helpers | None = None,
) -> FittedPoses:
    """Fit the poses of the given frames to their pictures, seen through a fixed avatar.

    The result is reproducible to the bit.

    Args:
        avatar: of the person in the video.
        video: opened with the poses to start from.
        options: of the tracking.
        frames: numbers of the frames to fit; None: all. The others are not read.
        progress: called as ``progress(done, total, loss=...)`` after every step.
        helpers: processes that share the frames of a step; the bits do not depend on them.

    Returns:
        Poses of all frames. Frames that cannot be fitted keep their pose and are in ``kept``:
        absent ones, empty masks, an avatar out of view, or a loss that increased.

    Raises:
        ValueError: a frame that the video does not have.
    """
    wanted = sorted(set(range(len(video)) if frames is None else frames))
    if wanted and not 0 <= wanted[0] <= wanted[-1] < len(video):
        raise ValueError(
            f"fit_poses(): frames must lie in 0 to {len(video) - 1}, got {wanted[0]}, {wanted[-1]}"
        )
    begin = time.perf_counter()
    resting = Avatar.from_record(avatar.record()).requires_grad_(False)

    def look(frame: Frame) -> PictureAndMask:
        return PictureAndMask.of(frame, resting(frame.pose).means.double().numpy())

    with one_thread() if helpers else one_torch_thread():
        seen = SpillCache(video.folder)
        kept = gather(wanted, video.absent, shrunk_to_tall(video).frames, look, seen)
        pose = _fit_clips(resting, video.pose, seen, options, progress, helpers)
        before, after = (_losses(resting, p, seen, options) for p in (video.pose, pose))
    worse = worse_frames(seen, before, after, digits=4)
    after = torch.where(after <= before, after, before)
    taken = [k for k in seen if k not in worse]
    return FittedPoses(
        video.pose.with_frames(taken, pose[taken]),
        before,
        after,
        dict(sorted((kept | worse).items())),
        (time.perf_counter() - begin) / max(1, len(wanted)),
    )


def shrunk_to_tall(video: Video) -> Video:
    """Shrink a video as far as the person stays PERSON_PIXELS tall.

    The person's height is the median over HEIGHT_FRAMES masks.
    """
    seen = spread((k for k in range(len(video)) if k not in video.absent), HEIGHT_FRAMES)
    rows = [np.flatnonzero((outline.mask > 0.5).any(1)) for outline in video.outlines(seen)]
    height = np.median([row[-1] + 1 - row[0] for row in rows])
    return video.downscaled(max(1, int(height // PERSON_PIXELS)))


def _fit_clips(
    avatar: Avatar,
    pose: Pose,
    seen: SpillCache[PictureAndMask],
    options: PhotometricOptions,
    progress: Progress | None,
    helpers: Helpers | None,
) -> Pose:
    """Fit the poses of all frames, clip by clip."""
    rig = avatar.rig
    arms = lever_arms(Rest(rig.vertices, rig.joints), rig.weights, rig.parents)
    clips = cut(len(pose), options.part, options.overlap)
    seen_in = [seen.part(clip, clip.start) for clip in clips]
    steps = [options.passes * -(-len(frames) // options.batch) for frames in seen_in]
    parts = []
    for number, (clip, frames) in enumerate(zip(clips, seen_in, strict=True)):
        part = pose[clip.start : clip.stop]
        if frames:
            given = avatar.record(), dict(frames), options
            losses = (helpers or Helpers()).share(PictureLosses, *given)
            evidence = _evidence(avatar, part, frames, losses, arms, options)
            report = part_of_progress(progress, sum(steps[:number]), steps[number], sum(steps))
            part = descend(evidence, part, arms, options, report, try_uncorrected=True).pose
            with torch.no_grad():
                turned = part[evidence.frames]
                turned = evidence.face.corrected(turned, range(len(turned)))
            part = part.with_frames(evidence.frames, turned)
        parts.append(part)
    return join(clips, parts)


@torch.no_grad()
def _evidence(
    avatar: Avatar,
    pose: Pose,
    seen: Mapping[int, PictureAndMask],
    losses: Callable[[Sequence[FramePose]], list[tuple[float, list[np.ndarray]]]],
    arms: Tensor,
    options: PhotometricOptions,
) -> PictureEvidence:
    """Return the evidence of a clip.

    Its faces start as given or at the smoother MAP estimate, whichever fits the pictures better.
    """
    frames = sorted(seen)
    stage1 = Stage1Poses.of(pose, frames, seen[frames[0]].camera)
    map_estimate = Face.map_estimate(stage1) if options.expression_lr > 0 else Face(stage1, [])
    faces = map_estimate, map_estimate.zeroed()
    starts = [PictureEvidence(avatar, seen, losses, options, face, arms) for face in faces]
    return min(starts, key=lambda start: float(start.loss(frames, pose[frames])))


@torch.no_grad()
def _losses(
    avatar: Avatar, pose: Pose, seen: Mapping[int, PictureAndMask], options: PhotometricOptions
) -> Tensor:
    """Return L_k of every frame, (T,); NaN where it was not used."""
    losses = torch.full((len(pose),), torch.nan)
    for k, picture in seen.items():
        losses[k] = picture.loss(avatar, pose[k], options)
    return losses


TRACKED_POSES, TRACKING = "poses_photometric.npz", "photometric.json"


def write_tracking(
    video: Video,
    found: FittedPoses,
    options: PhotometricOptions,
    offsets: Tensor | None,
    sources: dict[str, Path],
) -> None:
    """Write both files atomically: a record never stands beside other poses.

    ``offsets`` (V, 3) displace the rest surface that goes with the poses, metres; ``sources`` are
    the files used: ``start``, the initial poses, and ``avatar``.
    """
    record = {
        "loss_start": float(found.losses_before.nanmean()),
        "loss": float(found.losses.nanmean()),
        "seconds_per_frame": found.seconds_per_frame,
        "kept": found.kept,
        **{name: str(path) for name, path in sources.items()},
        "options": asdict(options),
    }
    (video.folder / TRACKING).unlink(missing_ok=True)  # it describes the older poses
    path = video.folder / TRACKED_POSES
    save_poses(path, found.pose, video.shape, stage=2, offsets=offsets)
    write_record(video.folder / TRACKING, record)
