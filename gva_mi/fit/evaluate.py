"""How close an avatar's renders come to pictures: PSNR, SSIM, LPIPS and ``rand_vgg`` on the splits.

The protocol, the same for every figure of the project:

* the render has a white background, the target is the picture cut out by its mask, on white;
* both are clamped to [0, 1] and rounded to 8 bits, as if they had been saved and read again;
* every figure is taken over the whole image and averaged over the frames of the split;
* PSNR is limited to what rounding allows, :data:`PSNR_MAX`, which equal pictures reach;
* SSIM is that of Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, population covariance.

=============  ========================================================  ============
split          frames                                                    poses
=============  ========================================================  ============
train          of the video, seen in training, evenly spaced             the video's
test           of the video, never seen in training                      the video's
novel_pose     of another motion, synthetic subjects only                true
novel_view     of the video's motion from other cameras, likewise        true
=============  ========================================================  ============

"The video's" poses are those the video was opened with: the refined ones after stage 2, or those
trained with the avatar (see :mod:`gva_mi.fit.poses`). The poses of the test frames then come from
their own masks and normals, as in the paper, and from their neighbours. No pose is fitted to a test
picture; where a table is to show what that would be worth, such poses
(:mod:`gva_mi.fit.photometric`) have a row of their own.

Masks are the true ones where the subject has a truth, for a figure should tell the avatar's error
and not the segmenter's; training never sees them. Real videos have their own masks alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Literal

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.console import Progress
from gva_mi.data.video import Frame, Video, load_video, spread
from gva_mi.fit.perceptual import FeatureMetric, Weights, find_weights, lpips, rand_vgg
from gva_mi.fit.renders import cut_out, render_frame

Split = Literal["train", "test", "novel_pose", "novel_view"]
SPLITS: tuple[Split, ...] = ("train", "test", "novel_pose", "novel_view")
TRAIN_FRAMES = 16  # of the train split that are evaluated

# The PSNR of rounding to 8 bits, an error with a variance of 1/12 of a level squared: 58.9 dB.
PSNR_MAX = float(20 * np.log10(255) + 10 * np.log10(12))


@dataclass(frozen=True)
class ImageScores:
    """How close one render comes to its target."""

    psnr: float  # dB, more is better
    ssim: float  # at most 1, more is better
    lpips: float  # less is better; NaN without the user's weights
    rand_vgg: float  # less is better; comparable only with itself


@dataclass(frozen=True)
class SplitScores:
    """How close the renders of a split come to their targets: means over its frames."""

    name: str  # of the run, or of the poses it is rendered under
    split: Split
    psnr: float
    ssim: float
    lpips: float | None  # None without the user's weights
    rand_vgg: float

    @staticmethod
    def mean(name: str, split: Split, scores: Sequence[ImageScores]) -> SplitScores:
        """The means over the frames of a split."""
        mean = ImageScores(*np.mean([astuple(s) for s in scores], axis=0).tolist())
        perceptual = None if np.isnan(mean.lpips) else mean.lpips
        return SplitScores(name, split, mean.psnr, mean.ssim, perceptual, mean.rand_vgg)


class Scorer:
    """Scores a render against its target, with the networks of the metrics loaded once."""

    def __init__(self, weights: Weights | None = None) -> None:
        self.rand_vgg = rand_vgg()
        self.lpips: FeatureMetric | None = lpips(find_weights() if weights is None else weights)

    def __call__(self, render: np.ndarray, target: np.ndarray) -> ImageScores:
        """The scores of two 8-bit images (H, W, 3)."""
        a, b = (torch.from_numpy(x.astype(np.float32) / 255) for x in (render, target))
        return ImageScores(
            psnr(render, target),
            ssim(render, target),
            np.nan if self.lpips is None else float(self.lpips(a, b)),
            float(self.rand_vgg(a, b)),
        )


def psnr(render: np.ndarray, target: np.ndarray) -> float:
    """Peak signal-to-noise ratio of two 8-bit images, dB, at most :data:`PSNR_MAX`."""
    from skimage.metrics import mean_squared_error, peak_signal_noise_ratio

    if mean_squared_error(render, target) == 0:
        return PSNR_MAX
    return min(PSNR_MAX, float(peak_signal_noise_ratio(target, render)))


def ssim(render: np.ndarray, target: np.ndarray) -> float:
    """Structural similarity of two 8-bit images (H, W, 3), both sides at least 11 pixels."""
    from skimage.metrics import structural_similarity

    return float(
        structural_similarity(
            target,
            render,
            channel_axis=-1,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )


def evaluate(
    avatar: Avatar,
    video: Video,
    name: str = "full",
    splits: Sequence[Split] = SPLITS,
    weights: Weights | None = None,
    progress: Progress | None = None,
) -> list[SplitScores]:
    """Measure an avatar on the splits of a video.

    Args:
        avatar: the fitted one.
        video: opened with the poses to evaluate under, see the module's table.
        name: of the run, for the scores.
        splits: those wanted; one that the video does not have gives no scores.
        weights: for LPIPS; None: those that :func:`~gva_mi.fit.perceptual.find_weights` finds.
        progress: called after each frame with its PSNR.

    Returns:
        The scores of each split, in the order of ``splits``.

    Raises:
        InputError: a truth folder that cannot be read.
    """
    frames = {split: found for split in splits if (found := _frames(video, split))}
    scorer, rows = Scorer(weights), []
    done, total = 0, sum(len(indices) for _, indices in frames.values())
    for split, (source, indices) in frames.items():
        scores = []
        for frame in source.frames(indices):
            target = cut_out(_with_true_mask(frame, source))
            scores.append(scorer(render_frame(avatar, frame.pose, frame.camera), target))
            done += 1
            if progress:
                progress(done, total, psnr=scores[-1].psnr)
        rows.append(SplitScores.mean(name, split, scores))
    return rows


def true_video(video: Video, split: Split) -> Video | None:
    """What the truth of a synthetic subject holds for a split, if it holds anything.

    Raises:
        InputError: a folder that cannot be read.
    """
    folder = video.truth / split if video.truth else None
    return load_video(folder) if folder is not None and folder.is_dir() else None


def _frames(video: Video, split: Split) -> tuple[Video, Iterable[int]] | None:
    """Where the frames of a split are read from, and which; None if the video has no such split."""
    if split == "train":
        return video, spread(video.splits.train, TRAIN_FRAMES)
    if split == "test":
        return (video, video.splits.test) if video.splits.test else None
    source = true_video(video, split)
    return (source, range(len(source))) if source else None


def _with_true_mask(frame: Frame, video: Video) -> Frame:
    mask = video.true_mask(frame.index)
    return frame if mask is None else replace(frame, mask=mask)
