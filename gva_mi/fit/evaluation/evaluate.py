"""How close an avatar's renders come to pictures, split by split and region by region.

The protocol, the same for every figure of the project:

* the target is the picture cut out by its mask, without the backdrop that soft pixels of the
  outline show (:mod:`gva_mi.data.backdrop`), and both stand on the same plain background;
* both are clamped to [0, 1] and rounded to 8 bits, as if they had been saved and read again;
* every figure is taken over a region of the picture and averaged over the frames of the split.

=============  ========================================================  ====================
split          frames                                                    poses
=============  ========================================================  ====================
train          of the video, seen in training, evenly spaced             the video's
test           of the video, never seen in training                      the video's
novel_pose     of another motion, synthetic subjects only                true
novel_view     of the video's motion from other cameras                  true, or the video's
=============  ========================================================  ====================

Novel views are with the truth of a synthetic subject, or are what a data set's other cameras saw
(:mod:`gva_mi.data.views`).

=============  =======================================================================
region         pixels: :mod:`gva_mi.fit.evaluation.regions`
=============  =======================================================================
white          the whole picture, on white: what tables of this field mean, and every
               figure here that names no region
black          the whole picture, on black: white clothes are told from white nothing
person         the person's box, on white: free of the size of the picture
hands          the boxes of hands that are seen, on white
face           the face's box where it is seen, on white
=============  =======================================================================

"The video's" poses are those the video was opened with: the refined ones after stage 2, or those
trained with the avatar (see :mod:`gva_mi.fit.poses`). The poses of the test frames then come from
their own masks and normals, as in the paper, and from their neighbours. No pose is fitted to a
picture that it is measured on; where a table is to show what that would be worth, such poses
(:mod:`gva_mi.fit.photometric`) have rows of their own.

Masks are the true ones where the subject has a truth, for a figure should tell the avatar's error
and not the segmenter's; training never sees them. Real videos have their own masks alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from typing import Literal

import numpy as np

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress
from gva_mi.data.video import Frame, Video, load_video, spread
from gva_mi.data.views import held_out_views
from gva_mi.fit.evaluation.defects import Defects, flicker
from gva_mi.fit.evaluation.regions import Detail, Details, person_box
from gva_mi.fit.evaluation.scores import ImageScores, Scorer
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.renders import BLACK, WHITE, cut_out, render_frame
from gva_mi.pose.crop import Box

Split = Literal["train", "test", "novel_pose", "novel_view"]
SPLITS: tuple[Split, ...] = ("train", "test", "novel_pose", "novel_view")
Region = Literal["white", "black", "person"] | Detail
REGIONS: tuple[Region, ...] = ("white", "black", "person", "hands", "face")
TRAIN_FRAMES = 16  # of the train split that are evaluated


@dataclass(frozen=True)
class SplitScores:
    """How close the renders of a split come to their targets: means over its frames."""

    name: str  # of the run, or of the poses it is rendered under
    split: Split
    psnr: float
    ssim: float
    lpips: float | None  # None without the user's weights
    rand_vgg: float
    region: Region = "white"
    count: int = 0  # pictures, or boxes, that these are the means of; 0: a file that says no number
    spill: float | None = None  # see defects.py; of whole pictures on white
    holes: float | None = None
    flicker: float | None = None  # likewise, of test frames against those before them

    @staticmethod
    def mean(
        name: str, split: Split, scores: Sequence[ImageScores], region: Region = "white"
    ) -> SplitScores:
        """The means over the frames of a split."""
        mean = ImageScores(*np.mean([astuple(s) for s in scores], axis=0).tolist())
        perceptual = None if np.isnan(mean.lpips) else mean.lpips
        figures = (mean.psnr, mean.ssim, perceptual, mean.rand_vgg)
        return SplitScores(name, split, *figures, region, len(scores))


@dataclass(frozen=True)
class View:
    """The frames of a split, and the poses and cameras that they are rendered under."""

    split: Split
    video: Video
    frames: Sequence[int]
    details: Details | None = None  # None: no figures of hands and face

    def through(self, change: Callable[[Video], Video]) -> View:
        """The same pictures under other poses or cameras; details stay where they are seen."""
        return replace(self, video=change(self.video))


def views_of(
    video: Video, splits: Sequence[Split] = SPLITS, body: BodyModel | None = None
) -> list[View]:
    """The splits of a video that it has.

    Args:
        video: opened with the poses to evaluate under, see the module's table.
        splits: those wanted.
        body: the body that the poses belong to; without it hands and face are not looked for.

    Raises:
        InputError: a truth folder that cannot be read.
    """
    details = None if body is None else Details.of(video, body)
    views = []
    for split in splits:
        if split == "train":
            views.append(View(split, video, spread(video.splits.train, TRAIN_FRAMES), details))
        elif split == "test":
            views.append(View(split, video, video.splits.test, details))
        elif (source := source_of(video, split)) is not None:
            theirs = None if body is None else Details.of(source, body)
            views.append(View(split, source, range(len(source)), theirs))
    return [view for view in views if len(view.frames)]


def evaluate(
    avatar: Avatar,
    video: Video,
    name: str = "full",
    splits: Sequence[Split] = SPLITS,
    weights: Weights | None = None,
    progress: Progress | None = None,
    body: BodyModel | None = None,
) -> list[SplitScores]:
    """Measure an avatar on the splits of a video: :func:`evaluate_views` of :func:`views_of`."""
    return evaluate_views(avatar, views_of(video, splits, body), name, Scorer(weights), progress)


def evaluate_views(
    avatar: Avatar,
    views: Sequence[View],
    name: str,
    scorer: Scorer,
    progress: Progress | None = None,
) -> list[SplitScores]:
    """Measure an avatar on some views.

    Args:
        avatar: the fitted one.
        views: what it is compared with.
        name: of the run, or of the poses, for the scores.
        scorer: of the metrics.
        progress: called after each frame with its PSNR.

    Returns:
        The scores of each view, region by region; a region that no frame has is left out.
    """
    rows, done, total = [], 0, sum(len(view.frames) for view in views)
    for view in views:
        scores: dict[Region, list[ImageScores]] = {region: [] for region in REGIONS}
        defects: list[Defects] = []
        flickers: list[float] = []
        for frame in view.video.frames(view.frames):
            shown = _Shown.of(avatar, frame, view)
            for region, found in shown.scores(view, scorer):
                scores[region].append(found)
            defects.append(shown.defects())
            before = frame.index - 1
            if view.split == "test" and before >= 0 and before not in view.video.absent:
                flickers.append(shown.flicker(_Shown.of(avatar, view.video[before], view)))
            done += 1
            if progress:
                progress(done, total, psnr=scores["white"][-1].psnr)
        whole, *parts = (
            SplitScores.mean(name, view.split, s, region) for region, s in scores.items() if s
        )
        whole = replace(whole, **asdict(Defects.mean(defects)))
        rows += [replace(whole, flicker=float(np.mean(flickers)) if flickers else None), *parts]
    return rows


@dataclass(frozen=True)
class _Shown:
    """An avatar in one frame, and what it is compared with; each on white, then on black."""

    frame: Frame  # its mask is the true one, where that is known
    renders: tuple[np.ndarray, np.ndarray]
    targets: tuple[np.ndarray, np.ndarray]

    @staticmethod
    def of(avatar: Avatar, frame: Frame, view: View) -> _Shown:
        mask = view.video.true_mask(frame.index)
        frame = frame if mask is None else replace(frame, mask=mask)
        renders = (render_frame(avatar, frame.pose, frame.camera, on) for on in (WHITE, BLACK))
        return _Shown(frame, tuple(renders), tuple(cut_out(frame, on) for on in (WHITE, BLACK)))

    def scores(self, view: View, scorer: Scorer) -> Iterator[tuple[Region, ImageScores]]:
        """In each region."""
        pairs = tuple(zip(self.renders, self.targets, strict=True))
        for region, pair in zip(("white", "black"), pairs, strict=True):
            yield region, scorer(*pair)
        boxes: list[tuple[Region, Box]] = [("person", person_box(self.frame.mask))]
        if view.details is not None:
            boxes += view.details.boxes(self.frame.index)
        for region, box in boxes:
            yield region, scorer(*(box.cut(image) for image in pairs[0]))

    def defects(self) -> Defects:
        """Of the outline."""
        return Defects.of(*self.renders, self.frame.mask)

    def flicker(self, before: _Shown) -> float:
        """Against the frame before."""
        renders = before.renders[0], self.renders[0]
        targets = before.targets[0], self.targets[0]
        return flicker(renders, targets, self.frame.mask)


def source_of(video: Video, split: Split) -> Video | None:
    """The pictures of novel poses or views; None where the subject has none.

    Raises:
        InputError: a folder that cannot be read.
    """
    found = true_video(video, split)
    return held_out_views(video) if found is None and split == "novel_view" else found


def as_trained(view: View, trained: Video) -> View:
    """A view under the poses that were trained with the avatar, where these are its poses.

    Novel poses and views of the truth keep their own.
    """
    if view.split in ("train", "test"):
        return view.through(lambda _: trained)
    known = true_video(trained, view.split) is not None
    return view if known else view.through(lambda _: source_of(trained, view.split))


def true_video(video: Video, split: Split) -> Video | None:
    """What the truth of a synthetic subject holds for a split, if it holds anything.

    Raises:
        InputError: a folder that cannot be read.
    """
    folder = video.truth / split if video.truth else None
    return load_video(folder) if folder is not None and folder.is_dir() else None
