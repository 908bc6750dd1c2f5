"""Photometric tracking: poses fitted to the pictures through the splatted avatar.

A fixed avatar is a better judge of poses than a bare body because it has the person's clothes and
colours. All frames together descend (:mod:`gva_mi.pose.optimize`) on

    L = mean_k L_k(R_k exp(δ_k), t_k + τ_k) + E(δ, τ)

where ``L_k`` compares frame ``k`` with the avatar in front of it
(:mod:`gva_mi.fit.picture_evidence`), and ``E`` is the energy of the rotations δ of all joints and
of the shifts τ under their prior (:mod:`gva_mi.pose.corrections`, with the initial poses as its
stage 1). Jaw and expression are corrected along (:mod:`gva_mi.fit.faces`).

Initial poses are those the avatar was trained under, or others of the same person: an avatar from
one video tracks its person through another. Tracked poses are fitted to the pictures they are
evaluated on, so scores of test frames under them have a separate row.

Pictures of a tall person are shrunk first, to :data:`TALL` pixels of height or a little more: poses
are as good, and take half the time or less. A long video is cut into overlapping clips
(:mod:`gva_mi.pose.clips`), which are fitted separately because distant frames share no unknowns.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import Rest
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.spill_cache import SpillCache
from gva_mi.core.threads import one_torch_thread
from gva_mi.data.crop import gather
from gva_mi.data.splits import spread
from gva_mi.data.video import Frame, Video
from gva_mi.fit.faces import Face
from gva_mi.fit.picture_evidence import PhotometricOptions, PictureAndMask, PictureEvidence
from gva_mi.pose.clips import cut, join
from gva_mi.pose.optimize import descend, worse_frames
from gva_mi.pose.optimizer import lever_arms
from gva_mi.pose.stage1 import Stage1

COUNTED = 16  # masks that tell how tall the person is in the pictures
TALL = 300  # pixels: poses that are fitted to a taller person are hardly better
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
) -> FittedPoses:
    """Fit the poses of some frames to their pictures, seen through a fixed avatar.

    The result is reproducible to the bit.

    Args:
        avatar: of the person in the video.
        video: opened with the poses to start from.
        options: of the tracking.
        frames: numbers of the frames to fit; None: all. The others are not read.
        progress: called as ``progress(done, total, loss=...)`` after every step.

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

    with one_torch_thread():
        seen = SpillCache(video.folder)
        kept = gather(wanted, video.absent, shrunk_to_tall(video).frames, look, seen)
        pose = _fit_clips(resting, video.pose, seen, options, progress)
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
    """Return the video with the smallest pictures in which the person is TALL pixels or more.

    The person's height is the median of some masks.
    """
    seen = spread((k for k in range(len(video)) if k not in video.absent), COUNTED)
    rows = [np.flatnonzero((outline.mask > 0.5).any(1)) for outline in video.outlines(seen)]
    height = np.median([row[-1] + 1 - row[0] for row in rows])
    return video.shrunk(max(1, int(height // TALL)))


def _fit_clips(
    avatar: Avatar,
    pose: Pose,
    seen: SpillCache[PictureAndMask],
    options: PhotometricOptions,
    progress: Progress | None,
) -> Pose:
    """Fit the poses of all frames, clip by clip."""
    rig = avatar.rig
    arms = lever_arms(Rest(rig.vertices, rig.joints), rig.weights, rig.parents)
    clips = cut(len(pose), options.part, options.overlap)
    seen_in = [seen.part(clip, clip.start) for clip in clips]
    steps = [options.passes * -(-len(frames) // options.batch) for frames in seen_in]
    found = []
    for number, (clip, frames) in enumerate(zip(clips, seen_in, strict=True)):
        part = pose[clip.start : clip.stop]
        if frames:
            evidence = _evidence(avatar, part, dict(frames), arms, options)
            report = part_of_progress(progress, sum(steps[:number]), steps[number], sum(steps))
            part = descend(evidence, part, arms, options, report, try_uncorrected=True).pose
            with torch.no_grad():
                turned = part[evidence.frames]
                turned = evidence.face.corrected(turned, range(len(turned)))
            part = part.with_frames(evidence.frames, turned)
        found.append(part)
    return join(clips, found)


@torch.no_grad()
def _evidence(
    avatar: Avatar,
    pose: Pose,
    seen: Mapping[int, PictureAndMask],
    arms: Tensor,
    options: PhotometricOptions,
) -> PictureEvidence:
    """Return the evidence of a clip. Its faces start as given or at the smoother MAP estimate,
    whichever fits the pictures better."""
    frames = sorted(seen)
    stage1 = Stage1.of(pose, frames, seen[frames[0]].camera)
    map_estimate = Face.map_estimate(stage1) if options.expression_lr > 0 else Face(stage1, [])
    starts = [
        PictureEvidence(avatar, seen, options, face, arms)
        for face in (map_estimate, map_estimate.zeroed())
    ]
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
