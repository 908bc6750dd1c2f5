"""Files of photometric tracking in the subject's folder, and its scores.

::

    subject/
      poses_photometric.npz   poses of all frames, and the displaced surface's offsets
      photometric.json        figures, errors, frames that keep their pose, options, versions
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import Tensor

from gva_mi.body.pose import Pose, Shape, load_poses, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_files
from gva_mi.core.files import write_json
from gva_mi.core.provenance import versions
from gva_mi.data.ground_truth import GroundTruth, truth_of
from gva_mi.data.video import POSES, Video
from gva_mi.fit.photometric import FittedPoses, PhotometricOptions
from gva_mi.pose.errors import means, pose_errors

TRACKED_POSES, TRACKING = "poses_photometric.npz", "photometric.json"
REGIONS = {"vertices": "body", "hands": "hands", "feet": "feet", "aligned": "body_aligned"}


def known_poses(video: Video, body: BodyModel) -> tuple[GroundTruth, tuple[Pose, Shape]] | None:
    """Return ground truth and stage-1 poses of a video, before the work; None without truth."""
    truth = truth_of(video, body)
    return None if truth is None else (truth, load_poses(video.folder / POSES, len(video)))


def measure_tracking(
    video: Video,
    body: BodyModel,
    found: FittedPoses,
    known: tuple[GroundTruth, tuple[Pose, Shape]] | None,
) -> dict[str, Any]:
    """Compare tracked poses with the initial ones of the video, and with ground truth if known.

    Returns:
        ``figures``: mean losses and seconds; ``errors_mm``: mean errors by stage and region.
    """
    stages: dict[str, tuple[Pose, Shape]] = {}
    if known is not None:
        truth, stage_1 = known
        start, tracked = ((pose, video.shape) for pose in (video.pose, found.pose))
        stages = {"stage 1": stage_1, "start": start, "tracked": tracked}
    figures = {
        "loss_start": float(found.losses_before.nanmean()),
        "loss": float(found.losses.nanmean()),
        "seconds_per_frame": found.seconds_per_frame,
    }
    errors = {k: means(pose_errors(body, poses, truth)) for k, poses in stages.items()}
    return {"figures": figures, "errors_mm": errors}


def lines_of(tracking: dict[str, Any]) -> Iterator[str]:
    """Yield the main figures of :func:`measure_tracking`, one per line."""
    figures, errors = tracking["figures"], tracking["errors_mm"]
    for name, region in REGIONS.items() if errors else ():
        lengths = (f"{stage} {mm[region]:.1f}" for stage, mm in errors.items())
        yield f"{name:<11} {' → '.join(lengths)} mm"
    yield f"loss        {figures['loss_start']:.4f} → {figures['loss']:.4f}"


def write_tracking(
    video: Video,
    found: FittedPoses,
    tracking: dict[str, Any],
    options: PhotometricOptions,
    offsets: Tensor | None,
    sources: dict[str, Path],
) -> None:
    """Write both files atomically: the record is only there with its own poses.

    ``offsets`` (V, 3) displace the rest surface that goes with the poses, metres; ``sources`` are
    the files used: ``start``, the initial poses, and ``avatar``.
    """
    record = tracking | {
        "kept": found.kept,
        **{name: str(path) for name, path in sources.items()},
        "options": asdict(options),
        "versions": versions(),
    }
    with atomic_files(video.folder / TRACKED_POSES, TRACKING) as unfinished:
        save_poses(
            unfinished / TRACKED_POSES,
            found.pose,
            video.shape,
            stage=2,
            offsets=offsets,
        )
        write_json(unfinished / TRACKING, record)
