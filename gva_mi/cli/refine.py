"""The command ``gva-mi refine``: fit poses to normals and silhouettes (stage 2)."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import Flat, Switch, body_of, warn_if_outside_masks
from gva_mi.cli.presets import Preset
from gva_mi.core.atomic import folder_lock
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room
from gva_mi.core.options import Weight, Workers
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.folder import REFINED_POSES
from gva_mi.data.video import load_video
from gva_mi.fit.paper import REFINE
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.pose.single_frame import Steps
from gva_mi.study.refinement import describe, refine_videos


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
        progress = held.enter_context(bar("refine"))
        way = printed if preset == "paper" else options
        for evaluation in refine_videos(videos, model, way, progress, workers):
            for line in describe(evaluation):
                say(line)
