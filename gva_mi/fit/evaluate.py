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
their own masks and normals, as in the paper, and from their neighbours. No test picture is fitted;
where a table is to show what that would be worth, such poses (:mod:`gva_mi.fit.photometric`) have a
row of their own.
Masks are the true ones where the subject has a truth, for a figure should tell the avatar's error
and not the segmenter's; training never sees them. Real videos have their own masks alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.data.video import Frame, Video, load_video
from gva_mi.fit.perceptual import FeatureMetric, Weights, find_weights, lpips, rand_vgg
from gva_mi.splat import Camera, SplatOptions
from gva_mi.splat.torch_op import render

Split = Literal["train", "test", "novel_pose", "novel_view"]
SPLITS: tuple[Split, ...] = ("train", "test", "novel_pose", "novel_view")
TRAIN_FRAMES = 16  # of the train split that are evaluated

WHITE = (1.0, 1.0, 1.0)
# The PSNR of rounding to 8 bits, an error with a variance of 1/12 of a level squared: 58.9 dB.
PSNR_MAX = float(20 * np.log10(255) + 10 * np.log10(12))

Progress = Callable[..., None]


@dataclass(frozen=True)
class Row:
    """One line of the table: the means over a split's frames."""

    name: str  # of the run
    split: Split
    psnr: float  # dB, more is better
    ssim: float  # at most 1, more is better
    lpips: float | None  # less is better; None without the user's weights
    rand_vgg: float  # less is better; comparable only with itself


class Metrics:
    """The four figures of a render against its target, with their networks loaded once."""

    def __init__(self, weights: Weights | None = None) -> None:
        self.rand_vgg = rand_vgg()
        self.lpips: FeatureMetric | None = lpips(find_weights() if weights is None else weights)

    def __call__(self, render: np.ndarray, target: np.ndarray) -> np.ndarray:
        """PSNR, SSIM, LPIPS (NaN if there is none), rand_vgg of two 8-bit images (H, W, 3)."""
        a, b = (torch.from_numpy(x.astype(np.float32) / 255) for x in (render, target))
        perceptual = np.nan if self.lpips is None else float(self.lpips(a, b))
        return np.array(
            [psnr(render, target), ssim(render, target), perceptual, self.rand_vgg(a, b)]
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
) -> list[Row]:
    """Measure an avatar on the splits of a video.

    Args:
        avatar: the fitted one.
        video: opened with the poses to evaluate under, see the module's table.
        name: of the run, for the rows.
        splits: those wanted; one that the video does not have gives no row.
        weights: for LPIPS; none: those that :func:`~gva_mi.fit.perceptual.find_weights` finds.
        progress: told the number of frames done.

    Returns:
        One row per split, in the order of ``splits``.

    Raises:
        InputError: a truth folder that cannot be read.
    """
    frames = {split: found for split in splits if (found := _frames(video, split))}
    metrics, rows = Metrics(weights), []
    done, total = 0, sum(len(indices) for _, indices in frames.values())
    for split, (source, indices) in frames.items():
        figures = []
        for frame in source.frames(indices):
            target = cut_out(_with_true_mask(frame, source))
            figures.append(metrics(render_frame(avatar, frame.pose, frame.camera), target))
            done += 1
            if progress:
                progress(done, total, psnr=figures[-1][0])
        mean = np.mean(figures, axis=0)
        perceptual = None if np.isnan(mean[2]) else float(mean[2])
        rows.append(Row(name, split, float(mean[0]), float(mean[1]), perceptual, float(mean[3])))
    return rows


def render_sequence(
    avatar: Avatar,
    pose: Pose,
    cameras: Sequence[Camera],
    background: tuple[float, float, float] = WHITE,
    options: SplatOptions | None = None,
) -> Iterator[np.ndarray]:
    """The avatar driven by a motion: one 8-bit image (H, W, 3) per frame.

    Args:
        avatar: any.
        pose: T frames.
        cameras: T of them, or one for all.
        background: linear colour in [0, 1].
        options: of the splatting.

    Raises:
        ValueError: for a number of cameras that is neither 1 nor T.
    """
    if len(cameras) not in (1, len(pose)):
        raise ValueError(
            f"render_sequence(): {len(pose)} poses need as many cameras or one, got {len(cameras)}"
        )
    for k in range(len(pose)):
        yield render_frame(avatar, pose[k], cameras[k % len(cameras)], background, options)


@torch.no_grad()
def render_frame(
    avatar: Avatar,
    pose: Pose,
    camera: Camera,
    background: tuple[float, float, float] = WHITE,
    options: SplatOptions | None = None,
) -> np.ndarray:
    """The avatar in one pose (of one frame), seen by one camera: 8-bit (H, W, 3)."""
    image = render(avatar(pose), camera, options or SplatOptions(), torch.tensor(background))
    return to_8bit(image.color.numpy())


def cut_out(frame: Frame) -> np.ndarray:
    """The target of a frame: the person on white, 8-bit (H, W, 3)."""
    return to_8bit(frame.on_background(1.0))


def to_8bit(image: np.ndarray) -> np.ndarray:
    """Clamp to [0, 1] and round to 256 levels."""
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)


def _frames(video: Video, split: Split) -> tuple[Video, Iterable[int]] | None:
    """Where the frames of a split are read from, and which; None if the video has no such split."""
    if split == "train":
        train = video.splits.train
        spaced = np.linspace(0, len(train) - 1, min(TRAIN_FRAMES, len(train))).round().astype(int)
        return video, [train[k] for k in spaced]
    if split == "test":
        return (video, video.splits.test) if video.splits.test else None
    folder = video.truth / split if video.truth else None
    if folder is None or not folder.is_dir():
        return None
    source = load_video(folder)
    return source, range(len(source))


def _with_true_mask(frame: Frame, video: Video) -> Frame:
    mask = video.true_mask(frame.index)
    return frame if mask is None else replace(frame, mask=mask)
