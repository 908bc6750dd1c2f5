"""One row of the study for one case: a piece of work for any executor.

The run is kept in the study's folder, so that a kill costs the steps since its last checkpoint and
the page can show its avatar. A folder that another program, or other options, left is made anew.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, load_offsets
from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress
from gva_mi.data.synthetic.closest import closest
from gva_mi.data.truth import load_truth
from gva_mi.data.video import POSES, REFINED_POSES, TEST_EVERY, Splits, Video, load_video
from gva_mi.files import says, write_json
from gva_mi.fit import run_folder
from gva_mi.fit.evaluation.metrics import Metrics, measure_run, save_metrics, with_fitted_poses
from gva_mi.fit.evaluation.rows import Row
from gva_mi.fit.options import FitOptions
from gva_mi.fit.train import fit

MADE_WITH = "made_with.json"


@dataclass(frozen=True)
class RowRun:
    """A :class:`gva_mi.pose.parallel.Work`."""

    subject: Path  # the case's folder, refined
    out: Path  # of the run
    row: Row
    body: BodyModel
    options: FitOptions  # of the study; the row changes them
    made_with: dict[str, Any]  # what the result depends on besides

    @property
    def steps(self) -> int:
        """How much work it is."""
        return self.options.steps

    def solve(self, progress: Progress | None = None) -> Metrics:
        """Fit, or go on with a fit, and measure."""
        self._make_room()
        video, offsets = self.video(), self.offsets()
        options = self.row.of(self.options)
        avatar = fit(
            video, self.body, options, self.out, offsets=offsets, resume=True, progress=progress
        )
        metrics = measure_run(
            self.out,
            avatar,
            video,
            self.row.name,
            self.body,
            self._poses,
            driven=self.driven(video),
        )
        if not self.row.rigid:  # fitted poses would bend what does not bend
            trained = run_folder.under_trained_poses(video, self.out)
            metrics = with_fitted_poses(metrics, avatar, video, trained, self.body)
        save_metrics(self.out, metrics)
        return metrics

    @property
    def is_done(self) -> bool:
        """Whether its avatar is there; a study's figures may be kept without it."""
        return (self.out / run_folder.AVATAR).exists()

    def avatar(self) -> Avatar:
        """The finished run's."""
        return run_folder.load_avatar(self.out)

    def video(self) -> Video:
        """The case's video, under the poses that this row fits under."""
        video = self._held_out(load_video(self.subject, self._poses))
        if self.row.rigid:
            return replace(video, pose=self.driven(video)(video.pose))
        if self.row.poses != "true":
            return video
        truth = load_truth(video.truth, self.body)
        near = closest(self.body, truth.body, truth.pose, truth.shape)
        return replace(video, pose=near.pose, shape=near.shape, cameras=truth.cameras)

    def _held_out(self, video: Video) -> Video:
        if not self.row.one_range:
            return video
        return replace(video, splits=Splits.one_range(TEST_EVERY, len(video)).without(video.absent))

    def offsets(self) -> Tensor | None:
        """The displacement that the refinement found; stage 1 knows none."""
        return load_offsets(self._poses, len(self.body.v_template))

    def driven(self, video: Video) -> Callable[[Pose], Pose]:
        """What becomes of every pose before it drives the avatar."""
        if not self.row.rigid:
            return lambda pose: pose
        joints = video.pose.rotations[video.splits.train[0], 1:]

        def rigid(pose: Pose) -> Pose:
            rotations = pose.rotations.clone()
            rotations[:, 1:] = joints
            return replace(pose, rotations=rotations)

        return rigid

    @property
    def _poses(self) -> Path:
        return self.subject / (POSES if self.row.poses == "stage 1" else REFINED_POSES)

    def _make_room(self) -> None:
        """Remove a run that holds no longer."""
        held = self.out / MADE_WITH
        if self.out.exists():
            if not says(held, self.made_with):
                shutil.rmtree(self.out)
        if not held.exists():
            write_json(held, self.made_with)
