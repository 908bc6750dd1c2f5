"""Find everything that is wrong with a subject's folder in one pass: ``gva-mi check``.

Other steps stop at the first file that they cannot use, and trust numbers of the right shape. This
check uses the same reader, which here continues after each fault
(:class:`~gva_mi.subject.problems.Faults`). Then it compares the numbers with those of real lenses
and people, and the body's silhouettes with the masks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gva_mi.body.pose import BODY, JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.errors import InputError
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera
from gva_mi.subject.fingerprint import require_same_body
from gva_mi.subject.folder import CAMERAS, FRAMES, MASKS, POSES, VIDEO
from gva_mi.subject.ground_truth import read_views
from gva_mi.subject.lens import ONE_LENS_TOLERANCE
from gva_mi.subject.pictures import write_image
from gva_mi.subject.problems import CheckReport, Faults, Problem, doubt, error
from gva_mi.subject.silhouettes import (
    LEAST_IOU,
    TURNED_DEGREES,
    compare,
    draw_sheet,
    turned_words,
)
from gva_mi.subject.video import Video, read_video

# All chosen, for the reason beside each.
# Of width or height. A lens's axis meets the middle of a picture to a few percent; K of a picture
# 1.25 times as large has it an eighth of the width away.
PRINCIPAL_POINT_OFFSET = 0.12
FOCAL_RATIO = 1.5  # fx over fy: the widest pixels of a video standard, 16:9 in PAL, have 1.46
# Radians. Axis-angle needs no more than half a turn; a limb's rotation that was unwrapped has no
# more than a whole one. In degrees an ordinary bend is ten times as much.
LARGEST_ROTATION = 2 * np.pi
DOUBTFUL_BETA, WRONG_BETA = 5.0, 10.0  # standard deviations: 1 person in 3 million has one above 5
FITTING_IOU = 0.5  # the body and the mask have more in common than not
JOINTS_INSIDE = 0.5  # share of a frame's joints in the mask; joints lie well inside a body
# Size of the masks over the size of the body, and its inverse. A standing person has a root mean
# square radius of some 45 cm. Clothes and hair add 5 cm all around, and adults differ by 8 % from
# the mean person whom zero betas stand for: together a sixth.
DOUBTFUL_SIZE_RATIO, WRONG_SIZE_RATIO = 1.2, 1.35


def check_subject(
    folder: Path, body: BodyModel, progress: Progress | None = None, sheet: Path | None = None
) -> CheckReport:
    """Check a folder whose poses are for ``body``.

    Some frames with mask, camera and pose are drawn into the picture file ``sheet``.
    """
    folder, faults = Path(folder), Faults()
    parts = (VIDEO, FRAMES, MASKS, CAMERAS, POSES)
    if folder.is_dir() and not any((folder / part).exists() for part in parts):
        raise InputError(f"{folder}: no subject's folder; expected some of {', '.join(parts)}")
    video = read_video(folder, faults.attempt)
    faults.attempt("another body", None, require_same_body, folder, body)
    if video is not None:
        faults.attempt("views of other cameras", None, read_views, folder, len(video))
        faults.attempt("poses", None, video.offsets_of, len(body.v_template))
        if len(video.absent) < len(video):
            faults.attempt("splits", None, video.require_train_frames)
    report = CheckReport(len(video or ()), list(faults.problems()))
    if video is not None:
        report.problems += [*_left_out(video), *check_intrinsics(video.cameras)]
        report.problems += check_poses(video.pose, video.shape, body)
    of_body = "betas" not in {problem.what for problem in report.errors}
    if video is None or len(video.absent) == len(video) or not of_body:
        why = "no frame has a picture, mask, camera and pose that can be used"
        report.skipped.append(f"poses and masks were not compared: {why}")
    else:
        check_silhouettes(report, video, body, progress)
        if sheet is not None:
            write_image(sheet, draw_sheet(video, body))
    report.problems.sort(key=lambda problem: problem.severity != "error")
    return report


def _left_out(video: Video) -> Iterator[Problem]:
    """Yield the frames of a video that the other steps leave out."""
    if video.absent:
        frame, reason = next(iter(video.absent.items()))
        figure = f"{len(video.absent)} of {len(video)}; frame {frame}: {reason}"
        yield doubt("frames left out", figure,
                    "the segmenter lost the person or wrote labels, or files have other names",
                    "write frames/000000.png ... and masks/000000.png ..., 255 inside the person",
                    video.absent)  # fmt: skip


def check_intrinsics(cameras: Sequence[Camera]) -> Iterator[Problem]:
    """Yield problems of focal lengths and principal points."""
    uneven = [c.fx / c.fy for c in cameras if max(c.fx / c.fy, c.fy / c.fx) > FOCAL_RATIO]
    if uneven:
        yield doubt("focal length", f"fx / fy is {uneven[0]:.3g}", "normalised by width and "
                    "height, or scaled in one direction", "fx, fy in pixels")  # fmt: skip
    at = np.array([(c.cx / c.width, c.cy / c.height) for c in cameras])
    off = (np.abs(at - 0.5) > PRINCIPAL_POINT_OFFSET).any(1)
    focal = np.array([c.fx for c in cameras])
    # Estimators that look at a person's box have another lens in each frame, with the box's axis.
    of_boxes = (np.abs(focal / np.median(focal) - 1) > ONE_LENS_TOLERANCE).mean() > 0.5
    if off.any() and not of_boxes:
        yield doubt(
            "principal point",
            "at {:.2f} of the width, {:.2f} of the height".format(*at[off.argmax()]),
            "K is of pictures of another size, or the pictures are crops",
            "scale K with the pictures, or subtract a crop's corner from cx, cy",
            np.flatnonzero(off) if not off.all() else (),
        )


def check_poses(pose: Pose, shape: Shape, body: BodyModel) -> Iterator[Problem]:
    """Yield problems of betas and rotations."""
    largest = float(shape.betas.abs().max()) if len(shape.betas) else 0.0
    advice = "give the --body that the betas belong to, or zero betas"
    if shape.betas[body.num_betas :].any():
        figure = f"{len(shape.betas)}, but the body has {body.num_betas}"
        yield error("betas", figure, "they belong to another body", advice)
        return
    if largest > DOUBTFUL_BETA:
        yield (error if largest > WRONG_BETA else doubt)(
            "betas", f"up to {largest:.1f} standard deviations",
            "of another body, fitted to a wrong distance, or no betas at all", advice,
        )  # fmt: skip
    turns = pose.rotations[:, 1:].norm(dim=-1).numpy()
    wide = (turns > LARGEST_ROTATION).any(1)
    if wide.any():
        frame, joint = np.unravel_index(turns.argmax(), turns.shape)
        figure = f"{JOINTS[joint + 1]} turns by {turns.max():.3g} in frame {frame}"
        yield error("rotations", figure, "degrees, or another representation than axis-angle",
                    "axis-angle in radians", np.flatnonzero(wide))  # fmt: skip


def check_silhouettes(
    report: CheckReport, video: Video, body: BodyModel, progress: Progress | None
) -> None:
    """Compare the body with the masks; add problems, mean IoU and share of joints inside."""
    numbers = [k for k in range(len(video)) if k not in video.absent]
    scene, comparisons = MeshScene(body.faces, body.v_template.float()), []
    for outline in video.outlines(numbers):
        frame = outline.pose, outline.camera, outline.mask
        comparisons.append(compare(body, video.shape, frame, scene))
        if progress is not None:
            progress(len(comparisons), len(numbers))
    for what, attribute, cause, remedy in (
        ("full masks", "full", "an alpha channel that was never written, or a threshold of zero",
         "make these masks again, or delete them: frames without one are left out"),
        ("inverted masks", "inverted", "255 is the background", "write 255 where the person is"),
    ):  # fmt: skip
        wrong = [k for k, one in zip(numbers, comparisons, strict=True) if getattr(one, attribute)]
        if wrong:
            figure = f"{len(wrong)} of {len(comparisons)}"
            report.problems.append(error(what, figure, cause, remedy, wrong))
    compared = {k: one for k, one in zip(numbers, comparisons, strict=True) if not one.full}
    if compared:
        inside = np.array([one.joints[0] / BODY.stop for one in compared.values()])
        iou = float(np.mean([one.overlap for one in compared.values()]))
        report.figures = {"iou": iou, "joints_inside": float(inside.mean())}
        report.problems += _size(np.array([one.size for one in compared.values()]))
        report.problems += _outside(np.array(list(compared)), inside, iou)
        lean = np.median([one.lean for one in compared.values()])
        if lean > TURNED_DEGREES and iou > LEAST_IOU:
            report.problems.append(doubt("rotation", turned_words(lean), "the video lost its "
                "rotation", "ffmpeg -i VIDEO -vf hflip,vflip UPRIGHT turns it by 180 degrees, "
                "transpose=1 by 90 degrees clockwise"))  # fmt: skip


def _size(ratios: np.ndarray) -> Iterator[Problem]:
    """Yield masks that are larger or smaller than the body; NaN where they cannot be compared."""
    if np.isnan(ratios).all():
        return
    ratio = float(np.nanmedian(ratios))
    if (wrong := max(ratio, 1 / ratio)) > DOUBTFUL_SIZE_RATIO:
        yield (error if wrong > WRONG_SIZE_RATIO else doubt)(
            "focal length or distance", f"masks are {ratio:.2f} times as large as the body",
            "K is of pictures of another size, or the poses' distance belongs to another lens",
            f"fx, fy {ratio:.2f} times as long, or the person {1 / ratio:.2f} times as far away",
        )  # fmt: skip


def _outside(numbers: np.ndarray, inside: np.ndarray, iou: float) -> Iterator[Problem]:
    """Yield a body that is elsewhere than the masks, by joints inside (n,) and mean IoU."""
    outside = inside < JOINTS_INSIDE
    figure = f"{outside.sum()} of {len(outside)} frames, IoU {iou:.2f}"
    look = "see the overlay (--sheet)"
    if outside.mean() > 0.5 or iou < LEAST_IOU:
        yield error("poses outside the masks", figure,
                    "another person, T_camera_world inverted or in other axes than x right, y "
                    "down, z forward, no metres, K of another size, or mirrored pictures",
                    f"{look}, and write cameras and poses again", numbers[outside])  # fmt: skip
    elif outside.any():
        yield doubt("poses outside the masks", figure,
                    "the estimator or the segmenter lost the person for some frames",
                    f"{look}; delete masks that are wrong", numbers[outside])  # fmt: skip
    elif iou < FITTING_IOU:
        yield doubt("silhouettes beside the masks", f"IoU {iou:.2f}",
                    "wide clothes, a part of the person alone in the masks, or another body",
                    look)  # fmt: skip
