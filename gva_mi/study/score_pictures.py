"""Scores of any method's renders, by each protocol that published tables use.

=======  =========================================================================================
region   pixels
=======  =========================================================================================
whole    all
box      the box of the person's mask (:func:`gva_mi.study.regions.person_box`)
mask     those of the mask alone: PSNR of them, and the mean of SSIM's map over them
hands    boxes of visible hands, from the poses of a subject (:mod:`gva_mi.study.regions`)
face     likewise
=======  =========================================================================================

PSNR of a person who fills a tenth of a white picture is 10 dB higher whole than of the mask, so
figures of different regions cannot be compared. Each region is scored twice: *strict*, and
*shifted*, after the render was moved by the translation in the picture that fits best. The
difference says how much of the error is place, and how much appearance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gva_mi.core.console import Progress
from gva_mi.core.errors import InputError
from gva_mi.data.crop import Box
from gva_mi.study.regions import person_box
from gva_mi.study.scores import ImageScores, Scorer, mean_scores, psnr_of, ssim_map

STRICT, SHIFTED = "strict", "shifted"
FARTHEST = 0.05  # of the longer side of the box: larger shifts are not believed
STEPS = 10  # shifts are found to 1 / STEPS of a pixel


@dataclass(frozen=True)
class PicturePair:
    """A render and the picture that it should equal."""

    name: str  # for errors
    render: np.ndarray  # (H, W, 3) 8-bit
    truth: np.ndarray  # (H, W, 3) 8-bit
    mask: np.ndarray | None = None  # (H, W) in [0, 1], the person
    boxes: Sequence[tuple[str, Box]] = ()  # hands and face


@dataclass(frozen=True)
class RegionScores:
    """Mean scores of one region under one protocol."""

    region: str
    protocol: str  # strict or shifted
    psnr: float  # dB, mean over pictures or boxes
    ssim: float
    lpips: float | None  # None without the user's weights, and of the mask
    rand_vgg: float | None  # None of the mask
    count: int  # pictures or boxes in the mean


def score_pictures(
    pairs: Iterable[PicturePair], scorer: Scorer, progress: Progress | None = None
) -> list[RegionScores]:
    """Score renders by every region and protocol that their masks and boxes allow.

    Raises:
        InputError: a render has another size than its picture, or there is no pair.
    """
    found: dict[tuple[str, str], list[ImageScores]] = {}
    for done, pair in enumerate(pairs, 1):
        if pair.mask is not None and not (pair.mask > 0.5).any():
            raise InputError(f"score: the mask of {pair.name} is empty")
        if pair.render.shape != pair.truth.shape:
            has, wants = (f"{x.shape[1]}x{x.shape[0]}" for x in (pair.render, pair.truth))
            raise InputError(f"score: the render of {pair.name} has {has}, its picture {wants}")
        shifted = replace(pair, render=shift_to_fit(pair))
        for protocol, one in ((STRICT, pair), (SHIFTED, shifted)):
            for region, scores in _of_pair(one, scorer):
                found.setdefault((region, protocol), []).append(scores)
        if progress:
            progress(done, done)
    if not found:
        raise InputError("score: there is no render to compare")
    return [
        RegionScores(*key, *mean_scores(scores), len(scores))
        for key, scores in sorted(found.items(), key=_order)
    ]


def shift_to_fit(pair: PicturePair) -> np.ndarray:
    """Return the render moved as fits the picture best, to a tenth of a pixel.

    It is returned as it is where no shift of at most :data:`FARTHEST` makes its error smaller.
    """
    from scipy.ndimage import shift
    from skimage.registration import phase_cross_correlation

    box = _box(pair)
    a, b = (box.cut(x).mean(2) for x in (pair.truth, pair.render))
    if a.std() == 0 or b.std() == 0:
        return pair.render
    by = phase_cross_correlation(a, b, upsample_factor=STEPS, normalization=None)[0]
    if np.abs(by).max() > FARTHEST * max(box.right - box.left, box.bottom - box.top):
        return pair.render
    moved = shift(pair.render.astype(np.float32), (*by, 0), order=1, mode="nearest")
    moved = np.round(np.clip(moved, 0, 255)).astype(np.uint8)
    error = lambda x: np.square(x.astype(np.float64) - pair.truth).mean()
    return moved if error(moved) < error(pair.render) else pair.render


def _box(pair: PicturePair) -> Box:
    if pair.mask is None:
        return Box(0, 0, pair.truth.shape[1], pair.truth.shape[0])
    return person_box(pair.mask)


def _of_pair(pair: PicturePair, scorer: Scorer) -> Iterator[tuple[str, ImageScores]]:
    """Yield the regions of one pair and their scores."""
    yield "whole", scorer(pair.render, pair.truth)
    if pair.mask is None:
        return
    for region, box in (("box", person_box(pair.mask)), *pair.boxes):
        yield region, scorer(box.cut(pair.render), box.cut(pair.truth))
    inside = pair.mask > 0.5
    square = np.square(pair.render[inside].astype(np.float64) - pair.truth[inside]).mean()
    similar = ssim_map(pair.render, pair.truth)[inside].mean()
    yield "mask", ImageScores(psnr_of(float(square)), float(similar), np.nan, np.nan)


def _order(item: tuple[tuple[str, str], Any]) -> tuple[int, int]:
    (region, protocol), _ = item
    regions = ("whole", "box", "mask", "hands", "face")
    return (STRICT, SHIFTED).index(protocol), regions.index(region)
