"""Poses fitted to the pictures themselves: the photometric pass through the splatted avatar.

An avatar that does not change is a better judge of poses than a bare body, for it wears the
person's clothes and colours. All frames together descend on

    L = mean_k L_k(R_k exp(δ_k), t_k + τ_k) + E(δ, τ)

where ``L_k`` tells frame ``k`` from the avatar laid over it (:mod:`gva_mi.fit.picture_evidence`), and ``E``
holds the turns δ of all joints and the shifts τ to zero, and smooth in time
(:mod:`gva_mi.pose.corrections`, with the poses it starts from in the place of stage 1).

The poses to start from are those the avatar was trained under, or others of the same person: an
avatar made from one video tracks its person through another. Poses found so have seen their
pictures. Figures of test frames under them stand in a row of their own, where they are asked for.

A long video is cut into overlapping parts (:mod:`gva_mi.pose.clips`); what is looked for, no frame
shares with those far away.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import Rest
from gva_mi.data.video import Video
from gva_mi.errors import InputError
from gva_mi.fit.picture_evidence import Hidden, PictureWeights, Sight
from gva_mi.pose.clips import cut, join
from gva_mi.pose.corrections import Corrections
from gva_mi.pose.priors import FACE, held_levers, levers
from gva_mi.pose.vector_adam import VectorAdam
from gva_mi.threads import one_torch_thread

Progress = Callable[..., None]

FITTED = "poses fitted to the pictures"  # the name of the row of figures under such poses
DECAY = 0.1  # what is left of the learning rates at the end
BETAS = (0.9, 0.99)  # Adam's


@dataclass(frozen=True)
class PhotometricOptions:
    """How poses are fitted to the pictures."""

    passes: int = 10  # how often every frame is visited
    batch: int = 4  # frames of a step
    alpha: float = 0.5  # λα, of the avatar's outline against the mask
    ssim: float = 0.1  # λs, of 1 - SSIM
    prior: float = 0.03  # pull of the turns to where they started, for one square metre
    hold: float = 0.3  # pull of the shifts, for one square metre
    smooth: float = 3.0  # between neighbours' turns, for one square metre
    smooth_move: float = 30.0  # between neighbours' shifts, for one square metre
    jitter: float = 0.015  # metres between frames: less is no motion of a joint
    jitter_move: float = 0.01  # metres between frames: less is no motion of the person
    outlier: float = 0.005  # metres beyond which a jump between frames counts less
    reach: float = 1.0  # frames over which a step spreads to both sides
    step: float = 0.0005  # metres that a turned joint moves what hangs on it, in a first step
    largest_turn: float = 0.03  # radians in such a step; joints with short levers are held by it
    translation_lr: float = 0.0003  # metres in a step at the start
    part: int = 240  # frames fitted together; a longer video is cut into parts
    overlap: int = 16  # frames that a part shares with the next
    seed: int = 0  # of the order in which frames are visited

    def __post_init__(self) -> None:
        weights = ("alpha", "ssim", "prior", "hold", "smooth", "smooth_move", "reach")
        least = {"passes": 1, "batch": 1, "seed": 0} | dict.fromkeys(weights, 0)
        for name, smallest in least.items():
            found = getattr(self, name)
            if not found >= smallest:
                raise InputError(f"track: {name} must be at least {smallest}, got {found}")
        for name in ("jitter", "jitter_move", "outlier", "step", "largest_turn", "translation_lr"):
            if not getattr(self, name) > 0:
                raise InputError(f"track: {name} must be above 0, got {getattr(self, name)}")
        if not 0 <= 2 * self.overlap < self.part:
            found = f"overlap {self.overlap}, part {self.part}"
            raise InputError(f"track: overlap must be less than half a part, got {found}")

    @property
    def weights(self) -> PictureWeights:
        """Of the terms of ``L_k``."""
        return PictureWeights(self.alpha, self.ssim)


@dataclass(frozen=True)
class FittedPoses:
    """Poses after the photometric pass, and what is known of how they came about."""

    pose: Pose  # all frames of the video
    losses_before: Tensor  # (T,) L_k at the poses the fit started from; NaN where not looked at
    losses: Tensor  # (T,) the same at the fitted poses
    kept: dict[int, str]  # frames that keep the pose they had, and why
    seconds_per_frame: float  # of those that were looked at


def fit_poses(
    avatar: Avatar,
    video: Video,
    options: PhotometricOptions = PhotometricOptions(),  # noqa: B008 (frozen)
    frames: Sequence[int] | None = None,
    progress: Progress | None = None,
) -> FittedPoses:
    """Fit the poses of some frames to their pictures, seen through an avatar that does not change.

    The same options give the same poses to the bit.

    Args:
        avatar: of the person in the video.
        video: opened with the poses to start from.
        options: how.
        frames: numbers of those to fit, looked at and smoothed among themselves; None: all. The
            others are not looked at.
        progress: called as ``progress(done, total, loss=...)`` after every step.

    Returns:
        Poses of all frames. A frame that cannot be fitted keeps its pose and is listed in ``kept``:
        an absent one, an empty mask, an avatar out of view, or a loss that grew.

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
    with one_torch_thread():
        sights, kept = _look_at(video, resting, wanted)
        pose = _fit_parts(resting, video, sights, options, progress)
        before, after = (_losses(resting, p, sights, options) for p in (video.pose, pose))
    rotations, transl = video.pose.rotations.clone(), video.pose.transl.clone()
    for k in sights:
        if after[k] <= before[k]:
            rotations[k], transl[k] = pose.rotations[k], pose.transl[k]
        else:  # NaN, too
            kept[k] = f"its loss grew from {before[k]:.4f} to {after[k]:.4f}"
            after[k] = before[k]
    return FittedPoses(
        Pose(rotations, transl, video.pose.expression),
        before,
        after,
        dict(sorted(kept.items())),
        (time.perf_counter() - begin) / max(1, len(wanted)),
    )


def _look_at(
    video: Video, avatar: Avatar, wanted: Sequence[int]
) -> tuple[dict[int, Sight], dict[int, str]]:
    """What each frame shows, and the frames that show nothing."""
    sights = {}
    kept = {k: video.absent[k] for k in wanted if k in video.absent}
    for frame in video.frames(k for k in wanted if k not in kept):
        points = avatar(frame.pose).means.double().numpy()
        try:
            sights[frame.index] = Sight.of(frame, points)
        except Hidden as reason:
            kept[frame.index] = str(reason)
    return sights, kept


def _fit_parts(
    avatar: Avatar,
    video: Video,
    sights: dict[int, Sight],
    options: PhotometricOptions,
    progress: Progress | None,
) -> Pose:
    """The poses of all frames, those without a sight as they were."""
    parts = cut(len(video), options.part, options.overlap)
    seen = [{k - part.start: sights[k] for k in part if k in sights} for part in parts]
    steps = [options.passes * -(-len(frames) // options.batch) for frames in seen]
    found, done = [], 0
    for part, frames, count in zip(parts, seen, steps, strict=True):
        pose = video.pose[slice(part.start, part.stop)]
        if frames:
            tell = _within(progress, done, sum(steps)) if progress else None
            pose = _fit_together(avatar, pose, frames, options, tell)
        found.append(pose)
        done += count
    rotations, transl = join(parts, [p.rotations for p in found], [p.transl for p in found])
    return Pose(rotations, transl, video.pose.expression)


def _fit_together(
    avatar: Avatar,
    pose: Pose,
    sights: dict[int, Sight],
    options: PhotometricOptions,
    tell: Progress | None,
) -> Pose:
    """Descend on L over the frames that have a sight, a few of them a step."""
    generator = torch.Generator().manual_seed(options.seed)
    frames = sorted(sights)
    rig, camera = avatar.rig, sights[frames[0]].camera
    far = levers(Rest(rig.vertices, rig.joints), rig.weights, rig.parents)
    corrections = Corrections(pose, frames, camera, held_levers(far), options)
    turn = (options.step / far).clamp_max(options.largest_turn)[:, None]
    turn[FACE] = 0
    leaves = [corrections.turns, corrections.moves]
    adam = VectorAdam(leaves, [turn[..., None] / 3**0.5, options.translation_lr], BETAS)

    batches = -(-len(frames) // options.batch)
    total = options.passes * batches
    for step in range(total):
        if step % batches == 0:
            order = torch.randperm(len(frames), generator=generator).tolist()
        some = order[step % batches :: batches]
        posed = corrections.pose(some)
        losses = [
            sights[frames[k]].loss(avatar, posed[i], options.weights) for i, k in enumerate(some)
        ]
        loss = torch.stack(losses).mean() + corrections.energy()
        loss.backward()
        adam.step(DECAY ** (step / total))
        if tell is not None:
            tell(step + 1, total, loss=float(loss.detach()))

    rotations, transl = pose.rotations.clone(), pose.transl.clone()
    with torch.no_grad():
        found = corrections.pose(range(len(frames)))
    rotations[frames], transl[frames] = found.rotations, found.transl
    return Pose(rotations, transl, pose.expression)


def _within(progress: Progress, before: int, total: int) -> Progress:
    """Progress of one part as that of all."""
    return lambda done, _, **figures: progress(before + done, total, **figures)


@torch.no_grad()
def _losses(
    avatar: Avatar, pose: Pose, sights: dict[int, Sight], options: PhotometricOptions
) -> Tensor:
    """L_k of every frame, (T,); NaN where there is no sight."""
    losses = torch.full((len(pose),), torch.nan)
    for k, sight in sights.items():
        losses[k] = sight.loss(avatar, pose[k], options.weights)
    return losses
