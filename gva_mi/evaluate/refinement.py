"""Measure a refinement, and the files that it leaves in the subject's folder.

Errors are defined in :mod:`gva_mi.evaluate.pose_errors`. The silhouette IoU compares the bare body
with a mask. Not even the ground-truth pose reaches an IoU of 1 under clothes: its IoU is the limit.

::

    subject/
      poses_refined.npz   all frames, and the offsets of the displaced surface: gva_mi.body.pose
      refinement.json     figures, frames that kept their stage-1 pose and why, options, versions
      refinement.png      the body over some frames: stage 1 above, refined below
      uncertainty.npz     covariances of joints, (T, 55, 3, 3) m²: ``joints``, ``aligned``

The other files always belong to the poses in the folder. The paper refines test frames too,
from their own masks and normals: ``"test_frames": "seen"``. If they were ``"held out"``, their
poses follow from the other frames, and figures have rows for both splits, too. ``points`` are those
that errors are taken on, vertices or joints. ``stage1_errors`` are the inferred standard deviations
of stage 1's errors (radians for joints, metres for the place) and their duration in frames.
``footing``: deviation of standing soles from one plane, share of the time they stand, and their
height otherwise, metres. ``swapped``: frames whose legs, or arms, were exchanged left and right
before the refinement.

``joints`` are covariances of the joints' places in the world, ``aligned`` of their places relative
to the pelvis (:mod:`gva_mi.refine.uncertainty`). Eq. 8 as printed leaves none.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import aligned, listed, with_reasons
from gva_mi.core.cpu import one_thread, sqrt
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_arrays, read_json, require_array, require_keys, write_arrays
from gva_mi.core.stamp import write_record
from gva_mi.evaluate.figures import Figure, Table, figures_from, pivot, table, to_json
from gva_mi.evaluate.pose_errors import pose_errors, within_region
from gva_mi.evaluate.regions import person_box
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import overlay, strip
from gva_mi.prior.error_model import GROUPS, Stage1ErrorModel
from gva_mi.prior.ground import ContactStats
from gva_mi.prior.inference import PLACE_AXES
from gva_mi.refine import RefineOptions
from gva_mi.refine.refine import Refined
from gva_mi.splat import Camera
from gva_mi.subject.crop import Box, NoEvidence, points_extent
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.subject.folder import REFINED_POSES, SubjectWriter
from gva_mi.subject.ground_truth import GroundTruth, truth_of
from gva_mi.subject.pictures import in_8_bits, write_image
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Video

REFINEMENT, OVERLAYS = "refinement.json", "refinement.png"
UNCERTAINTY = "uncertainty.npz"
OVERLAY_FRAMES = 8  # in the picture; chosen: a readable width
OVERLAY_MARGIN = 0.1  # share of the longer side around the person; chosen: bodies beside it show

PerFrame = dict[tuple[str, str, str], Tensor]  # (T,) by region, alignment and metric


@dataclass(frozen=True)
class MeasuredRefinement:
    """A refinement with its input, and its figures."""

    video: Video  # under its stage-1 poses
    body: BodyModel
    options: RefineOptions
    refined: Refined | None  # None: stage 1 alone is measured
    truth: GroundTruth | None = None  # of a synthetic subject
    truth_problem: str | None = None  # why the existing ground truth cannot be used

    @staticmethod
    def of(
        video: Video, body: BodyModel, options: RefineOptions, refined: Refined
    ) -> MeasuredRefinement:
        """Read the ground truth of a subject. If it cannot be used, keep why, for the user."""
        try:
            truth, problem = truth_of(video, body), None
        except InputError as error:
            truth, problem = None, str(error)
        return MeasuredRefinement(video, body, options, refined, truth, problem)

    @cached_property
    def per_frame(self) -> PerFrame:
        """Its figures, frame by frame."""
        return measure(self.video, self.body, self.refined, self.truth)

    def figures(self, split: str = "", frames: Sequence[int] | None = None) -> list[Figure]:
        """Average its figures over all frames, or over the frames of a split."""
        found = means(self.per_frame, frames)
        if self.refined is not None:
            found.append(Figure(metric="s a frame", value=self.refined.seconds_per_frame))
        return [replace(figure, split=split) for figure in found]


def measure(
    video: Video, body: BodyModel, refined: Refined | None, truth: GroundTruth | None = None
) -> PerFrame:
    """Compare stage 1 and the refined poses with the masks and, if given, the ground truth.

    Args:
        video: under its stage-1 poses.
        body: the fitted body.
        refined: the refined poses; None: stage 1 alone is measured.
        truth: of a synthetic subject.
    """
    states = {"stage 1": (video.pose, video.shape, None)}
    if refined is not None:
        states["refined"] = refined.pose, refined.shape, refined.cameras
    frames: PerFrame = {}
    for stage, (pose, shape, cameras) in states.items():
        if truth is not None:
            frames |= errors_of(body, (pose, shape), truth, stage)
        frames["", "", f"{stage} IoU"] = silhouette_iou(video, body, pose, shape, cameras)
    if truth is None:
        return frames
    if refined is not None and refined.uncertainty is not None:
        found = refined.pose, refined.shape
        for (region, metric), values in within_region(
            body, found, truth, refined.uncertainty
        ).items():
            frames[region, "pelvis-aligned", metric] = values
    person = truth.body, truth.pose, truth.shape, truth.cameras
    frames["", "", "true IoU"] = silhouette_iou(video, *person)
    for part in (("body", "absolute"), ("body", "pelvis-aligned"), ("hands", "absolute")):
        if refined is not None:
            before, after = (frames[*part, f"{stage} error, mm"] for stage in states)
            frames[*part, "increased"] = (after > before).float()
    return frames


def errors_of(
    body: BodyModel, found: tuple[Pose, Shape], truth: GroundTruth, stage: str
) -> PerFrame:
    """Measure poses of a stage: ``stage 1``, ``refined``, ``given`` or ``trained``."""
    kinds = {"": "absolute", "aligned": "pelvis-aligned", "depth": ""}
    errors: PerFrame = {}
    for name, values in pose_errors(body, found, truth).items():
        region, _, kind = name.partition("_")
        alignment = "wrist-aligned" if region == "fingers" else kinds[kind]
        errors[region, alignment, f"{stage} {kind if kind == 'depth' else 'error'}, mm"] = values
    return errors


def error_figures(
    body: BodyModel, found: tuple[Pose, Shape], truth: GroundTruth, stage: str
) -> list[Figure]:
    """Average the errors of poses over all frames."""
    return means(errors_of(body, found, truth, stage))


def means(per_frame: PerFrame, frames: Sequence[int] | None = None) -> list[Figure]:
    """Average over the frames, without NaN, and add the changes by the refinement.

    Returns:
        The means; ``change``, -0.5 if an error was halved; and the IoU of refined poses less that
        of the true ones.
    """
    found: dict[tuple[str, str, str], float] = {}
    for key, values in per_frame.items():
        values = values if frames is None else values[list(frames)]
        found[key] = float(values.nanmean() if key[-1].endswith("IoU") else values.mean())
    for (*part, metric), after in list(found.items()):
        before = found.get((*part, metric.replace("refined", "stage 1")))
        if metric == "refined error, mm" and before:
            found[*part, "change"] = after / before - 1
    if {("", "", "refined IoU"), ("", "", "true IoU")} <= found.keys():
        found["", "", "IoU - limit"] = found["", "", "refined IoU"] - found["", "", "true IoU"]
    return [
        Figure(region=region, alignment=alignment, metric=metric, value=value)
        for (region, alignment, metric), value in found.items()
    ]


def pose_tables(figures: Iterable[Figure]) -> Iterator[Table]:
    """Yield errors, depths and IoU at each stage, a row for each part of the body."""
    known = [figure for figure in figures if not figure.metric.startswith("given")]
    errors = ("error, mm", "change", "increased")
    tables = {"errors": errors, "depths": "depth, mm", "silhouettes": "IoU"}
    for title, ends in (tables | {"uncertainty": ("90 % region", "rms, mm")}).items():
        own = [figure for figure in known if figure.metric.endswith(ends)]
        if own:
            yield table(pivot(own, ("region", "alignment")), title)


def mask_iou(video: Video) -> float | None:
    """Return the mean IoU of a video's masks with the true ones; None if they are unknown."""
    found = []
    for frame in video.outlines(k for k in range(len(video)) if k not in video.absent):
        if (true := video.true_mask(frame.index)) is not None:
            both, either = (f(frame.mask, true).sum() for f in (np.minimum, np.maximum))
            found.append(float(both / either))
    return float(np.mean(found)) if found else None


@torch.no_grad()
def silhouette_iou(
    video: Video, body: BodyModel, pose: Pose, shape: Shape, cameras: Sequence[Camera] | None = None
) -> Tensor:
    """Return the IoU (T,) of the bare body's silhouette with the mask; NaN without a mask.

    Args:
        video: T frames.
        body, pose, shape: the body in T poses.
        cameras: of the poses; None: the video's.
    """
    scene = MeshScene(body.faces, body.v_template)
    iou = torch.full((len(pose),), torch.nan)
    with one_thread():
        for frame in video.outlines(k for k in range(len(video)) if k not in video.absent):
            mask = torch.from_numpy(frame.mask)
            vertices = body(pose[frame.index], shape).vertices[0]
            camera = frame.camera if cameras is None else cameras[frame.index]
            box, seen = _surroundings(vertices, camera), torch.zeros_like(mask)
            part = scene.render(vertices, box.cut_camera(camera), normals=False)
            box.cut(seen)[:] = part[..., 0]
            union = torch.maximum(seen, mask).sum()
            if union > 0:
                iou[frame.index] = torch.minimum(seen, mask).sum() / union
    return iou


def _surroundings(vertices: Tensor, camera: Camera) -> Box:
    """Return the part of a camera's picture that shows vertices (V, 3), world; or all of it."""
    size = camera.width, camera.height
    try:
        extent = points_extent(vertices.double().numpy(), camera, "the body")
    except NoEvidence:
        return Box(0, 0, *size)
    return extent.box(0, np.array(size))


def describe(measured: MeasuredRefinement) -> Iterator[str]:
    """Yield lines for the user about a refinement, its figures and its files."""
    video, refined = measured.video, measured.refined
    if measured.truth_problem:
        yield f"{measured.truth_problem}; the refinement is not measured"
    if video.normals is None and video.kind != VIDEO_KIND:  # a phone records none
        yield f"{video.folder}: no normals, the refinement used the silhouettes alone"
    yield from kept_poses(video, refined.kept, "stage-1 pose")
    for limbs, frames in refined.swapped.items():
        yield f"{limbs:11} left and right were exchanged in frames {listed(frames)}"
    yield from describe_prior(refined.error_models, refined.contact)
    if refined.uncertainty is not None:
        mm = joint_errors(refined.uncertainty.aligned)
        parts = ("spine3", "head", "left_wrist", "right_wrist", "left_ankle", "right_ankle")
        named = ", ".join(f"{name} {mm[JOINTS.index(name)]:.0f}" for name in parts)
        yield f"uncertain   by so many mm, relative to the pelvis: {named}"
    for found in pose_tables(measured.figures()):
        yield from aligned([found.head, *found.rows])
    yield f"poses: {video.folder / REFINED_POSES}; overlays: {video.folder / OVERLAYS}"


def kept_poses(video: Video, kept: Mapping[int, str], what: str) -> Iterator[str]:
    """Yield at most one line about the frames that keep a pose, ``what``, and the reasons."""
    if len(kept) == 1:
        yield from (f"{video.folder}: frame {k} keeps its {what}: {why}" for k, why in kept.items())
    elif kept:
        frames = with_reasons({k: why.partition(" from ")[0] for k, why in kept.items()})
        yield f"{video.folder}: {len(kept)} of {len(video)} frames keep their {what}s: {frames}"


def describe_prior(
    noise: Mapping[str, Stage1ErrorModel], contact: ContactStats | None
) -> Iterator[str]:
    """Yield lines for the user on stage 1's errors and foot contact, if they were inferred."""
    if not noise:
        return
    turns = ", ".join(f"{name} {np.degrees(noise[name].size):.1f}°" for name in GROUPS)
    places = " and ".join(f"{1000 * noise[name].size:.0f} mm {name}" for name in PLACE_AXES)
    moving = ", more in motion" if any(n.lag for n in noise.values()) else ""
    yield f"stage 1     errs by {turns}; by {places}{moving}"
    white = ", ".join(f"{name} {np.degrees(noise[name].white):.1f}°" for name in GROUPS)
    lasts = sorted({noise[name].memory for name in GROUPS})
    yield f"            white {white}; the rest lasts {lasts[0]:g} to {lasts[-1]:g} frames"
    if contact is not None:
        stands = f"soles stand {contact.share:.0%} of the time"
        yield f"ground      {stands}, within {1000 * contact.spread:.0f} mm of one plane"


def write_refinement(measured: MeasuredRefinement) -> None:
    """Write the three files."""
    video, refined, options = measured.video, measured.refined, measured.options
    folder: Path = video.folder
    held_out, figures = refined.held_out, measured.figures()
    if held_out:
        seen = [k for k in range(len(video)) if k not in held_out]
        figures += [*measured.figures("train", seen), *measured.figures("test", held_out)]
    truth = measured.truth
    record = {
        "figures": to_json(figures),
        "points": None if truth is None else "joints" if truth.foreign else "vertices",
        "stage1_errors": {name: asdict(noise) for name, noise in refined.error_models.items()},
        "footing": None if refined.contact is None else asdict(refined.contact),
        "swapped": refined.swapped,
        "test_frames": "held out" if held_out else "seen",
        "kept": refined.kept,
        "without_normals": refined.without_normals,
        "normals": video.normals.convention if video.normals else None,
        "options": {"loss": options.name, **asdict(options)},
    }
    pose, shape, offsets = refined.pose, refined.shape, refined.offsets
    for name in (REFINEMENT, OVERLAYS, UNCERTAINTY):  # which describe the older poses
        (folder / name).unlink(missing_ok=True)
    SubjectWriter(folder).refined_poses(pose, shape, offsets)
    write_record(folder / REFINEMENT, record)
    if (found := refined.uncertainty) is not None:
        arrays = {"joints": found.joints, "aligned": found.aligned}
        write_arrays(folder / UNCERTAINTY, **{k: x.float().numpy() for k, x in arrays.items()})
    write_image(folder / OVERLAYS, _overlays(measured))


def load_refinement(subject: Path) -> tuple[tuple[Figure, ...], bool]:
    """Read a subject's figures, and whether its refinement saw the test frames.

    A subject without the file has no figures; the paper's protocol, which sees them, is assumed.

    Raises:
        InputError: the file cannot be read.
    """
    path, expected = subject / REFINEMENT, "what `gva-mi refine` writes"
    if not path.exists():
        return (), True
    record = read_json(path, expected)
    with expecting(path, expected):
        return figures_from(record["figures"]), record.get("test_frames", "seen") == "seen"


def load_uncertainty(subject: Path) -> Tensor | None:
    """Read the covariances (T, 55, 3, 3) of joints relative to the pelvis, m²; None without any.

    Raises:
        InputError: the file cannot be read.
    """
    path = subject / UNCERTAINTY
    if not path.exists():
        return None
    data = read_arrays(path, "what `gva-mi refine` writes")
    require_keys(path, data, ("aligned",))
    form = (None, len(JOINTS), 3, 3)
    return torch.from_numpy(require_array(path, "aligned", data["aligned"], form))


def joint_errors(covariances: Tensor) -> Tensor:
    """Return the root mean square distances (55,), mm, of covariances (T, 55, 3, 3), m²."""
    return 1e3 * sqrt(covariances.diagonal(dim1=2, dim2=3).sum(2).mean(0))


@torch.no_grad()
def _overlays(measured: MeasuredRefinement) -> np.ndarray:
    """Draw bodies over evenly spaced frames, stage 1 above, refined below, in 8 bits."""
    video, body, refined = measured.video, measured.body, measured.refined
    shown = spread([k for k in range(len(video)) if k not in video.absent], OVERLAY_FRAMES)
    scene, cameras = MeshScene(body.faces, body.v_template), refined.cameras or video.cameras
    seen = np.any([outline.mask > 0.5 for outline in video.outlines(shown)], axis=0)
    part = person_box(seen if seen.any() else ~seen, OVERLAY_MARGIN)
    rows: list[list[np.ndarray]] = [[], []]
    for frame in video.frames(shown):  # one at a time: eight of 1080p as floats take a gigabyte
        k = frame.index
        before, after = body(video.pose[k], video.shape), body(refined.pose[k], refined.shape)
        for row, posed, camera in ((rows[0], before, frame.camera), (rows[1], after, cameras[k])):
            drawn = overlay(frame.image, camera, posed.vertices[0], body.faces, scene)
            row.append(in_8_bits(part.cut(drawn)))
    return strip(rows)
