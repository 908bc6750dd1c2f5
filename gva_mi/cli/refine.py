"""The command ``gva-mi refine``: fit poses to normals and silhouettes (stage 2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from tyro.conf import Positional

from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.cli.arguments import Flat, Switch, body_of, warn_if_outside_masks
from gva_mi.cli.presets import Preset
from gva_mi.core.console import bar, listed, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room
from gva_mi.core.lock import folder_lock
from gva_mi.core.options import Weight, Workers
from gva_mi.core.provenance import versions
from gva_mi.core.workers import local_executor
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.ground_truth import GroundTruth, truth_of
from gva_mi.data.video import REFINED_POSES, Video, load_video
from gva_mi.fit.paper import REFINE
from gva_mi.pose.job import RefineOptions
from gva_mi.pose.prior.error_model import GROUPS, Stage1ErrorModel
from gva_mi.pose.prior.ground import ContactStats
from gva_mi.pose.prior.inference import AXES
from gva_mi.pose.refine import refine_all
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.pose.single_frame import Steps
from gva_mi.study.measure import Evaluation
from gva_mi.study.refinement import OVERLAYS, write_record


def refine(
    subjects: Positional[tuple[Path, ...]],
    options: Flat[SequenceOptions],
    *,
    preset: Preset = "default",
    steps: Steps = REFINE.steps,
    paper_prior: Weight = REFINE.prior,
    normals: Literal["perspective", "opengl", "icon", "none"] | None = None,
    workers: Workers = 1,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Refine the poses of videos with their normals and masks: stage 2 of the paper, Eq. 8.

    Writes poses_refined.npz, refinement.json and refinement.png into each subject's folder.

    Args:
        subjects: folders with video, masks, cameras, stage-1 poses; normals where there are some.
        options: options of the refinement.
        preset: paper: Eq. 8 as printed, frame by frame. It uses size, faces, silhouette (λ1, here
            5), step and largest-turn of the options, and the next two.
        steps: for each frame; of --preset paper.
        paper_prior: λ2, for one square radian; of --preset paper.
        normals: how the normals were made: as the video's camera sees them, or as ICON writes them
            (orthographic, y up); none: they are not used. Without it as normals.json says.
        workers: processes on this machine; any number gives the same bits.
        body: a body in SMPL-X's .npz format; without it the one that the first subject was
            prepared for, else the built-in body.
        overwrite: replace existing refined poses.
    """
    if not subjects:
        raise InputError("refine: give the folder of a subject, or of several")
    if preset == "paper" and options.hold_out_test:
        raise InputError(
            "refine: --hold-out-test needs all frames together, and --preset paper takes each alone"
        )
    shared = ("size", "faces", "silhouette", "height", "step", "largest_turn")
    own = {name: getattr(options, name) for name in shared}
    printed = replace(REFINE, **own, steps=steps, prior=paper_prior)
    model = load_body(body_of(subjects[0], body))
    for subject in subjects:
        if (subject / REFINED_POSES).exists():  # a missing subject is named by load_video
            require_room(subject / REFINED_POSES, overwrite)
        require_same_body(subject, model)
    videos = [load_video(subject, normals=normals) for subject in subjects]
    for video in videos:
        warn_if_outside_masks(video, model)
    with ExitStack() as held:
        for subject in subjects:
            held.enter_context(folder_lock(subject, "gva-mi refine"))
            require_room(subject / REFINED_POSES, overwrite)
        executor = held.enter_context(local_executor(workers))
        way = printed if preset == "paper" else options
        for evaluation in refine_videos(videos, model, way, executor, workers):
            for line in _summary(evaluation):
                say(line)


def refine_videos(
    videos: Sequence[Video],
    model: BodyModel,
    options: RefineOptions,
    executor: Executor | None = None,
    workers: int = 1,
) -> Iterator[Evaluation]:
    """Refine videos and write each result into its subject's folder as soon as it is ready."""
    truths = [_truth(video, model) for video in videos]
    for video in videos:
        if video.normals is None:
            say(f"{video.folder}: no normals, the refinement uses the silhouettes alone")
    with bar("refine") as progress:
        tasks = [(video, options) for video in videos]
        found = refine_all(tasks, model, progress, executor, workers)
        for video, truth, refined in zip(videos, truths, found, strict=True):
            for frame, reason in refined.kept.items():
                say(f"{video.folder}: frame {frame} keeps its stage-1 pose: {reason}")
            evaluation = Evaluation(video, model, options, refined, truth)
            write_record(evaluation, versions())
            yield evaluation


def describe_prior(
    noise: Mapping[str, Stage1ErrorModel], contact: ContactStats | None
) -> Iterator[str]:
    """Yield lines for the user on stage 1's errors and foot contact, if they were inferred."""
    if not noise:
        return
    turns = ", ".join(f"{name} {np.degrees(noise[name].size):.1f}°" for name in GROUPS)
    places = " and ".join(f"{1000 * noise[name].size:.0f} mm {name}" for name in AXES)
    moving = ", more in motion" if any(n.lag for n in noise.values()) else ""
    yield f"stage 1     errs by {turns}; by {places}{moving}"
    white = ", ".join(f"{name} {np.degrees(noise[name].white):.1f}°" for name in GROUPS)
    lasts = sorted({noise[name].memory for name in GROUPS})
    yield f"            white {white}; the rest lasts {lasts[0]:g} to {lasts[-1]:g} frames"
    if contact is not None:
        stands = f"soles stand {contact.share:.0%} of the time"
        yield f"ground      {stands}, within {1000 * contact.spread:.0f} mm of one plane"


def _truth(video: Video, model: BodyModel) -> GroundTruth | None:
    """Read the ground truth; one that cannot be used costs the figures and not the refinement."""
    try:
        return truth_of(video, model)
    except InputError as error:
        say(f"{error}; the refinement goes on and is not measured")
        return None


def _summary(evaluation: Evaluation) -> Iterator[str]:
    """Yield the lines that summarise a refinement and name its files."""
    folder, refined = evaluation.video.folder, evaluation.refined
    for limbs, frames in refined.swapped.items():
        yield f"{limbs:11} left and right were exchanged in frames {listed(frames)}"
    yield from describe_prior(refined.noise, refined.contact)
    yield from evaluation.measured.means.lines()
    yield f"poses: {folder / REFINED_POSES}; overlays: {folder / OVERLAYS}"
