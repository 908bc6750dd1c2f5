"""Measure an avatar: its renders beside pictures, split by split and region by region.

The protocol of every metric: the target is the picture cut out by its mask
(:mod:`gva_mi.subject.backdrop`); target and render stand on the same plain background; both are
clamped to [0, 1] and rounded to 8 bits; scores are averaged over the frames of a split.

=============  ========================================================  ====================
split          frames                                                    poses
=============  ========================================================  ====================
train          of the video, seen in training, evenly spaced             the video's
test           of the video, never seen in training                      the video's
held_out_range a stretch of consecutive test frames, which are not in    the video's
               ``test`` then (:mod:`gva_mi.subject.splits`)
novel_pose     of another motion, synthetic subjects only                ground truth
novel_view     of the video's motion from other cameras: synthetic       ground truth, or the
               subjects, or a data set's                                video's
=============  ========================================================  ====================

=============  =======================================================================
region         pixels: :mod:`gva_mi.evaluate.regions`
=============  =======================================================================
white          the whole picture on white: what tables of this field mean, and every
               figure here that names no region
person         the person's box on white: independent of the picture's size
hands, face    the boxes of visible hands, and of a visible face, on white
=============  =======================================================================

"The video's" poses are those the video was opened with: refined, or trained with the avatar
(:mod:`gva_mi.fit.poses`). No pose is fitted to a picture that it is measured on; poses that are
(:mod:`gva_mi.fit.photometric`) have rows of their own. Masks are the ground-truth ones of a
synthetic subject, so that scores measure the avatar and not the segmenter.

``metrics.json`` of a run::

    figures      rows of gva_mi.evaluate.figures: scores of the renders; errors of poses before and
                 after the refinement, and before and after training; how the Gaussians lie on the
                 true surface; the cost of the fit
    size         of the pictures, (W, H) pixels
    protocol     network and weights of each perceptual metric; which steps saw test frames; the
                 similarity from the avatar's world to the true one, if that is known; if asked
                 for, how poses were fitted to the pictures they are measured on
    options, versions       of the run
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json, write_json
from gva_mi.core.tasks import helper_processes
from gva_mi.evaluate.figures import Figure, Table, figures_from, pivot, table, to_json, where
from gva_mi.evaluate.foreign import foreign_figures
from gva_mi.evaluate.refinement import error_figures, load_refinement, pose_tables
from gva_mi.evaluate.regions import Detail, Details, person_box
from gva_mi.evaluate.scores import Scorer, mean_figures
from gva_mi.evaluate.similarity import Similarity, in_avatars_world, similarity_to_truth
from gva_mi.evaluate.surface import surface_figures
from gva_mi.fit import run_folder
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.photometric import (
    FITTED,
    SHARED_LOSSES,
    TRACKED_POSES,
    PhotometricOptions,
    fit_poses,
)
from gva_mi.fit.renders import cut_out, render_frame
from gva_mi.subject.crop import Box
from gva_mi.subject.folder import REFINED_POSES
from gva_mi.subject.ground_truth import held_out_views, truth_of
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Video, load_video

Split = Literal["train", "test", "held_out_range", "novel_pose", "novel_view"]
SPLITS: tuple[Split, ...] = get_args(Split)
OF_VIDEO: tuple[Split, ...] = ("train", "test", "held_out_range")  # frames of the video itself
Region = Literal["white", "person"] | Detail
REGIONS: tuple[Region, ...] = ("white", "person", "hands", "face")
TRAIN_FRAMES = 16  # evaluated frames of the train split; chosen: enough for a mean


# Alignments: rows that are rendered under other poses or cameras than the run's own.
AS_REFINED = "poses as refined"  # test frames without the trained poses
ALIGNED = "aligned"  # novel poses and views after one similarity transform, in the avatar's world

POSE_FIT_STEPS = 100  # at least; chosen: one step moves a pose by little


@dataclass(frozen=True)
class SplitView:
    """The frames of a split, and the poses and cameras they are rendered under."""

    split: Split
    video: Video
    frames: Sequence[int]
    details: Details | None = None  # None: hands and face are not measured
    alignment: str = ""  # how poses or cameras differ from the run's own, for its rows

    def through(self, change: Callable[[Video], Video], alignment: str = "") -> SplitView:
        """Return the same pictures under other poses or cameras; details stay in place."""
        return replace(self, video=change(self.video), alignment=alignment)


def views_of(
    video: Video, splits: Sequence[Split] = SPLITS, body: BodyModel | None = None
) -> list[SplitView]:
    """Return the views of the wanted splits that a video has.

    Args:
        video: opened with the poses to evaluate under, see the module's table.
        splits: those wanted.
        body: the body of the poses; None: hands and face are not measured.

    Raises:
        InputError: a ground-truth folder cannot be read.
    """
    in_range = video.splits.held_out_range
    own = {
        "train": spread(video.splits.train, TRAIN_FRAMES),
        "test": [k for k in video.splits.test if k not in set(in_range)],
        "held_out_range": in_range,
    }
    details = None if body is None else Details.of(video, body)
    views = []
    for split in splits:
        if split in own:
            views.append(SplitView(split, video, own[split], details))
        elif (source := source_of(video, split)) is not None:
            theirs = None if body is None else Details.of(source, body)
            seen = [k for k in range(len(source)) if k not in source.absent]
            views.append(SplitView(split, source, seen, theirs))
    return [view for view in views if len(view.frames)]


def evaluate(
    avatar: Avatar,
    video: Video,
    splits: Sequence[Split] = SPLITS,
    weights: Weights | None = None,
    body: BodyModel | None = None,
) -> list[Figure]:
    """Measure an avatar on splits of a video: :func:`evaluate_views` of :func:`views_of`."""
    return evaluate_views(avatar, views_of(video, splits, body), Scorer(weights))


def evaluate_views(
    avatar: Avatar, views: Sequence[SplitView], scorer: Scorer, progress: Progress | None = None
) -> list[Figure]:
    """Measure an avatar on some views. Those of the same pictures are measured together.

    Returns:
        The scores of each view, region by region, without regions that no frame has.
    """
    scores = [{region: [] for region in REGIONS} for _ in views]
    pictures: dict[tuple[Split, tuple[int, ...]], list[int]] = {}
    for number, view in enumerate(views):
        pictures.setdefault((view.split, tuple(view.frames)), []).append(number)
    done, total = 0, sum(len(frames) for _, frames in pictures)
    for same in pictures.values():
        for found in scorer.of_frames(_parts(avatar, [views[number] for number in same])):
            for region, of_views in found:
                for number, one in zip(same, of_views, strict=True):
                    scores[number][region].append(one)
            done += 1
            if progress:
                progress(done, total, psnr=scores[same[0]]["white"][-1].psnr)
    figures = []
    for view, of_view in zip(views, scores, strict=True):
        for region, own in of_view.items():
            if own:
                about = {"split": view.split, "region": region, "alignment": view.alignment}
                figures += mean_figures(own, **about)
    return figures


def _parts(
    avatar: Avatar, views: Sequence[SplitView]
) -> Iterator[list[tuple[Region, list[np.ndarray], np.ndarray]]]:
    """Yield each frame's regions, with the renders of all views and the target they share.

    The target is cut out by the true mask if it is known.
    """
    first = views[0]
    for frame in first.video.frames(first.frames):
        k, frame = frame.index, first.video.with_true_mask(frame)
        whole = Box(0, 0, frame.camera.width, frame.camera.height)
        boxes: list[tuple[Region, Box]] = [("white", whole), ("person", person_box(frame.mask))]
        if first.details is not None:
            boxes += first.details.boxes(k)
        renders = [render_frame(avatar, v.video.pose[k], v.video.cameras[k]) for v in views]
        target = cut_out(frame)
        if frame.overlay is not None:  # it hides what the renders show
            for picture in (*renders, target):
                picture[frame.overlay] = 255
        yield [(region, [*map(box.cut, renders)], box.cut(target)) for region, box in boxes]


def source_of(video: Video, split: Split) -> Video | None:
    """Open the pictures of novel poses or views; None if the subject has none.

    Raises:
        InputError: a folder cannot be read.
    """
    found = ground_truth_video(video, split)
    return held_out_views(video) if found is None and split == "novel_view" else found


def with_trained_poses(view: SplitView, trained: Video) -> SplitView:
    """Put a view under the poses trained with the avatar, unless its poses are ground truth."""
    if view.split in OF_VIDEO:
        return view.through(lambda _: trained)
    known = ground_truth_video(trained, view.split) is not None
    return view if known else view.through(lambda _: source_of(trained, view.split))


def ground_truth_video(video: Video, split: Split) -> Video | None:
    """Open the ground-truth folder of a split of a synthetic subject; None if there is none."""
    folder = video.truth / split if video.truth else None
    return load_video(folder) if folder is not None and folder.is_dir() else None


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """All figures of a run, and how they were measured: ``metrics.json``."""

    figures: tuple[Figure, ...]
    size: tuple[int, int]  # (W, H) of the pictures, pixels
    protocol: dict[str, Any]  # see :func:`protocol_of`
    options: dict[str, Any]  # of the fit
    versions: dict[str, str]

    def save(self, run: Path) -> None:
        """Write the figures into a run's folder."""
        record = {**vars(self), "figures": to_json(self.figures)}
        write_json(run / run_folder.METRICS, record)

    @staticmethod
    def load(run: Path) -> Metrics:
        """Read the figures of a run.

        Raises:
            InputError: there are none, or they cannot be read.
        """
        path, expected = run / run_folder.METRICS, "what `gva-mi evaluate` writes"
        record = read_json(path, expected)
        with expecting(path, expected):
            about = {name: dict(record[name]) for name in ("protocol", "options", "versions")}
            width, height = map(int, record["size"])
            figures = figures_from(record["figures"])
            return Metrics(figures=figures, size=(width, height), **about)

    def tables(self) -> list[Table]:
        """Return the main figures for the console."""
        scores = where(self.figures, split=SPLITS, metric=("PSNR, dB", "SSIM"))
        cells = pivot(scores, ("split", "alignment", "region"))
        return [*pose_tables(self.figures), table(cells, "renders")]


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
    fit_to_pictures: bool = False,
    few: int | None = None,
    workers: int = 1,
) -> Metrics:
    """Measure the avatar of a run on all splits of its video, and save its metrics.

    Args:
        run: the folder of the finished fit.
        avatar: the fitted avatar.
        video: opened with the poses that the fit began with.
        name: of the variant, for its rows.
        body: the fitted body model.
        poses: the file of the poses that the fit began with.
        progress: called after each frame, group by group.
        driven: applied to every pose before it drives the avatar.
        scorer: without it, one with the networks that are found.
        fit_to_pictures: also add the rows of :func:`_under_fitted_poses`.
        few: measure at most so many test frames, or training frames without these; None: all.
        workers: processes that fit poses to pictures, this one included.
    """
    made_with, history = run_folder.load_options(run), run_folder.load_history(run)
    trained, scorer = run_folder.under_trained_poses(video, run), scorer or Scorer()
    opened = views_of(video, body=body)
    if few is not None:
        tested = [view for view in opened if view.split == "test"] or opened[:1]
        opened = [replace(view, frames=spread(view.frames, few)) for view in tested]
    given = [
        view.through(lambda source: replace(source, pose=driven(source.pose))) for view in opened
    ]
    views = [with_trained_poses(view, trained) for view in given]
    similarity = similarity_to_truth(avatar.rig, trained, body)
    as_refined: list[SplitView] = []
    if trained is not video and few is None:  # the worth of trained poses on unseen frames
        own = [view for view in given if view.split in OF_VIDEO[1:]]
        as_refined = [replace(view, alignment=AS_REFINED) for view in own]
    aligned = []
    if similarity is not None:
        aligned = aligned_views(views, similarity, avatar.rig, body)
    options = made_with["options"]
    protocol = protocol_of(scorer, video, poses, options)
    protocol["similarity"] = None if similarity is None else similarity.to_json()
    measured = [*views, *as_refined, *aligned]
    if fit_to_pictures:
        own = [view for view in views if view.split in OF_VIDEO[1:]]
        measured += _under_fitted_poses(avatar, own, aligned, protocol, progress, workers)
    figures = evaluate_views(avatar, measured, scorer, progress)
    refinement, _ = load_refinement(video.folder)
    figures += where(refinement, split="")
    truth = truth_of(video, body)
    if trained is not video and truth is not None:
        for stage, source in (("given", video), ("trained", trained)):
            figures += error_figures(body, (source.pose, source.shape), truth, stage)
    figures += surface_figures(run, avatar, video.folder, body)
    for view in aligned:
        if view.split == "novel_pose":
            true = ground_truth_video(video, view.split)
            figures += foreign_figures(avatar, video.folder, body, true, view.video, ALIGNED)
    figures.append(Figure(metric="Gaussians", value=int(history["gaussians"][-1])))
    steps, seconds = run_folder.steps_and_seconds(run)
    figures.append(Figure(metric="steps", value=steps))
    figures.append(Figure(metric="seconds", value=seconds))
    subject = video.folder.resolve().name
    metrics = Metrics(
        figures=tuple(replace(figure, subject=subject, variant=name) for figure in figures),
        size=video.size,
        protocol=protocol,
        options=options,
        versions=made_with["versions"],
    )
    metrics.save(run)
    return metrics


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


def aligned_views(
    views: Sequence[SplitView], similarity: Similarity, rig: Rig, body: BodyModel
) -> list[SplitView]:
    """Transform views of the true world to the avatar's (:mod:`gva_mi.evaluate.similarity`)."""
    return [
        view.through(lambda source: in_avatars_world(similarity, source, rig, body), ALIGNED)
        for view in views
        if view.split in ("novel_pose", "novel_view")
    ]


def _under_fitted_poses(
    avatar: Avatar,
    own: Sequence[SplitView],
    novel: Sequence[SplitView],
    protocol: dict[str, Any],
    progress: Progress | None,
    workers: int,
) -> list[SplitView]:
    """Return frames under poses that are fitted to these very frames, as GART reports.

    Scores show the avatar, wherever its skeleton is inside it.

    Args:
        avatar: the fitted avatar.
        own: test frames of the video, under the poses that follow from training.
        novel: novel poses and views, under the true ones in the avatar's world.
        protocol: to which the options of the fit are added, and what has been seen.
        progress: called after each step of a fit.
        workers: processes that share the frames of a step.
    """
    found_views, about = [], {"options": {}, "kept": {}, "seconds_per_frame": {}}
    numbers = lambda group: sorted(k for view in group for k in view.frames)
    fits = [(group, numbers(group)) for group in (own, *([view] for view in novel)) if group]
    losses = sum(len(frames) * _pose_fit_options(len(frames)).passes for _, frames in fits)
    with helper_processes(workers, losses >= SHARED_LOSSES) as helpers:
        for group, frames in fits:
            name, options = group[0].split, _pose_fit_options(len(frames))
            found = fit_poses(avatar, group[0].video, options, frames, progress, helpers)
            posed = lambda source, pose=found.pose: replace(source, pose=pose)
            found_views += [view.through(posed, FITTED) for view in group]
            about["kept"] |= {f"{name} {frame}": reason for frame, reason in found.kept.items()}
            about["options"][name] = asdict(options)
            about["seconds_per_frame"][name] = found.seconds_per_frame
            kind = "test" if name in OF_VIDEO else "novel"
            for what in (f"{kind} pictures", f"{kind} masks"):
                if FITTED not in protocol["seen"].setdefault(what, []):
                    protocol["seen"][what].append(FITTED)
    protocol["pose_fit"] = about
    return found_views


def _pose_fit_options(frames: int) -> PhotometricOptions:
    """Return the options of ``track``, with more passes for the few frames of a test split."""
    usual = PhotometricOptions()
    steps_of_a_pass = max(1, math.ceil(frames / usual.batch))
    return replace(usual, passes=max(usual.passes, math.ceil(POSE_FIT_STEPS / steps_of_a_pass)))
