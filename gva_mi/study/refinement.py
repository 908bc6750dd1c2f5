"""Files that a refinement leaves in the subject's folder, and the ablation of its loss.

::

    subject/
      poses_refined.npz   all frames, and the offsets of the displaced surface: gva_mi.body.pose
      refinement.json     figures, frames that kept their stage-1 pose and why, options, versions
      refinement.png      the body over some frames: stage 1 above, refined below
      refinement.html     a page, if asked for

The other three always belong to the poses that are there. The paper refines test frames too, from
their own masks and normals: ``"test_frames": "seen"``. If they were ``"held out"``, their poses
follow from the other frames, and ``figures_by_split`` lists both. ``stage1_errors`` are the
inferred standard deviations of stage 1's errors (radians for joints, metres for the place) and
their duration in frames. ``footing``: deviation of standing soles from one plane, share of the time
they stand, and their height otherwise, metres. ``swapped``: frames whose legs, or arms, were
exchanged left and right before the refinement.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import save_poses
from gva_mi.core.atomic import atomic_files
from gva_mi.core.console import Progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json, write_json
from gva_mi.data.pictures import in_8_bits, write_image
from gva_mi.data.video import REFINED_POSES, spread
from gva_mi.mesh.overlay import overlay, strip
from gva_mi.pose.job import RefineOptions
from gva_mi.pose.refine import Refined, refine_all
from gva_mi.study.measure import Evaluation, Measured, measure
from gva_mi.study.page import around
from gva_mi.study.pose_figures import PoseFigures

REFINEMENT, OVERLAYS, PAGE = "refinement.json", "refinement.png", "refinement.html"
SHOWN = 8  # frames in the picture


def write_record(evaluation: Evaluation, versions: dict[str, str]) -> None:
    """Write the first three files, and remove what an older refinement left."""
    video, refined, options = evaluation.video, evaluation.refined, evaluation.options
    folder: Path = video.folder
    record = {
        "figures": evaluation.measured.means.to_json(),
        "stage1_errors": {name: asdict(noise) for name, noise in refined.noise.items()},
        "footing": None if refined.footing is None else asdict(refined.footing),
        "swapped": refined.swapped,
        "test_frames": "held out" if refined.held_out else "seen",
        **_by_split(evaluation.measured, refined),
        "kept": refined.kept,
        "without_normals": refined.without_normals,
        "normals": video.normals.convention if video.normals else None,
        "options": {"loss": options.name, **asdict(options)},
        "versions": versions,
    }
    pose, shape, offsets = refined.pose, refined.shape, refined.offsets
    focal = video.focal * refined.focal
    others = (REFINEMENT, OVERLAYS, PAGE)
    with atomic_files(folder / REFINED_POSES, *others) as unfinished:
        save_poses(unfinished / REFINED_POSES, pose, shape, stage=2, offsets=offsets, focal=focal)
        write_json(unfinished / REFINEMENT, record)
        write_image(unfinished / OVERLAYS, _overlays(evaluation))


def load_refinement(subject: Path) -> tuple[PoseFigures, bool]:
    """Read a subject's figures, and whether its refinement saw the test frames.

    A subject without the file has no figures; the paper's protocol, which sees them, is assumed.

    Raises:
        InputError: the file cannot be read.
    """
    path, expected = subject / REFINEMENT, "what `gva-mi refine` writes"
    if not path.exists():
        return PoseFigures.from_json({}), True
    record = read_json(path, expected)
    with expecting(path, expected):
        figures = PoseFigures.from_json(record["figures"])
        return figures, record.get("test_frames", "seen") == "seen"


def ablate(
    evaluation: Evaluation,
    others: Mapping[str, RefineOptions],
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> dict[str, PoseFigures]:
    """Refine a video again without each term of the loss in turn, and with other options.

    Args:
        evaluation: of the refinement that is varied.
        others: further options, by name.
        progress: called as ``progress(done, total, **figures)``.
        executor: runs the work; None: this process.

    Returns:
        The figures of each variant, by name.
    """
    video, body, truth = evaluation.video, evaluation.body, evaluation.truth
    tasks = ablations(evaluation.options, others)
    work = [
        (video if normals else replace(video, normals=None), o) for o, normals in tasks.values()
    ]
    found = refine_all(work, body, progress, executor)
    return {
        name: measure(video, body, refined, truth, evaluation.measured).means
        for name, refined in zip(tasks, found, strict=True)
    }


def ablations(
    options: RefineOptions, others: Mapping[str, RefineOptions]
) -> dict[str, tuple[RefineOptions, bool]]:
    """Return the options of each variant by name, and whether it uses normals."""
    changed = options.variants() | dict(others)
    return {
        "normals only": (replace(options, silhouette=0.0), True),
        "silhouettes only": (options, False),
        **{name: (changed, True) for name, changed in changed.items()},
    }


def _by_split(measured: Measured, refined: Refined) -> dict[str, dict]:
    """Return figures of seen and of held-out frames; nothing if none was held out."""
    if not refined.held_out:
        return {}
    seen = [k for k in range(len(refined.pose)) if k not in set(refined.held_out)]
    splits = {"train": seen, "test": refined.held_out}
    figures = {name: measured.of(frames).means.to_json() for name, frames in splits.items()}
    return {"figures_by_split": figures}


@torch.no_grad()
def _overlays(evaluation: Evaluation) -> np.ndarray:
    """Draw bodies over evenly spaced frames, stage 1 above, refined below, in 8 bits.

    Frames are cropped at once: eight whole frames of 1080p as floats take a gigabyte.
    """
    video, body, refined = evaluation.video, evaluation.body, evaluation.refined
    shown = spread([k for k in range(len(video)) if k not in video.absent], SHOWN)
    seen = np.any([outline.mask > 0.5 for outline in video.outlines(shown)], axis=0)
    part = around(seen, margin=len(seen) // 16)
    stage1 = (video.pose, video.shape, video.cameras)
    found = (refined.pose, refined.shape, refined.cameras or video.cameras)
    rows = ([], [])
    for frame in video.frames(shown):
        for row, (pose, shape, cameras) in zip(rows, (stage1, found), strict=True):
            vertices = body(pose[frame.index], shape).vertices[0]
            picture = overlay(frame.image, cameras[frame.index], vertices, body.faces)
            row.append(in_8_bits(picture[part]))
    return strip(rows)
