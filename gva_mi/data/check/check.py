"""Check a subject's folder and return a report: :func:`check_subject`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.data.check.files import SubjectFiles, read_subject
from gva_mi.data.check.frames import SilhouetteRenderer, frames_of
from gva_mi.data.check.normals import check_normals
from gva_mi.data.check.numbers import ABSURD, check_poses
from gva_mi.data.check.problems import CheckReport
from gva_mi.data.check.silhouettes import SilhouetteCheck, check_silhouettes
from gva_mi.data.video import load_video


def check_subject(
    folder: Path, body: BodyModel, poses: Path | None = None, progress: Progress | None = None
) -> tuple[CheckReport, SubjectFiles, SilhouetteCheck | None]:
    """Check everything in a folder, whose poses are for ``body`` and in ``poses`` or ``poses.npz``.

    Returns the report, what was read, and what silhouettes show; None if no frame can be compared.
    """
    files = read_subject(Path(folder), poses, body, progress)
    report, shown = CheckReport(files.count, files.problems), None
    if files.poses is not None:
        shape = files.poses.shape
        report.problems += check_poses(files.poses.pose, shape, body, files.cameras)
        if (shape.betas.abs() > ABSURD).any():
            files.poses = replace(files.poses, shape=Shape(shape.betas * 0))
    frames = frames_of(files, body)
    if frames is None:
        report.skipped.append(
            "silhouettes and normals were not compared: no frame has picture, mask, camera and "
            "pose that can be used"
        )
    else:
        shown = check_silhouettes(frames, SilhouetteRenderer(body))
        report.problems += shown.problems
        report.figures = {"iou": shown.iou, "joints_inside": shown.inside}
        if files.maps is None:
            report.skipped.append("normals were not compared: there are none that can be read")
        elif any(hypothesis.moves_pictures for hypothesis in shown.accepted):
            report.skipped.append("normals were not compared: first mend what moves the masks")
        else:
            report.problems += check_normals(
                files.maps, shown.final, shown.final_images, files.cameras
            )
    if not report.errors:  # everything that the other steps refuse is an error
        opened = lambda: load_video(files.folder, files.poses_file).require_train_frames()
        files.attempt("unreadable", opened)
    report.problems.sort(key=lambda problem: problem.severity != "error")
    return report, files, shown
