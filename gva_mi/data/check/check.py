"""All of it: a folder in, a report out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.data.check.cameras import check_cameras, usable_cameras
from gva_mi.data.check.contents import Contents, attempt, read_contents, small_size
from gva_mi.data.check.files import check_files, inverted, open_normals, says_nothing
from gva_mi.data.check.findings import Report, ordered
from gva_mi.data.check.normals import check_normals
from gva_mi.data.check.poses import Poses, check_poses
from gva_mi.data.check.seen import Seen, Silhouettes
from gva_mi.data.check.silhouettes import Compared, compare
from gva_mi.data.video import load_video
from gva_mi.splat import Camera


@dataclass(frozen=True)
class Checked:
    """A report, and what pictures of it are made of."""

    report: Report
    contents: Contents
    compared: Compared | None  # None where no frame could be compared


def check_subject(
    folder: Path, body: BodyModel, poses: Path | None = None, progress: Progress | None = None
) -> Checked:
    """Look at everything in a subject's folder.

    Args:
        folder: the subject's.
        body: the one that its poses are for.
        poses: another file of poses than ``folder/poses.npz``.
        progress: told how many pictures are read.

    Raises:
        InputError: there is no such folder, or nothing of a subject in it.
    """
    contents = read_contents(Path(folder), poses, progress)
    found = contents.findings
    found += check_files(contents, body)
    found += check_cameras(contents)
    read, more = check_poses(contents, body)
    found += more
    report, compared = Report(contents.count, []), None
    cameras = usable_cameras(contents)
    maps = open_normals(contents, cameras, found.append)
    seen = _seen(contents, cameras, read, body)
    if seen is None:
        report.skipped.append(
            "silhouettes and normals were not compared: no frame has picture, mask, camera and "
            "pose that can be used"
        )
    else:
        compared = compare(seen, Silhouettes(body))
        found += compared.findings
        report.figures = {
            "iou": float(compared.iou.mean()), "joints_inside": float(compared.inside.mean()),
        }  # fmt: skip
        if maps is None:
            report.skipped.append("normals were not compared: there are none that can be read")
        elif any(reading.moves_pictures for reading in compared.accepted):
            report.skipped.append("normals were not compared: first mend what moves the masks")
        else:
            found += check_normals(maps, compared.final, compared.final_images, cameras)
    if not any(finding.severity == "error" for finding in found):
        attempt(contents, lambda: _open(contents, body))
    report.findings = ordered(found)
    return Checked(report, contents, compared)


def _open(contents: Contents, body: BodyModel) -> None:
    """Open the folder as the other steps do: what they refuse is an error, named above or not."""
    video = load_video(contents.folder, contents.poses_file)
    video.require_train_frames()
    video.offsets_of(len(body.v_template))


def _seen(
    contents: Contents, cameras: dict[int, Camera], read: Poses | None, body: BodyModel
) -> Seen | None:
    """The frames that can be compared; None where there are none."""
    if read is None:
        return None
    size = next(((c.width, c.height) for c in cameras.values()), None)
    frames = [
        k for k, m in sorted(contents.masks.items())
        if k in cameras and m.size == size and not says_nothing(m)
        and k < len(read.good) and read.good[k]
    ]  # fmt: skip
    if not frames:
        return None
    masks = [
        ~contents.masks[k].small if inverted(contents.masks[k]) else contents.masks[k].small
        for k in frames
    ]
    small = small_size(*size)
    with torch.no_grad():
        joints = body.rest(Shape(read.shape.betas)).joints.double().numpy()
    return Seen(
        tuple(frames), tuple(cameras[k].resized(*small) for k in frames), np.stack(masks),
        read.pose[frames], read.shape, joints,
    )  # fmt: skip
