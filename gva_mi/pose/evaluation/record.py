"""What a refinement leaves in the subject's folder.

::

    subject/
      poses_refined.npz   all frames, and the displaced surface's offsets: gva_mi.body.pose
      refinement.json     figures, frames that kept their stage-1 pose and why, options, versions
      refinement.png      the body over some frames: stage 1 above, refined below
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import save_poses
from gva_mi.data.pictures import write_image
from gva_mi.data.video import REFINED_POSES, spread
from gva_mi.files import write_json
from gva_mi.mesh.overlay import overlay, strip
from gva_mi.page import around
from gva_mi.pose.evaluation.measure import Evaluation

REFINEMENT, OVERLAYS = "refinement.json", "refinement.png"
SHOWN = 8  # frames in the picture


def write_record(evaluation: Evaluation, versions: dict[str, str]) -> None:
    """Write the three files; the poses last, for a folder that holds them counts as refined.

    Args:
        evaluation: of the refinement.
        versions: of what may change the figures.
    """
    video, refined, options = evaluation.video, evaluation.refined, evaluation.options
    folder: Path = video.folder
    write_image(folder / OVERLAYS, _overlays(evaluation))
    record = {
        "figures": evaluation.measured.means.to_json(),
        "kept": refined.kept,
        "without_normals": refined.without_normals,
        "normals": video.normals.convention if video.normals else None,
        "options": {"loss": options.name, **asdict(options)},
        "versions": versions,
    }
    write_json(folder / REFINEMENT, record)
    pose, shape, offsets = refined.pose, refined.shape, refined.offsets
    focal = video.focal * refined.focal
    save_poses(folder / REFINED_POSES, pose, shape, stage=2, offsets=offsets, focal=focal)


@torch.no_grad()
def _overlays(evaluation: Evaluation) -> np.ndarray:
    """Bodies over evenly spaced frames: stage 1 above, refined below."""
    video, body, refined = evaluation.video, evaluation.body, evaluation.refined
    there = [k for k in range(len(video)) if k not in video.absent]
    frames = list(video.frames(spread(there, SHOWN)))
    seen = np.any([frame.mask > 0.5 for frame in frames], axis=0)
    part = around(seen, margin=len(seen) // 16)
    rows = []
    for pose, shape, focal in (
        (video.pose, video.shape, 1.0),
        (refined.pose, refined.shape, refined.focal),
    ):
        bodies = [body(pose[frame.index], shape).vertices[0] for frame in frames]
        pairs = zip(frames, bodies, strict=True)
        rows.append(
            [overlay(f.image, f.camera.zoomed(focal), v, body.faces)[part] for f, v in pairs]
        )
    return strip(rows)
