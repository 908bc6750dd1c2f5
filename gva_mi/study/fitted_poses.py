"""Scores under poses that are fitted to the very pictures they are measured on, as GART reports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.data.video import Video
from gva_mi.fit.photometric import FITTED, PhotometricOptions, fit_poses
from gva_mi.study.evaluate import OF_VIDEO, SplitView, evaluate_views, views_of, with_trained_poses
from gva_mi.study.metrics import Metrics, PoseFit, aligned_views
from gva_mi.study.scores import Scorer
from gva_mi.study.similarity import similarity_to_truth

POSE_FIT_STEPS = 100  # at least; one step moves a pose by little
SEEN_BY_FIT = ("pictures", "masks")


def with_fitted_poses(
    metrics: Metrics,
    avatar: Avatar,
    video: Video,
    trained: Video,
    body: BodyModel,
    progress: Progress | None = None,
    scorer: Scorer | None = None,
) -> Metrics:
    """Add rows for frames under poses that are fitted to these very frames.

    Test frames start from the poses that follow from training, novel poses and views from the true
    ones in the avatar's world: the scores show the avatar, wherever its skeleton is inside it.

    Args:
        metrics: of the run.
        avatar: the fitted avatar.
        video: opened with the poses that the fit began with; they locate hands and face.
        trained: opened with the poses that the avatar was trained under.
        body: the fitted body model.
        progress: called after each step of the pose fit.
        scorer: without it, one with the networks that are found.
    """
    scorer = scorer or Scorer()
    starts = [with_trained_poses(view, trained) for view in views_of(video, OF_VIDEO[1:], body)]
    similarity = similarity_to_truth(avatar.rig, trained, body)
    if similarity is not None:
        novel = views_of(video, ("novel_pose", "novel_view"), body)
        starts += aligned_views(novel, similarity, avatar.rig, body)
    plans = []
    for group in _groups(starts):
        frames = sorted(frame for view in group for frame in view.frames)
        plans.append((group, frames, _pose_fit_options(len(frames))))
    steps = [len(frames) * options.passes for _, frames, options in plans]
    rows, kept, made_with, seconds = [], {}, {}, 0.0
    for done, (group, frames, options) in enumerate(plans):
        name, part = (
            group[0].split,
            part_of_progress(progress, sum(steps[:done]), steps[done], sum(steps)),
        )
        found = fit_poses(avatar, group[0].video, options, frames, part)
        posed = [v.through(lambda source, p=found.pose: replace(source, pose=p)) for v in group]
        rows += evaluate_views(avatar, posed, FITTED, scorer)
        kept |= {f"{name} {frame}": reason for frame, reason in found.kept.items()}
        made_with[name] = asdict(options)
        seconds += found.seconds_per_frame * len(frames)
    fitted = sum(len(frames) for _, frames, _ in plans)
    kinds = {"test" if view.split in OF_VIDEO else "novel" for view in starts}
    names = (f"{kind} {what}" for kind in sorted(kinds) for what in SEEN_BY_FIT)
    seen = metrics.protocol["seen"]
    seen = seen | {name: [*seen.get(name, []), FITTED] for name in names}
    return replace(
        metrics,
        rows=(*metrics.rows, *rows),
        protocol=metrics.protocol | {"seen": seen},
        pose_fit=PoseFit(made_with, kept, seconds / max(1, fitted)),
    )


def _groups(views: Sequence[SplitView]) -> list[list[SplitView]]:
    """Group views whose poses are fitted together: those of the video's own frames."""
    own = [view for view in views if view.split in OF_VIDEO]
    return [group for group in (own, *([v] for v in views if v.split not in OF_VIDEO)) if group]


def _pose_fit_options(frames: int) -> PhotometricOptions:
    """Return the options of ``track``, with more passes for the few frames of a test split."""
    usual = PhotometricOptions()
    steps_of_a_pass = max(1, math.ceil(frames / usual.batch))
    return replace(usual, passes=max(usual.passes, math.ceil(POSE_FIT_STEPS / steps_of_a_pass)))
