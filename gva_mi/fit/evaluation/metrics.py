"""``metrics.json``: the figures of a run. They are measured, written, read and shown here.

::

    rows         scores of the renders, by split and region: gva_mi.fit.evaluation.evaluate
    protocol     network and weights of each perceptual figure; what had seen what
    similarity   from the avatar's world to the true one; null where it is not known
    surface      how the Gaussians lie on the true surface; empty where it is not known
    refinement   errors of the poses before and after stage 2; null where they are not known
    training     steps, seconds, Gaussians, size of the pictures
    poses_mm     errors of the poses given and trained, means over frames by the names of
                 gva_mi.pose.evaluation.errors; empty where poses were not trained or no truth is
    options, versions, seed       of the run
    pose_fit     where asked for: how poses were fitted to the pictures they are measured on
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from gva_mi.avatar.avatar import Avatar, Rig
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress, within
from gva_mi.data.truth import POSES, load_truth
from gva_mi.data.video import REFINED_POSES, Video
from gva_mi.errors import expecting
from gva_mi.files import read_json, write_json
from gva_mi.fit import run_folder
from gva_mi.fit.evaluation.evaluate import (
    SplitScores,
    View,
    as_trained,
    evaluate_views,
    views_of,
)
from gva_mi.fit.evaluation.scores import Scorer
from gva_mi.fit.evaluation.similarity import Similarity, in_avatars_world, similarity_to_truth
from gva_mi.fit.evaluation.surface_figures import SurfaceFigures, surface_figures
from gva_mi.fit.photometric import FITTED, PhotometricOptions, fit_poses
from gva_mi.fit.tracking import TRACKED_POSES
from gva_mi.pose.evaluation.errors import pose_errors
from gva_mi.pose.evaluation.figures import PoseFigures
from gva_mi.pose.evaluation.record import REFINEMENT
from gva_mi.records import from_json

REFINED = "what `gva-mi refine` writes"  # into REFINEMENT

# Names of rows that are rendered otherwise than the run's own.
AS_REFINED = "poses as refined"  # test frames without the trained poses
ALIGNED = "after one similarity transform"  # novel poses and views in the avatar's own world

GIVEN, TRAINED = "given", "trained"  # keys of poses_mm

POSE_FIT_STEPS = 100  # at least; one of them turns or shifts by little
SEEN_BY_FIT = ("pictures", "masks")


@dataclass(frozen=True)
class Training:
    """What the fit of an avatar took, and what came of it."""

    steps: int
    seconds: float
    gaussians: int
    size: tuple[int, int]  # (W, H) of the pictures, pixels


@dataclass(frozen=True)
class PoseFit:
    """How poses were fitted to the pictures that they are measured on."""

    options: dict[str, Any]  # of each split
    kept: dict[str, str]  # frames that keep the pose they had, such as "test 3", and why
    seconds_per_frame: float


@dataclass(frozen=True)
class Protocol:
    """What the figures were measured with, and what had seen the frames they were measured on."""

    networks: dict[str, Any]  # of each perceptual figure: see Scorer.networks
    training_loss: str  # the perceptual term that the avatar was trained with
    masks: str  # that cut out the targets: "true", or "the video's"
    seen: dict[str, list[str]]  # what of test and novel frames was seen, and by whom

    @staticmethod
    def of(scorer: Scorer, video: Video, poses: Path, options: dict[str, Any]) -> Protocol:
        """The protocol of a run's figures.

        Args:
            scorer: of the figures.
            video: the fit's.
            poses: the file of poses that it was opened with.
            options: of the fit.
        """
        pictures, masks = ["stage 1"], []  # an estimator looks at every frame
        if poses.name == REFINED_POSES and _refinement_looked_at_test_frames(poses.parent):
            masks = ["refine"]
        elif poses.name == TRACKED_POSES:
            pictures, masks = [*pictures, "track"], ["track"]
        normals = ["refine"] if "refine" in masks and video.has_normals else []
        return Protocol(
            networks=scorer.networks(),
            training_loss=f"VGG16, {options['vgg16']}" if options.get("vgg16") else "rand_vgg",
            masks="true" if video.true_mask(video.splits.train[0]) is not None else "the video's",
            seen={"test pictures": pictures, "test masks": masks, "test normals": normals},
        )


@dataclass(frozen=True)
class Metrics:
    """All figures of a run."""

    rows: tuple[SplitScores, ...]
    refinement: PoseFigures  # all None where the poses were not refined by this program
    training: Training
    options: dict[str, Any]  # of the fit
    versions: dict[str, str]
    protocol: Protocol | None = None  # None in files of older versions
    similarity: dict[str, float] | None = None
    surface: tuple[SurfaceFigures, ...] = ()
    pose_fit: PoseFit | None = None
    poses_mm: dict[str, dict[str, float]] = field(default_factory=dict)

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
            "protocol": asdict(self.protocol) if self.protocol else None,
            "similarity": self.similarity,
            "surface": [asdict(figures) for figures in self.surface],
            "poses_mm": self.poses_mm,
            "options": self.options,
            "versions": self.versions,
            "seed": self.seed,
        }
        return record | ({"pose_fit": asdict(self.pose_fit)} if self.pose_fit else {})

    @staticmethod
    def from_json(record: dict[str, Any]) -> Metrics:
        """The inverse of :meth:`to_json`."""
        kept = {f.name: record[f.name] for f in fields(Metrics) if f.name in record}
        kept["refinement"] = PoseFigures.from_json(record["refinement"])
        return from_json(Metrics, kept)

    def lines(self) -> Iterator[str]:
        """The main figures, a line each."""
        yield from self.refinement.lines()
        before, after = (self.poses_mm.get(which, {}) for which in (GIVEN, TRAINED))
        keys = [key for key in ("body", "body_aligned") if key in before and key in after]
        if keys:
            errors = (f"{before[key]:.1f} → {after[key]:.1f} mm" for key in keys)
            yield f"{TRAINED:<11} {', aligned '.join(errors)}"
        for row in self.rows:
            if row.region in ("white", "hands", "face"):
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
) -> Metrics:
    """Measure the avatar of a run on all splits of its video.

    Args:
        run: the folder of the finished fit.
        avatar: what was fitted.
        video: opened with the poses that the fit began with.
        name: of the run, for its rows.
        body: the body model that was fitted; it says where hands and face are.
        poses: the file that holds the poses that the fit began with.
        progress: called after each frame.
        driven: what becomes of every pose before it drives the avatar.
    """
    trained, scorer = run_folder.under_trained_poses(video, run), Scorer()
    given = [
        view.through(lambda source: replace(source, pose=driven(source.pose)))
        for view in views_of(video, body=body)
    ]
    views = [as_trained(view, trained) for view in given]
    similarity = similarity_to_truth(avatar.rig, trained, body)
    named = [(name, views)]
    if trained is not video:  # what training the poses is worth to frames that it has not seen
        named.append((AS_REFINED, [view for view in given if view.split == "test"]))
    if similarity is not None:
        named.append((ALIGNED, aligned_views(views, similarity, avatar.rig, body)))
    total, done = sum(len(view.frames) for _, some in named for view in some), 0
    rows: list[SplitScores] = []
    for title, some in named:
        frames = sum(len(view.frames) for view in some)
        rows += evaluate_views(avatar, some, title, scorer, within(progress, done, frames, total))
        done += frames
    made_with = run_folder.load_options(run)
    return Metrics(
        rows=tuple(rows),
        refinement=_load_refinement(video.folder),
        training=_training(run, video),
        options=made_with["options"],
        versions=made_with["versions"],
        protocol=Protocol.of(scorer, video, poses, made_with["options"]),
        similarity=None if similarity is None else similarity.to_json(),
        surface=surface_figures(run, avatar, video.folder, body),
        poses_mm=_errors(video, trained, body),
    )


def _errors(video: Video, trained: Video, body: BodyModel) -> dict[str, dict[str, float]]:
    """How far the poses of a video are off, before and after they were trained."""
    if trained is video or video.truth is None or not (video.truth / POSES).is_file():
        return {}
    truth = load_truth(video.truth, body)
    both = {GIVEN: video, TRAINED: trained}
    return {
        name: pose_errors(body, (which.pose, which.shape), truth).means()
        for name, which in both.items()
    }


def _training(run: Path, video: Video) -> Training:
    """What the fit in a run's folder took."""
    history = run_folder.load_history(run)
    return Training(
        steps=len(history["loss"]),
        seconds=float(history["milliseconds"].sum() / 1e3),
        gaussians=int(history["gaussians"][-1]),
        size=video.size,
    )


def aligned_views(
    views: Sequence[View], similarity: Similarity, rig: Rig, body: BodyModel
) -> list[View]:
    """Views of the true world in the avatar's: :mod:`gva_mi.fit.evaluation.similarity`."""
    return [
        view.through(lambda source: in_avatars_world(similarity, source, rig, body))
        for view in views
        if view.split in ("novel_pose", "novel_view")
    ]


def with_fitted_poses(
    metrics: Metrics,
    avatar: Avatar,
    video: Video,
    trained: Video,
    body: BodyModel,
    progress: Progress | None = None,
) -> Metrics:
    """Add rows for frames under poses that are fitted to these very frames.

    The test frames are fitted from the poses that follow from training, and novel poses and views
    of a truth from the true ones in the avatar's world: how good the avatar is, wherever in it its
    skeleton stands.

    Args:
        metrics: of the run.
        avatar: what was fitted.
        video: opened with the poses that the fit began with; they say where hands and face are.
        trained: opened with the poses that the avatar was trained under, which are fitted.
        body: the body model that was fitted.
        progress: called after each step of the pose fit.
    """
    starts = [as_trained(view, trained) for view in views_of(video, ("test",), body)]
    similarity = similarity_to_truth(avatar.rig, trained, body)
    if similarity is not None:
        novel = views_of(video, ("novel_pose", "novel_view"), body)
        starts += aligned_views(novel, similarity, avatar.rig, body)
    options = {view.split: _pose_fit_options(len(view.frames)) for view in starts}
    steps = [len(view.frames) * options[view.split].passes for view in starts]
    rows, kept, seconds, fitted = [], {}, 0.0, 0
    for done, view in enumerate(starts):
        told = within(progress, sum(steps[:done]), steps[done], sum(steps))
        found = fit_poses(avatar, view.video, options[view.split], view.frames, told)
        posed = view.through(lambda source, pose=found.pose: replace(source, pose=pose))
        rows += evaluate_views(avatar, [posed], FITTED, Scorer())
        kept |= {f"{view.split} {frame}": reason for frame, reason in found.kept.items()}
        seconds += found.seconds_per_frame * len(view.frames)
        fitted += len(view.frames)
    protocol = metrics.protocol
    if protocol is not None:
        looked_at = {view.split.split("_")[0] for view in starts}  # test, novel
        by_fit = {
            name: [*protocol.seen.get(name, []), FITTED]
            for name in (f"{split} {what}" for split in sorted(looked_at) for what in SEEN_BY_FIT)
        }
        protocol = replace(protocol, seen=protocol.seen | by_fit)
    made_with = {split: asdict(some) for split, some in options.items()}
    return replace(
        metrics,
        rows=(*metrics.rows, *rows),
        protocol=protocol,
        pose_fit=PoseFit(made_with, kept, seconds / max(1, fitted)),
    )


def _pose_fit_options(frames: int) -> PhotometricOptions:
    """Those of ``track``, with more passes over the few frames of a test split."""
    usual = PhotometricOptions()
    steps_of_a_pass = max(1, math.ceil(frames / usual.batch))
    return replace(usual, passes=max(usual.passes, math.ceil(POSE_FIT_STEPS / steps_of_a_pass)))


def save_metrics(run: Path, metrics: Metrics) -> None:
    """Write the figures into a run's folder."""
    write_json(run / run_folder.METRICS, metrics.to_json())


def load_metrics(run: Path) -> Metrics:
    """Read the figures of a run that was evaluated.

    Raises:
        InputError: there are none, or they cannot be read.
    """
    path = run / run_folder.METRICS
    record = read_json(path, "what `gva-mi evaluate` writes")
    with expecting(path, "what `gva-mi evaluate` writes"):
        return Metrics.from_json(record)


def _load_refinement(subject: Path) -> PoseFigures:
    """The figures of a subject's refinement; all None where it has none."""
    path = subject / REFINEMENT
    if not path.exists():
        return PoseFigures.from_json({})
    record = read_json(path, REFINED)
    with expecting(path, REFINED):
        return PoseFigures.from_json(record["figures"])


def _refinement_looked_at_test_frames(subject: Path) -> bool:
    """What a subject's refinement.json says; the paper's protocol, where there is none, looks."""
    path = subject / REFINEMENT
    if not path.exists():
        return True
    record = read_json(path, REFINED)
    with expecting(path, REFINED):
        return record.get("test_frames", "seen") == "seen"
