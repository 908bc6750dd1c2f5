"""The steps of the study. Each reads a folder, writes a folder, and can be run alone.

::

    synth ──▶ subject/ ──▶ refine ──▶ subject/poses_refined.npz ──▶ fit ──▶ run/ ──▶ evaluate
                                                                            └──────▶ render

``demo`` runs them all. No output is replaced unless asked for.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tyro.conf import Positional

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, Shape, load_offsets, load_poses, save_poses
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.data.pictures import write_image, write_movie
from gva_mi.data.synthetic import SynthOptions, make_subject
from gva_mi.data.video import Video, load_cameras, load_video
from gva_mi.errors import InputError
from gva_mi.fit import checkpoint
from gva_mi.fit.evaluate import evaluate as evaluate_splits
from gva_mi.fit.evaluate import render_sequence
from gva_mi.fit.report import write_report
from gva_mi.fit.train import FitOptions
from gva_mi.fit.train import fit as fit_avatar
from gva_mi.pose.refine import RefineOptions
from gva_mi.pose.refine import refine as refine_poses

POSES, REFINED, REFINEMENT = "poses.npz", "poses_refined.npz", "refinement.json"
OVERLAYS, METRICS, REPORT = "refinement.png", "metrics.json", "report.html"
SUBJECT = "subject"  # where the demo's subject lies within the demo's folder

Progress = Callable[..., None]


@dataclass(frozen=True)
class DemoOptions:
    """How large the demo is; the defaults end within 8 minutes on 2 cores."""

    seed: int = 0  # of the subject, the refinement and the fit
    frames: int = 64  # of the video
    size: int = 400  # pixels, width and height
    steps: int = 2000  # of the fit
    no_refine: bool = False  # fit under the stage-1 poses, to see what the refinement is worth


def synth(
    out: Positional[Path],
    options: SynthOptions,
    *,
    body: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Make a synthetic subject: video, masks, normals, cameras, noisy poses, and the truth apart.

    Args:
        out: the subject's folder.
        options: what it is like.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
        overwrite: replace a subject that is there.
    """
    model = load_body(body)
    _clear(out, "synth.json", overwrite)
    with _bar("synth") as progress:
        make_subject(out, options, model, progress)
    _say(f"subject: {out}")


def refine(
    subject: Positional[Path],
    options: RefineOptions,
    *,
    body: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Refine the poses of a video with its normals and masks: stage 2 of the paper, Eq. 9.

    Writes poses_refined.npz, refinement.json and refinement.png into the subject's folder.

    Args:
        subject: a folder with video, masks, cameras, stage-1 poses; normals where there are some.
        options: of the refinement.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
        overwrite: replace refined poses that are there.
    """
    model = load_body(body)
    if (subject / REFINED).exists() and not overwrite:
        raise InputError(f"{subject / REFINED}: exists already; give --overwrite to replace it")
    video = load_video(subject)
    if not video.has_normals:
        _say(f"{subject}: no normals/, the refinement uses the silhouettes alone")
    with _bar("refine") as progress:
        refined = refine_poses(video, model, options, progress)
