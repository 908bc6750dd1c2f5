"""Metrics of renders against their targets, and scores of any method's renders.

* PSNR is limited to what rounding to 8 bits allows, :data:`PSNR_MAX`, which equal pictures reach;
* SSIM as Wang et al. 2004 define it: 11 x 11 Gaussian window, sigma 1.5, population covariance;
* LPIPS and ``rand_vgg`` are distances between features of a network, :mod:`gva_mi.fit.perceptual`.
  The deepest layers would see only the border of a picture below 64 pixels: there each pixel is
  repeated until both sides are long enough. Of one beyond 1024 pixels they see means over squares,
  because they take most of the time.

Most of a picture is background, where a render equals its target, and so do features that do not
see the person. So only the part around the person is looked at; the rest counts as equal.

``gva-mi score`` compares renders of any method by each protocol that published tables use:

=======  =========================================================================================
region   pixels
=======  =========================================================================================
whole    all
box      the box of the person's mask (:func:`gva_mi.evaluate.regions.person_box`)
mask     only the mask's: PSNR over them, and the mean of the SSIM map over them
hands    boxes of visible hands, from the poses of a subject (:mod:`gva_mi.evaluate.regions`)
face     likewise
=======  =========================================================================================

If a person fills a tenth of a white picture, the PSNR of the whole is 10 dB above the mask's. So
figures of different regions cannot be compared.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.cpu import one_torch_thread
from gva_mi.core.errors import InputError
from gva_mi.core.tasks import on_all_cores
from gva_mi.evaluate.figures import Figure
from gva_mi.evaluate.regions import Details, person_box
from gva_mi.fit.perceptual import (
    RAND_SEED,
    RAND_WIDTH,
    FeatureMetric,
    Weights,
    find_weights,
    lpips,
    rand_vgg,
)
from gva_mi.subject.backdrop import premultiplied
from gva_mi.subject.crop import Box, block_means, bounds
from gva_mi.subject.footage import files_of, frames_named, masks
from gva_mi.subject.pictures import in_8_bits, read_image
from gva_mi.subject.video import Video
from gva_mi.subject.video_file import VideoFile

# The PSNR of rounding to 8 bits, an error with a variance of 1/12 of a level squared: 58.9 dB.
PSNR_MAX = float(20 * np.log10(255) + 10 * np.log10(12))
NETWORK_SIDE = 64  # pixels, the smallest side that the networks see; below it, only borders
NETWORK_LONGEST = 1024  # pixels, the largest side that they see; chosen: most time is theirs
# Of VGG16 to its last tap: half of the receptive field, and the stride, pixels.
NETWORK_SIGHT, NETWORK_STEP = 98, 16
SSIM_RADIUS = 5  # pixels, of the 11 x 11 window of Wang et al. (2004)
_SSIM = {
    "channel_axis": -1, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False,
}  # fmt: skip

Label = TypeVar("Label")


class ImageScores(NamedTuple):
    """Scores of one render against its target."""

    psnr: float  # dB, more is better
    ssim: float  # at most 1, more is better
    lpips: float  # less is better; NaN without the user's weights
    rand_vgg: float  # less is better; comparable only with itself


def mean_figures(scores: Sequence[ImageScores], **about: str) -> list[Figure]:
    """Average scores; ``about`` are the other columns of :class:`Figure`."""
    means = [None if np.isnan(x) else x for x in np.mean(scores, axis=0).tolist()]
    values = dict(zip(("PSNR, dB", "SSIM", "LPIPS", "rand_vgg"), means, strict=True))
    values["pictures"] = len(scores)
    return [Figure(**about, metric=name, value=value) for name, value in values.items()]


class Scorer:
    """Scores renders with the networks of the metrics, which are loaded once."""

    def __init__(self, weights: Weights | None = None) -> None:
        """Load the networks; ``weights`` for LPIPS, None: those that ``find_weights`` finds."""
        self._weights = find_weights() if weights is None else weights
        self.rand_vgg = rand_vgg()
        self.lpips: FeatureMetric | None = lpips(self._weights)

    def __call__(self, render: np.ndarray, target: np.ndarray) -> ImageScores:
        """Score two 8-bit images (H, W, 3), both sides at least 11 pixels."""
        return self.of_renders([render], target)[0]

    def of_renders(self, renders: Iterable[np.ndarray], target: np.ndarray) -> list[ImageScores]:
        """Score renders of one target, whose features are computed once for each part of it."""
        scores, seen, known = [], torch.empty(0), {}
        for render in renders:
            (a, b), size = _for_networks(render, target)
            if not torch.equal(b, seen):
                seen, known = b, {}
            distances = []
            for network in (self.lpips, self.rand_vgg):
                if network is not None and network not in known:
                    known[network] = network.features(b)
                distance = None if network is None else network.to_features(a, known[network], size)
                distances.append(np.nan if distance is None else float(distance))
            scores.append(ImageScores(psnr(render, target), ssim(render, target), *distances))
        return scores

    def of_frames(
        self, frames: Iterable[Sequence[tuple[Label, Sequence[np.ndarray], np.ndarray]]]
    ) -> Iterator[list[tuple[Label, list[ImageScores]]]]:
        """Score the parts of frames: each has a label, renders, and the target of all of them.

        Each core takes a frame, while the next ones are made. Any number of cores gives the same
        bits.
        """
        score = lambda parts: [(label, self.of_renders(*images)) for label, *images in parts]
        with one_torch_thread():
            yield from on_all_cores(score, frames)

    def networks(self) -> dict[str, Any]:
        """Describe network and weights of each perceptual metric; None for LPIPS without any."""
        files = self._weights.of_lpips
        digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
        return {
            "lpips": {"network": "VGG16", "sha256": digests} if files else None,
            "rand_vgg": {
                "network": f"VGG16's layers, {RAND_WIDTH:g} of its channels",
                "weights": f"random, seed {RAND_SEED}",
            },
        }


def _where_they_differ(
    render: np.ndarray, target: np.ndarray, border: int, step: int = 1
) -> tuple[slice, slice]:
    """Return rows and columns of the pixels that differ, with a border, in whole steps."""
    R, G, B = np.moveaxis(render != target, -1, 0)
    found = bounds(R | G | B)
    left, top, right, bottom = (0, 0, 1, 1) if found is None else found.astype(int).tolist()
    steps = lambda low, high: (max(0, low - border) // step, -(-(high + border) // step))
    wide = lambda low, high: slice(*(step * x for x in steps(low, high)))
    return wide(top, bottom), wide(left, right)


def _for_networks(
    render: np.ndarray, target: np.ndarray
) -> tuple[tuple[Tensor, Tensor], tuple[int, int]]:
    """Return what the networks see of two 8-bit images (H, W, 3), float32, 0 to 1.

    That is the part that :data:`NETWORK_SIGHT` needs of them. Also the size (H', W') that the whole
    pictures would have.
    """
    least, most = min(render.shape[:2]), max(render.shape[:2])
    times = -(-NETWORK_SIDE // least)
    by = max(1, min(-(-most // NETWORK_LONGEST), least // NETWORK_SIDE))
    rows, columns = (side // by * by for side in render.shape[:2])
    both = [x[:rows, :columns] for x in (render, target)]
    if times == 1:
        part = _where_they_differ(*both, by * NETWORK_SIGHT, by * NETWORK_STEP)
        both = [x[part] for x in both]
    seen = []
    for image in both:
        image = image.repeat(times, 0).repeat(times, 1).astype(np.float32)
        seen.append(torch.from_numpy(block_means(image, by) / np.float32(255)))
    return (seen[0], seen[1]), (rows * times // by, columns * times // by)


def psnr(render: np.ndarray, target: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio of two 8-bit images, dB, at most :data:`PSNR_MAX`."""
    part = _where_they_differ(render, target, 0)
    away = render[part].astype(np.float64) - target[part]
    error = float(np.square(away).sum()) / render.size
    return psnr_of(error)


def psnr_of(error: float) -> float:
    """Return the PSNR of a mean squared error in levels of 8 bits, dB."""
    return PSNR_MAX if error == 0 else min(PSNR_MAX, float(10 * np.log10(255**2 / error)))


def ssim(render: np.ndarray, target: np.ndarray) -> float:
    """Return the structural similarity of two 8-bit images (H, W, 3), sides at least 11 pixels.

    It is 1 where the pictures are equal, so only the rest is computed.
    """
    from skimage.metrics import structural_similarity

    r = SSIM_RADIUS
    render_, target_ = (x[_where_they_differ(render, target, 2 * r)] for x in (render, target))
    lacking = 1 - structural_similarity(target_, render_, full=True, **_SSIM)[1][r:-r, r:-r]
    height, width = (side - 2 * r for side in render.shape[:2])
    return 1 - float(lacking.sum()) / (3 * height * width)


def ssim_map(render: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the structural similarity around each pixel, (H, W), the mean over the colours."""
    from skimage.metrics import structural_similarity

    return structural_similarity(target, render, full=True, **_SSIM)[1].mean(2)


@dataclass(frozen=True)
class PicturePair:
    """A render and the picture that it should equal."""

    name: str  # for errors
    render: np.ndarray  # (H, W, 3) 8-bit
    truth: np.ndarray  # (H, W, 3) 8-bit
    mask: np.ndarray | None = None  # (H, W) in [0, 1], the person
    boxes: Sequence[tuple[str, Box]] = ()  # hands and face

    def scores(self, scorer: Scorer) -> Iterator[tuple[str, ImageScores]]:
        """Yield each region and its scores."""
        yield "whole", scorer(self.render, self.truth)
        if self.mask is not None:
            inside = self.mask > 0.5
            away = self.render[inside].astype(np.float64) - self.truth[inside]
            similar = float(ssim_map(self.render, self.truth)[inside].mean())
            error = float(np.square(away).mean())
            for region, box in (("box", person_box(self.mask)), *self.boxes):
                yield region, scorer(box.cut(self.render), box.cut(self.truth))
            yield "mask", ImageScores(psnr_of(error), similar, np.nan, np.nan)


def score_pictures(
    pairs: Iterable[PicturePair], scorer: Scorer, progress: Progress | None = None
) -> list[Figure]:
    """Score renders by every region that their masks and boxes allow.

    Raises:
        InputError: a render has another size than its picture, or there is no pair.
    """
    found: dict[str, list[ImageScores]] = {}
    for done, pair in enumerate(pairs, 1):
        if pair.mask is not None and not (pair.mask > 0.5).any():
            raise InputError(f"score: the mask of {pair.name} is empty")
        if pair.render.shape != pair.truth.shape:
            has, wants = (f"{x.shape[1]}x{x.shape[0]}" for x in (pair.render, pair.truth))
            raise InputError(f"score: the render of {pair.name} has {has}, its picture {wants}")
        for region, scores in pair.scores(scorer):
            found.setdefault(region, []).append(scores)
        if progress:
            progress(done, done)
    if not found:
        raise InputError("score: there is no render to compare")
    return sum((mean_figures(scores, region=region) for region, scores in found.items()), [])


Color = np.ndarray | None  # (3,) in [0, 1]; None: pictures stay as they are
Numbered = Mapping[int, Callable[[], np.ndarray]]  # pictures (H, W, 3 or 4) 8-bit by number


def numbered(source: Path) -> Numbered:
    """Open the pictures of a folder by the numbers in their names, or of a video in their order."""
    files = files_of(source)
    if files is None:
        video = VideoFile(source)
        return {k: partial(video.__getitem__, k) for k in range(len(video))}
    return {k: partial(read_image, path, 4) for k, path in _by_number(source, files).items()}


def _by_number(source: Path, files: list[Path]) -> dict[int, Path]:
    """Return files by the frames' numbers in their names."""
    try:
        return dict(zip(frames_named(files).tolist(), files, strict=True))
    except ValueError as error:
        raise InputError(f"{source}: {error}; expected a frame's number in each") from None


def pairs_of_subject(
    renders: Path, video: Video, body: BodyModel, color: Color
) -> Iterator[PicturePair]:
    """Pair renders with a subject's frames, masks, and boxes of visible hands and faces.

    Raises:
        InputError: the subject has no frame of a render's number.
    """
    rendered, details = numbered(renders), Details.of(video, body)
    _require_all(rendered, set(range(len(video))) - set(video.absent), video.folder)

    def pair(number: int) -> PicturePair:
        frame, render = video.with_true_mask(video[number]), _on(color, rendered[number]())
        picture = _on(color, in_8_bits(frame.image), frame.mask)
        boxes = tuple(details.boxes(number))
        return PicturePair(f"frame {number}", render, picture, frame.mask, boxes)

    return map(pair, rendered)


def pairs_of_pictures(
    renders: Path, truth: Path, masked: Path | None, color: Color
) -> Iterator[PicturePair]:
    """Pair renders with pictures of the same numbers, and with their masks if given.

    Raises:
        InputError: there is no picture, or no mask, of a render's number.
    """
    rendered, seen = numbered(renders), numbered(truth)
    _require_all(rendered, seen, truth)
    inside: dict[int, np.ndarray] = {}
    if masked is not None:
        named = masked.is_dir() and not any(masked.glob("[!.]*.npy"))
        numbers = _by_number(masked, files_of(masked)) if named else seen
        found = list(masks(masked))
        if len(found) != len(numbers):
            raise InputError(f"{masked}: holds {len(found)} masks for {len(numbers)} pictures")
        inside = dict(zip(numbers, found, strict=True))
        _require_all(rendered, inside, masked)

    def pair(number: int) -> PicturePair:
        mask = inside[number].astype(np.float32) / 255 if inside else None
        pictures = _on(color, rendered[number]()), _on(color, seen[number](), mask)
        return PicturePair(f"frame {number}", *pictures, mask)

    return map(pair, rendered)


def _require_all(rendered: Numbered, known: Container[int], source: Path) -> None:
    """Raise an InputError for the first render without a counterpart."""
    for number in rendered:
        if number not in known:
            raise InputError(
                f"{source}: has no frame {number}, of which there is a render; expected files of "
                "the same numbers, or videos of the same length"
            )


def _on(color: Color, picture: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """Put a picture (H, W, 3 or 4) on a colour, by its mask (H, W) or else by its alpha."""
    rgb = picture[..., :3]
    if color is None or (mask is None and picture.shape[2] == 3):
        return rgb
    if mask is None:
        alpha = picture[..., 3:].astype(np.float32) / 255
        return in_8_bits(rgb / 255 * alpha + color * (1 - alpha))
    if mask.shape != rgb.shape[:2]:
        sizes = f"{rgb.shape[1]}x{rgb.shape[0]}, its mask {mask.shape[1]}x{mask.shape[0]}"
        raise InputError(f"score: a picture has {sizes}; expected the same size")
    person = premultiplied(rgb.astype(np.float32) / 255, mask)
    return in_8_bits(person + color * (1 - mask[..., None]))
