"""``metrics.json``: the figures of a run. They are measured, written, read and shown here.

::

    rows         scores of the renders, a row for each split: gva_mi.fit.evaluate
    refinement   errors of the poses before and after stage 2; null where they are not known
    training     steps, seconds, Gaussians, size of the pictures
    options, versions, seed       of the run
    pose_fit     where asked for: how poses were fitted to the test pictures
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from gva_mi.avatar.avatar import Avatar
from gva_mi.console import Progress
from gva_mi.data.video import Video
from gva_mi.errors import InputError
from gva_mi.files import write_json
from gva_mi.fit import run_folder
from gva_mi.fit.evaluate import SplitScores, evaluate
from gva_mi.fit.photometric import FITTED, PhotometricOptions, fit_poses
from gva_mi.pose.evaluation.figures import PoseFigures
from gva_mi.pose.evaluation.record import REFINEMENT

AS_REFINED = "poses as refined"  # name of the row of a test split without the trained poses


@dataclass(frozen=True)
class Training:
    """What the fit of an avatar took, and what came of it."""

    steps: int
    seconds: float
    gaussians: int
    size: tuple[int, int]  # (W, H) of the pictures, pixels


@dataclass(frozen=True)
class PoseFit:
    """How the poses of the test frames were fitted to their pictures."""

    options: dict[str, Any]
    kept: dict[str, str]  # numbers of frames that keep the pose they had, and why
    seconds_per_frame: float


@dataclass(frozen=True)
class Metrics:
    """All figures of a run."""

    rows: tuple[SplitScores, ...]
    refinement: PoseFigures  # all None where the poses were not refined by this program
    training: Training
    options: dict[str, Any]  # of the fit
    versions: dict[str, str]
    pose_fit: PoseFit | None = None

    @property
    def seed(self) -> int:
        """The seed of the fit."""
        return self.options["seed"]

    def to_json(self) -> dict[str, Any]:
        """What ``metrics.json`` holds."""
        refinement = self.refinement.to_json()
        del refinement["iou_true_masks"]  # a figure of the study
        record = {
            "rows": [asdict(row) for row in self.rows],
            "refinement": refinement,
            "training": asdict(self.training),
            "options": self.options,
            "versions": self.versions,
            "seed": self.seed,
        }
        return record | ({"pose_fit": asdict(self.pose_fit)} if self.pose_fit else {})

    @staticmethod
    def from_json(record: dict[str, Any]) -> Metrics:
        """The inverse of :meth:`to_json`."""
        training, pose_fit = record["training"], record.get("pose_fit")
        return Metrics(
            rows=tuple(SplitScores(**row) for row in record["rows"]),
            refinement=PoseFigures.from_json(record["refinement"]),
            training=Training(**training | {"size": tuple(training["size"])}),
            options=record["options"],
            versions=record["versions"],
            pose_fit=PoseFit(**pose_fit) if pose_fit else None,
        )

    def lines(self) -> Iterator[str]:
        """The main figures, a line each."""
        yield from self.refinement.lines()
        for row in self.rows:
            split = row.split.replace("_", " ")
            name = "" if row.name == self.rows[0].name else f" ({row.name})"
            yield f"{split:<11} PSNR {row.psnr:.2f} dB, SSIM {row.ssim:.4f}{name}"


def measure_run(
    run: Path, avatar: Avatar, video: Video, name: str, progress: Progress | None = None
) -> Metrics:
    """Measure the avatar of a run on all splits of its video.

    Args:
        run: the folder of the finished fit.
        avatar: what was fitted.
        video: opened with the poses that the fit began with.
        name: of the run, for its rows.
        progress: called after each frame.
    """
    trained = run_folder.under_trained_poses(video, run)
    rows = evaluate(avatar, trained, name, progress=progress)
    if trained is not video:  # what training the poses is worth to frames that it has not seen
        rows += evaluate(avatar, video, AS_REFINED, splits=("test",))
    history, made_with = run_folder.load_history(run), run_folder.load_options(run)
    training = Training(
        steps=len(history["loss"]),
        seconds=float(history["milliseconds"].sum() / 1e3),
        gaussians=int(history["gaussians"][-1]),
        size=video.size,
    )
    refinement = _load_refinement(video.folder)
    return Metrics(tuple(rows), refinement, training, made_with["options"], made_with["versions"])


def with_fitted_poses(
    metrics: Metrics, avatar: Avatar, video: Video, progress: Progress | None = None
) -> Metrics:
    """Add a row for the test frames under poses that are fitted to these very frames.

    Args:
        metrics: of the run.
        avatar: what was fitted.
        video: opened with the poses that the avatar was trained under.
        progress: called after each step of the pose fit.
    """
    options, test = PhotometricOptions(), video.splits.test
    found = fit_poses(avatar, video, options, test, progress)
    rows = evaluate(avatar, replace(video, pose=found.pose), FITTED, splits=("test",))
    kept = {str(frame): reason for frame, reason in found.kept.items()}
    return replace(
        metrics,
        rows=(*metrics.rows, *rows),
        pose_fit=PoseFit(asdict(options), kept, found.seconds_per_frame),
    )


def save_metrics(run: Path, metrics: Metrics) -> None:
    """Write the figures into a run's folder."""
    write_json(run / run_folder.METRICS, metrics.to_json())


def load_metrics(run: Path) -> Metrics:
    """Read the figures of a run that was evaluated.

    Raises:
        InputError: there are none, or they cannot be read.
    """
    path = run / run_folder.METRICS
    try:
        return Metrics.from_json(json.loads(path.read_text()))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(f"{path}: not readable; expected what `gva-mi evaluate` writes") from None


def _load_refinement(subject: Path) -> PoseFigures:
    """The figures of a subject's refinement; all None where it has none."""
    path = subject / REFINEMENT
    return PoseFigures.from_json(json.loads(path.read_text())["figures"] if path.exists() else {})
