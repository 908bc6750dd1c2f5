"""Compare an avatar's renders with pictures, split by split and region by region.

The protocol of every metric: the target is the picture cut out by its mask
(:mod:`gva_mi.data.backdrop`); target and render stand on the same plain background; both are
clamped to [0, 1] and rounded to 8 bits; scores are averaged over the frames of a split.

=============  ========================================================  ====================
split          frames                                                    poses
=============  ========================================================  ====================
train          of the video, seen in training, evenly spaced             the video's
test           of the video, never seen in training                      the video's
held_out_range a stretch of consecutive test frames, which are not in    the video's
               ``test`` then (:mod:`gva_mi.data.splits`)
novel_pose     of another motion, synthetic subjects only                ground truth
novel_view     of the video's motion from other cameras: synthetic       ground truth, or the
               subjects, or a data set's (:mod:`gva_mi.data.ground_truth`)      video's
=============  ========================================================  ====================

=============  =======================================================================
region         pixels: :mod:`gva_mi.study.regions`
=============  =======================================================================
white          the whole picture on white: what tables of this field mean, and every
               figure here that names no region
black          the whole picture on black, where white clothes are visible
person         the person's box on white: independent of the picture's size
hands, face    the boxes of visible hands, and of a visible face, on white
=============  =======================================================================

"The video's" poses are those the video was opened with: refined, or trained with the avatar
(:mod:`gva_mi.fit.poses`). No pose is fitted to a picture that it is measured on; poses that are
(:mod:`gva_mi.fit.photometric`) have rows of their own. Masks are the ground-truth ones of a
synthetic subject, so that scores measure the avatar and not the segmenter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.data.crop import Box
from gva_mi.data.ground_truth import held_out_views
from gva_mi.data.splits import spread
from gva_mi.data.video import Frame, Video, load_video
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.renders import BLACK, WHITE, cut_out, render_frame
from gva_mi.study.regions import Detail, Details, person_box
from gva_mi.study.scores import ImageScores, Scorer, mean_scores

Split = Literal["train", "test", "held_out_range", "novel_pose", "novel_view"]
SPLITS: tuple[Split, ...] = get_args(Split)
OF_VIDEO: tuple[Split, ...] = ("train", "test", "held_out_range")  # frames of the video itself
Region = Literal["white", "black", "person"] | Detail
REGIONS: tuple[Region, ...] = ("white", "black", "person", "hands", "face")
TRAIN_FRAMES = 16  # evaluated frames of the train split


@dataclass(frozen=True)
class SplitScores:
    """Mean scores over the frames of a split."""

    name: str  # of the run, or of the poses it is rendered under
    split: Split
    psnr: float
    ssim: float
    lpips: float | None  # None without the user's weights
    rand_vgg: float
    region: Region = "white"
    count: int = 0  # pictures, or boxes, in the mean; 0: not recorded

    @staticmethod
    def mean(
        name: str, split: Split, scores: Sequence[ImageScores], region: Region = "white"
    ) -> SplitScores:
        """Average the scores of the frames of a split."""
        return SplitScores(name, split, *mean_scores(scores), region, len(scores))


@dataclass(frozen=True)
class SplitView:
    """The frames of a split, and the poses and cameras they are rendered under."""

    split: Split
    video: Video
    frames: Sequence[int]
    details: Details | None = None  # None: hands and face are not measured

    def through(self, change: Callable[[Video], Video]) -> SplitView:
        """Return the same pictures under other poses or cameras; details stay in place."""
        return replace(self, video=change(self.video))


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
    name: str = "full",
    splits: Sequence[Split] = SPLITS,
    weights: Weights | None = None,
    body: BodyModel | None = None,
) -> list[SplitScores]:
    """Measure an avatar on splits of a video: :func:`evaluate_views` of :func:`views_of`."""
    return evaluate_views(avatar, views_of(video, splits, body), name, Scorer(weights))


def evaluate_views(
    avatar: Avatar,
    views: Sequence[SplitView],
    name: str,
    scorer: Scorer,
    progress: Progress | None = None,
) -> list[SplitScores]:
    """Measure an avatar on some views; scores are named ``name``.

    Returns:
        The scores of each view, region by region, without regions that no frame has.
    """
    rows, done, total = [], 0, sum(len(view.frames) for view in views)
    for view in views:
        scores: dict[Region, list[ImageScores]] = {region: [] for region in REGIONS}
        for frame in view.video.frames(view.frames):
            for region, found in _scores(avatar, frame, view, scorer):
                scores[region].append(found)
            done += 1
            if progress:
                progress(done, total, psnr=scores["white"][-1].psnr)
        rows += [SplitScores.mean(name, view.split, s, region) for region, s in scores.items() if s]
    return rows


def _scores(
    avatar: Avatar, frame: Frame, view: SplitView, scorer: Scorer
) -> Iterator[tuple[Region, ImageScores]]:
    """Score the render of a frame region by region, cut out by the true mask if it is known."""
    frame = view.video.truly_cut(frame)
    pairs = [
        (render_frame(avatar, frame.pose, frame.camera, on), cut_out(frame, on))
        for on in (WHITE, BLACK)
    ]
    boxes: list[tuple[Region, Box]] = [("person", person_box(frame.mask))]
    if view.details is not None:
        boxes += view.details.boxes(frame.index)
    pairs += [tuple(map(box.cut, pairs[0])) for _, box in boxes]
    regions: list[Region] = ["white", "black", *(region for region, _ in boxes)]
    return zip(regions, scorer.of_pairs(pairs), strict=True)


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
