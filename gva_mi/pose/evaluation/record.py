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
from gva_mi.body.smplx import BodyModel
from gva_mi.data.pictures import write_image
from gva_mi.data.video import Video
from gva_mi.files import write_json
from gva_mi.mesh.overlay import overlay, strip
from gva_mi.page import around, spread
from gva_mi.pose.evaluation.measure import Measured
from gva_mi.pose.refine import Refined, RefineOptions

REFINED, REFINEMENT, OVERLAYS = "poses_refined.npz", "refinement.json", "refinement.png"
SHOWN = 8  # frames in the picture


def write_record(
    video: Video,
    body: BodyModel,
    refined: Refined,
    measured: Measured,
    options: RefineOptions,
    versions: dict[str, str],
) -> None:
    """Write the three files; the poses last, for they are what says that it was done."""
    folder: Path = video.folder
    write_image(folder / OVERLAYS, _overlays(video, body, refined))
    record = {
        "figures": measured.means.as_record(),
        "kept": refined.kept,
        "without_normals": refined.without_normals,
        "normals": video.normals.convention if video.normals else None,
        "options": asdict(options),
        "versions": versions,
    }
    write_json(folder / REFINEMENT, record)
    pose, shape, offsets = refined.pose, refined.shape, refined.offsets
    save_poses(folder / REFINED, pose, shape, stage=2, offsets=offsets)


@torch.no_grad()
def _overlays(video: Video, body: BodyModel, refined: Refined) -> np.ndarray:
    """Bodies over evenly spaced frames."""
    there = [k for k in range(len(video)) if k not in video.absent]
    frames = list(video.frames(spread(there, SHOWN)))
    seen = np.any([frame.mask > 0.5 for frame in frames], axis=0)
    part = around(seen, margin=len(seen) // 16)
    rows = []
    for pose, shape in ((video.pose, video.shape), (refined.pose, refined.shape)):
        bodies = [body(pose[frame.index], shape).vertices[0] for frame in frames]
        pairs = zip(frames, bodies, strict=True)
        rows.append([overlay(f.image, f.camera, v, body.faces)[part] for f, v in pairs])
    return strip(rows)
