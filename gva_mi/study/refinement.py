"""Files that a refinement leaves in the subject's folder.

::

    subject/
      poses_refined.npz   all frames, and the offsets of the displaced surface: gva_mi.body.pose
      refinement.json     figures, frames that kept their stage-1 pose and why, options, versions
      refinement.png      the body over some frames: stage 1 above, refined below

The other two files always belong to the poses in the folder. The paper refines test frames too,
from their own masks and normals: ``"test_frames": "seen"``. If they were ``"held out"``, their
poses follow from the other frames, and ``figures_by_split`` lists both. ``stage1_errors`` are the
inferred standard deviations of stage 1's errors (radians for joints, metres for the place) and
their duration in frames. ``footing``: deviation of standing soles from one plane, share of the time
they stand, and their height otherwise, metres. ``swapped``: frames whose legs, or arms, were
exchanged left and right before the refinement.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_files
from gva_mi.core.console import Progress, listed
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.core.stamp import write_record
from gva_mi.core.tasks import local_executor
from gva_mi.data.folder import REFINED_POSES
from gva_mi.data.ground_truth import GroundTruth, truth_of
from gva_mi.data.pictures import in_8_bits, write_image
from gva_mi.data.splits import spread
from gva_mi.data.video import Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import overlay, strip
from gva_mi.pose.observed_video import RefineOptions
from gva_mi.pose.prior.error_model import GROUPS, Stage1ErrorModel
from gva_mi.pose.prior.ground import ContactStats
from gva_mi.pose.prior.inference import AXES
from gva_mi.pose.refine import refine_all
from gva_mi.study.measure import Evaluation, PoseFigures
from gva_mi.study.regions import person_box

REFINEMENT, OVERLAYS = "refinement.json", "refinement.png"
SHOWN = 8  # frames in the picture
MARGIN = 0.1  # around the person, a share of the longer side


def refine_videos(
    videos: Sequence[Video],
    body: BodyModel,
    options: RefineOptions,
    progress: Progress | None = None,
    workers: int = 1,
) -> Iterator[Evaluation]:
    """Refine videos, and write each result into its subject's folder as soon as it is ready.

    Args:
        videos: under their stage-1 poses.
        body: the body that all poses move.
        options: whose type chooses the method, as for :func:`gva_mi.pose.refine.refine`.
        progress: called as ``progress(done, total, **figures)`` as the work goes on.
        workers: processes on this machine; any number gives the same bits.
    """
    truths = [_truth(video, body) for video in videos]
    with local_executor(workers) as executor:
        found = refine_all(videos, body, options, progress, executor)
        for video, (truth, problem), refined in zip(videos, truths, found, strict=True):
            evaluation = Evaluation(video, body, options, refined, truth, problem)
            write_refinement(evaluation)
            yield evaluation


def _truth(video: Video, body: BodyModel) -> tuple[GroundTruth | None, str | None]:
    """Read the ground truth. If it cannot be used, return why: only the figures need it."""
    try:
        return truth_of(video, body), None
    except InputError as error:
        return None, str(error)


def describe(evaluation: Evaluation) -> Iterator[str]:
    """Yield lines for the user about a refinement, its figures and its files."""
    video, refined = evaluation.video, evaluation.refined
    if evaluation.truth_problem:
        yield f"{evaluation.truth_problem}; the refinement is not measured"
    if video.normals is None:
        yield f"{video.folder}: no normals, the refinement used the silhouettes alone"
    for frame, reason in refined.kept.items():
        yield f"{video.folder}: frame {frame} keeps its stage-1 pose: {reason}"
    for limbs, frames in refined.swapped.items():
        yield f"{limbs:11} left and right were exchanged in frames {listed(frames)}"
    yield from describe_prior(refined.noise, refined.contact)
    yield from evaluation.measured.means.lines()
    yield f"poses: {video.folder / REFINED_POSES}; overlays: {video.folder / OVERLAYS}"


def describe_prior(
    noise: Mapping[str, Stage1ErrorModel], contact: ContactStats | None
) -> Iterator[str]:
    """Yield lines for the user on stage 1's errors and foot contact, if they were inferred."""
    if not noise:
        return
    turns = ", ".join(f"{name} {np.degrees(noise[name].size):.1f}°" for name in GROUPS)
    places = " and ".join(f"{1000 * noise[name].size:.0f} mm {name}" for name in AXES)
    moving = ", more in motion" if any(n.lag for n in noise.values()) else ""
    yield f"stage 1     errs by {turns}; by {places}{moving}"
    white = ", ".join(f"{name} {np.degrees(noise[name].white):.1f}°" for name in GROUPS)
    lasts = sorted({noise[name].memory for name in GROUPS})
    yield f"            white {white}; the rest lasts {lasts[0]:g} to {lasts[-1]:g} frames"
    if contact is not None:
        stands = f"soles stand {contact.share:.0%} of the time"
        yield f"ground      {stands}, within {1000 * contact.spread:.0f} mm of one plane"


def write_refinement(evaluation: Evaluation) -> None:
    """Write the three files."""
    video, refined, options = evaluation.video, evaluation.refined, evaluation.options
    folder: Path = video.folder
    record = {
        "figures": evaluation.measured.means.to_json(),
        "stage1_errors": {name: asdict(noise) for name, noise in refined.noise.items()},
        "footing": None if refined.contact is None else asdict(refined.contact),
        "swapped": refined.swapped,
        "test_frames": "held out" if refined.held_out else "seen",
        **({"figures_by_split": _by_split(evaluation)} if refined.held_out else {}),
        "kept": refined.kept,
        "without_normals": refined.without_normals,
        "normals": video.normals.convention if video.normals else None,
        "options": {"loss": options.name, **asdict(options)},
    }
    pose, shape, offsets = refined.pose, refined.shape, refined.offsets
    with atomic_files(folder / REFINED_POSES, REFINEMENT, OVERLAYS) as unfinished:
        save_poses(unfinished / REFINED_POSES, pose, shape, stage=2, offsets=offsets)
        write_record(unfinished / REFINEMENT, record)
        write_image(unfinished / OVERLAYS, _overlays(evaluation))


def load_refinement(subject: Path) -> tuple[PoseFigures, bool]:
    """Read a subject's figures, and whether its refinement saw the test frames.

    A subject without the file has no figures; the paper's protocol, which sees them, is assumed.

    Raises:
        InputError: the file cannot be read.
    """
    path, expected = subject / REFINEMENT, "what `gva-mi refine` writes"
    if not path.exists():
        return PoseFigures.from_json({}), True
    record = read_json(path, expected)
    with expecting(path, expected):
        figures = PoseFigures.from_json(record["figures"])
        return figures, record.get("test_frames", "seen") == "seen"


def _by_split(evaluation: Evaluation) -> dict[str, dict]:
    """Return the figures of seen and of held-out frames."""
    held_out = evaluation.refined.held_out
    seen = [k for k in range(len(evaluation.video)) if k not in held_out]
    splits = {"train": seen, "test": held_out}
    return {name: evaluation.measured.of(some).means.to_json() for name, some in splits.items()}


@torch.no_grad()
def _overlays(evaluation: Evaluation) -> np.ndarray:
    """Draw bodies over evenly spaced frames, stage 1 above, refined below, in 8 bits."""
    video, body, refined = evaluation.video, evaluation.body, evaluation.refined
    shown = spread([k for k in range(len(video)) if k not in video.absent], SHOWN)
    scene, cameras = MeshScene(body.faces, body.v_template), refined.cameras or video.cameras
    seen = np.any([outline.mask > 0.5 for outline in video.outlines(shown)], axis=0)
    part = person_box(seen if seen.any() else ~seen, MARGIN)
    rows: list[list[np.ndarray]] = [[], []]
    for frame in video.frames(shown):  # one at a time: eight of 1080p as floats take a gigabyte
        k = frame.index
        before, after = body(video.pose[k], video.shape), body(refined.pose[k], refined.shape)
        for row, posed, camera in ((rows[0], before, frame.camera), (rows[1], after, cameras[k])):
            drawn = overlay(frame.image, camera, posed.vertices[0], body.faces, scene)
            row.append(in_8_bits(part.cut(drawn)))
    return strip(rows)
