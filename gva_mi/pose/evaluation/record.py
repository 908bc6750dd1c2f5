"""What a refinement leaves in the subject's folder.

::

    subject/
      poses_refined.npz   all frames, and the displaced surface's offsets: gva_mi.body.pose
      refinement.json     figures, frames that kept their stage-1 pose and why, options, versions
      refinement.png      the body over some frames: stage 1 above, refined below
      refinement.html     a page, where one was asked for

Where one of the other three is, it is about the poses that are there.

The paper's protocol refines test frames too, from their own masks and normals; refinement.json says
so by ``"test_frames": "seen"``. Where they were ``"held out"``, their poses follow from the others,
and ``figures_by_split`` tells them apart. ``stage1_errors`` are standard deviations of how stage 1
errs, as they were inferred: radians for joints, metres for the place; and how many frames it lasts.
``footing`` is how far soles that stand are off one plane, the share of the time that they stand,
and how far they are lifted else, metres. ``swapped`` are the frames in which legs, or arms, were
exchanged first, left and right.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import save_poses
from gva_mi.data.pictures import in_8_bits, write_image
from gva_mi.data.video import REFINED_POSES, spread
from gva_mi.files import replacing_together, write_json
from gva_mi.mesh.overlay import overlay, strip
from gva_mi.page import around
from gva_mi.pose.evaluation.measure import Evaluation, Measured
from gva_mi.pose.refine import Refined

REFINEMENT, OVERLAYS, PAGE = "refinement.json", "refinement.png", "refinement.html"
SHOWN = 8  # frames in the picture


def write_record(evaluation: Evaluation, versions: dict[str, str]) -> None:
    """Write the first three files, in the place of all that was there of an older refinement.

    Args:
        evaluation: of the refinement.
        versions: of what may change the figures.
    """
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
    about = (REFINEMENT, OVERLAYS, PAGE)
    with replacing_together(folder / REFINED_POSES, *about) as unfinished:
        save_poses(unfinished / REFINED_POSES, pose, shape, stage=2, offsets=offsets, focal=focal)
        write_json(unfinished / REFINEMENT, record)
        write_image(unfinished / OVERLAYS, _overlays(evaluation))


def _by_split(measured: Measured, refined: Refined) -> dict[str, dict]:
    """The figures of the frames that were looked at and of the others, where there are such."""
    if not refined.held_out:
        return {}
    seen = [k for k in range(len(refined.pose)) if k not in set(refined.held_out)]
    splits = {"train": seen, "test": refined.held_out}
    figures = {name: measured.of(frames).means.to_json() for name, frames in splits.items()}
    return {"figures_by_split": figures}


@torch.no_grad()
def _overlays(evaluation: Evaluation) -> np.ndarray:
    """Bodies over evenly spaced frames: stage 1 above, refined below.

    Of each frame no more is kept than what is shown, in 8 bits: eight of 1080p, whole and as
    floats, take a gigabyte.
    """
    video, body, refined = evaluation.video, evaluation.body, evaluation.refined
    there = [k for k in range(len(video)) if k not in video.absent]
    shown = spread(there, SHOWN)
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
