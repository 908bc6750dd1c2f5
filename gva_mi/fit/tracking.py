"""What a photometric pass leaves in the subject's folder.

::

    subject/
      poses_photometric.npz   poses of all frames, and the displaced surface's offsets
      photometric.json        figures, errors, frames that keep their pose, options, versions
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from gva_mi.body.pose import load_poses, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_files
from gva_mi.core.files import write_json
from gva_mi.core.provenance import versions
from gva_mi.data.ground_truth import load_ground_truth
from gva_mi.data.video import POSES, Video
from gva_mi.fit.photometric import FittedPoses, PhotometricOptions
from gva_mi.pose.errors import means, pose_errors

TRACKED_POSES, TRACKING = "poses_photometric.npz", "photometric.json"
REGIONS = {"vertices": "body", "hands": "hands", "feet": "feet", "aligned": "body_aligned"}


@dataclass(frozen=True)
class Tracking:
    """The figures of a photometric pass."""

    loss_start: float  # mean over the frames, at the poses it started from
    loss: float  # the same at the fitted poses
    seconds_per_frame: float
    errors_mm: dict[str, dict[str, float]]  # means by stage and region; empty without a truth

    def to_json(self) -> dict[str, Any]:
        """The entries ``figures`` and ``errors_mm`` of ``photometric.json``."""
        figures = asdict(self)
        errors = figures.pop("errors_mm")
        return {"figures": figures, "errors_mm": errors}

    def lines(self) -> Iterator[str]:
        """The main figures, a line each."""
        for name, region in REGIONS.items() if self.errors_mm else ():
            lengths = (f"{stage} {mm[region]:.1f}" for stage, mm in self.errors_mm.items())
            yield f"{name:<11} {' → '.join(lengths)} mm"
        yield f"loss        {self.loss_start:.4f} → {self.loss:.4f}"


def measure_tracking(video: Video, body: BodyModel, found: FittedPoses) -> Tracking:
    """Compare poses with those they started from and, for a synthetic subject, with the truth.

    Args:
        video: opened with the poses that the pass started from.
        body: the body model.
        found: what the pass found.
    """
    return Tracking(
        loss_start=float(found.losses_before.nanmean()),
        loss=float(found.losses.nanmean()),
        seconds_per_frame=found.seconds_per_frame,
        errors_mm=_errors(video, body, found),
    )


def write_tracking(
    video: Video,
    found: FittedPoses,
    tracking: Tracking,
    options: PhotometricOptions,
    offsets: Tensor | None,
    sources: dict[str, Path],
) -> None:
    """Write both files, in the place of older ones: the record is there with its poses alone.

    Args:
        video: opened with the poses that the pass started from.
        found: what the pass found.
        tracking: its figures.
        options: how it was done.
        offsets: (V, 3) displacement of the rest surface that goes with the poses, metres.
        sources: the files it was made from: ``start``, the first poses, and ``avatar``.
    """
    record = tracking.to_json() | {
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
            focal=video.focal,
        )
        write_json(unfinished / TRACKING, record)


def _errors(video: Video, body: BodyModel, found: FittedPoses) -> dict[str, dict[str, float]]:
    if video.truth is None:
        return {}
    truth = load_ground_truth(video.truth, body)
    stages = {
        "stage 1": load_poses(video.folder / POSES),
        "start": (video.pose, video.shape),
        "tracked": (found.pose, video.shape),
    }
    return {stage: means(pose_errors(body, poses, truth)) for stage, poses in stages.items()}
