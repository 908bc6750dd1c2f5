"""``metrics.json``: the figures of a run, measured, written, read and printed.

::

    rows         scores of the renders, by split and region: gva_mi.study.evaluate
    protocol     network and weights of each perceptual metric; which steps saw test frames
    similarity   from the avatar's world to the true one; null if unknown
    surface      how the Gaussians lie on the true surface; empty if unknown
    refinement   pose errors before and after stage 2; null if unknown
    training     steps, seconds, Gaussians, size of the pictures
    poses_mm     mean errors of the given and of the trained poses, by the names of
                 gva_mi.pose.errors; empty if no poses were trained or no ground truth is known
    options, versions, seed       of the run
    pose_fit     if asked for: how poses were fitted to the pictures they are measured on
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json, write_json
from gva_mi.core.options import from_json
from gva_mi.data.folder import REFINED_POSES
from gva_mi.data.ground_truth import truth_of
from gva_mi.data.video import Video
from gva_mi.fit import run_folder
from gva_mi.fit.photometric import TRACKED_POSES
from gva_mi.pose.errors import means, pose_errors
from gva_mi.study.evaluate import (
    OF_VIDEO,
    SplitScores,
    SplitView,
    evaluate_views,
    views_of,
    with_trained_poses,
)
from gva_mi.study.measure import ABSOLUTE, PoseFigures, changes
from gva_mi.study.measure import ALIGNED as POSE_ALIGNED
from gva_mi.study.refinement import load_refinement
from gva_mi.study.scores import Scorer
from gva_mi.study.similarity import Similarity, in_avatars_world, similarity_to_truth
from gva_mi.study.surface import SurfaceFigures, surface_figures

# Names of rows that are rendered under other poses or cameras than the run's own.
AS_REFINED = "poses as refined"  # test frames without the trained poses
ALIGNED = "after one similarity transform"  # novel poses and views in the avatar's world

GIVEN, TRAINED = "given", "trained"  # keys of poses_mm


@dataclass(frozen=True)
class Training:
    """Cost and size of the fit."""

    steps: int
    seconds: float
    gaussians: int
    size: tuple[int, int]  # (W, H) of the pictures, pixels


@dataclass(frozen=True)
class PoseFit:
    """Record of a fit of poses to the pictures that they are measured on."""

    options: dict[str, Any]  # of each split
    kept: dict[str, str]  # frames that keep the pose they had, such as "test 3", and why
    seconds_per_frame: float


def protocol_of(
    scorer: Scorer, video: Video, poses: Path, options: dict[str, Any]
) -> dict[str, Any]:
    """Describe how a run is measured.

    Args:
        scorer: whose networks are named.
        video: whose masks cut out the targets.
        poses: the file it was opened with, whose steps have seen test frames.
        options: of the fit.
    """
    pictures, masks = ["stage 1"], []  # a pose estimator looks at every frame
    if poses.name == REFINED_POSES and load_refinement(poses.parent)[1]:
        masks = ["refine"]
    elif poses.name == TRACKED_POSES:
        pictures, masks = [*pictures, "track"], ["track"]
    normals = ["refine"] if "refine" in masks and video.normals is not None else []
    return {
        "networks": scorer.networks(),
        "training_loss": f"VGG16, {options['vgg16']}" if options.get("vgg16") else "rand_vgg",
        "masks": "true" if video.true_mask(video.splits.train[0]) is not None else "the video's",
        "seen": {"test pictures": pictures, "test masks": masks, "test normals": normals},
    }


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """All figures of a run."""

    rows: tuple[SplitScores, ...]
    refinement: PoseFigures  # all None if the poses were not refined by this program
    training: Training
    protocol: dict[str, Any] = field(default_factory=dict)  # see :func:`protocol_of`
    similarity: dict[str, float] | None = None
    surface: tuple[SurfaceFigures, ...] = ()
    poses_mm: dict[str, dict[str, float]] = field(default_factory=dict)
    options: dict[str, Any]  # of the fit
    versions: dict[str, str]
    pose_fit: PoseFit | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the content of ``metrics.json``."""
        refinement = self.refinement.to_json()
        record = asdict(self) | {"refinement": refinement, "seed": self.options["seed"]}
        fit = record.pop("pose_fit")
        return record | ({"pose_fit": fit} if fit else {})

    @staticmethod
    def from_json(record: dict[str, Any]) -> Metrics:
        """Invert :meth:`to_json`."""
        kept = {f.name: record[f.name] for f in fields(Metrics) if f.name in record}
        kept["refinement"] = PoseFigures.from_json(record["refinement"])
        return from_json(Metrics, kept)

    def lines(self) -> Iterator[str]:
        """Yield the main figures, a line each, for the console."""
        yield from self.refinement.lines()
        before, after = (self.poses_mm.get(which, {}) for which in (GIVEN, TRAINED))
        for title, names in (("aligned", POSE_ALIGNED), ("absolute", ABSOLUTE)):
            shared = [name for name in names if name in before and name in after]
            if line := changes({name: (before[name], after[name]) for name in shared}):
                yield f"{TRAINED}, {title}: {line}"
        for row in self.rows:
            if row.region in ("white", "person", "hands", "face"):
                split = row.split.replace("_", " ")
                of = [row.name] if row.name != self.rows[0].name else []
                of += [f"{row.region} alone"] if row.region != "white" else []
                name = f" ({', '.join(of)})" if of else ""
                yield f"{split:<11} PSNR {row.psnr:.2f} dB, SSIM {row.ssim:.4f}{name}"


def measure_run(
    run: Path,
    avatar: Avatar,
    video: Video,
    name: str,
    body: BodyModel,
    poses: Path,
    progress: Progress | None = None,
    driven: Callable[[Pose], Pose] = lambda pose: pose,
    scorer: Scorer | None = None,
) -> Metrics:
    """Measure the avatar of a run on all splits of its video.

    Args:
        run: the folder of the finished fit.
        avatar: the fitted avatar.
        video: opened with the poses that the fit began with.
        name: of the run, for its rows.
        body: the fitted body model.
        poses: the file of the poses that the fit began with.
        progress: called after each frame.
        driven: applied to every pose before it drives the avatar.
        scorer: without it, one with the networks that are found.
    """
    made_with, history = run_folder.load_options(run), run_folder.load_history(run)
    trained, scorer = run_folder.under_trained_poses(video, run), scorer or Scorer()
    given = [
        view.through(lambda source: replace(source, pose=driven(source.pose)))
        for view in views_of(video, body=body)
    ]
    views = [with_trained_poses(view, trained) for view in given]
    similarity = similarity_to_truth(avatar.rig, trained, body)
    named = [(name, views)]
    if trained is not video:  # what training the poses is worth on frames it has not seen
        named.append((AS_REFINED, [view for view in given if view.split in OF_VIDEO[1:]]))
    if similarity is not None:
        named.append((ALIGNED, aligned_views(views, similarity, avatar.rig, body)))
    total, done = sum(len(view.frames) for _, some in named for view in some), 0
    rows: list[SplitScores] = []
    for title, some in named:
        frames = sum(len(view.frames) for view in some)
        rows += evaluate_views(
            avatar, some, title, scorer, part_of_progress(progress, done, frames, total)
        )
        done += frames
    return Metrics(
        rows=tuple(rows),
        refinement=load_refinement(video.folder)[0],
        training=Training(
            steps=len(history["loss"]),
            seconds=float(history["milliseconds"].sum() / 1e3),
            gaussians=int(history["gaussians"][-1]),
            size=video.size,
        ),
        options=made_with["options"],
        versions=made_with["versions"],
        protocol=protocol_of(scorer, video, poses, made_with["options"]),
        similarity=None if similarity is None else similarity.to_json(),
        surface=surface_figures(run, avatar, video.folder, body),
        poses_mm=_pose_errors(video, trained, body),
    )


def _pose_errors(video: Video, trained: Video, body: BodyModel) -> dict[str, dict[str, float]]:
    """Measure the poses of a video before and after they were trained."""
    truth = truth_of(video, body)
    if trained is video or truth is None:
        return {}
    both = {GIVEN: video, TRAINED: trained}
    return {name: means(pose_errors(body, (v.pose, v.shape), truth)) for name, v in both.items()}


def aligned_views(
    views: Sequence[SplitView], similarity: Similarity, rig: Rig, body: BodyModel
) -> list[SplitView]:
    """Transform views of the true world to the avatar's (:mod:`gva_mi.study.similarity`)."""
    return [
        view.through(lambda source: in_avatars_world(similarity, source, rig, body))
        for view in views
        if view.split in ("novel_pose", "novel_view")
    ]


def save_metrics(run: Path, metrics: Metrics) -> None:
    """Write the figures into a run's folder."""
    write_json(run / run_folder.METRICS, metrics.to_json())


def load_metrics(run: Path) -> Metrics:
    """Read the figures of a run.

    Raises:
        InputError: there are none, or they cannot be read.
    """
    path = run / run_folder.METRICS
    record = read_json(path, "what `gva-mi evaluate` writes")
    with expecting(path, "what `gva-mi evaluate` writes"):
        return Metrics.from_json(record)
