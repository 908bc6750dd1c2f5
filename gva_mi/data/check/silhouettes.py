"""Compare the body's silhouettes with the masks, for the folder as it is and for hypotheses.

A hypothesis is compared with the folder as it is by the IoU of silhouette and mask, frame by frame.
With d its gain in IoU over n frames and I the IoU as it is, it is accepted if

    1. mean d > SURE · std d / √n                 more than chance
    2. mean d > WORTH · (1 − mean I)              a good part of what is lacking
    3. mean e > LIKELY · std e / √n               not by the place alone

where e is the gain if each silhouette is laid over its mask, by one displacement for all frames: a
body that is always to the left would gain as much by mirroring. Frames that follow each other err
alike, so n counts stretches of them, BLOCKS at most. Hypotheses that move the person altogether
need 1 and 2, mean I < FITS, and a mean IoU of FITS. The best one is applied, and the others are
tried again under it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from gva_mi.data.check.frames import CheckedFrames, SilhouetteRenderer
from gva_mi.data.check.hypotheses import COARSE, MIRRORED, Hypothesis
from gva_mi.data.check.problems import Problem, doubt, error
from gva_mi.data.splits import spread

RENDERED = 48  # frames, evenly spaced
BLOCKS = 12  # stretches of these whose errors are taken for independent
TRIED = 6  # frames, for a hypothesis that moves the person altogether
FEWEST = 4  # frames from which a spread can be estimated
FITS = 0.5  # IoU: more of both pictures is the person in common than not
SURE = 4.0  # standard errors: one hypothesis in 30,000 gets there by chance
LIKELY = 2.0
# Clothes and the estimator's errors are lacking under every hypothesis, so only a part can be asked
# for.
WORTH = 0.2
# The root mean square radius of a standing person is some 45 cm. Clothes and hair add 5 cm all
# round, and grown-ups differ by 8 % from the mean person whom zero betas stand for: a sixth in all.
DOUBTFUL_SIZE, WRONG_SIZE = 1.2, 1.35
ASIDE = 0.5  # radii; an eighth of a person's height is wider than a limb
OUTSIDE = 0.5  # of a frame's joints: a joint is in the body, so half of them outside is no chance


@dataclass
class SilhouetteCheck:
    """Result of the silhouette check; images are (n, h, w, 4): normals and alpha of n frames."""

    frames: CheckedFrames  # as the folder is
    iou: float
    inside: float  # share of the joints of all frames that lie in their masks
    problems: list[Problem] = field(default_factory=list)
    accepted: list[Hypothesis] = field(default_factory=list)
    final: CheckedFrames | None = None  # under the accepted hypotheses
    final_images: np.ndarray | None = None


def check_silhouettes(frames: CheckedFrames, renderer: SilhouetteRenderer) -> SilhouetteCheck:
    """Compare the body with the masks, and name the faults."""
    some = frames.of(spread(range(len(frames)), RENDERED))
    iou = overlap(renderer.silhouettes(some), some.masks).mean()
    found = SilhouetteCheck(some, float(iou), float(frames.inside().mean()))
    for _ in range(3):  # faults that come together; nobody would untangle more than three
        best = _best_hypothesis(some, renderer)
        if best is None:
            break
        hypothesis, figure = best
        found.accepted.append(hypothesis)
        found.problems.append(error(hypothesis.what, figure, hypothesis.cause, hypothesis.remedy))
        frames = hypothesis.apply(frames)
        some = frames.of(spread(range(len(frames)), RENDERED))
    found.final, found.final_images = some, renderer.render(some)
    silhouettes = found.final_images[..., 3] > 0.5
    more, factor, moved = _size_and_place(some, renderer)
    found.problems += more
    mended = [c.zoomed(factor) for c in frames.cameras]
    mended = [replace(c, cx=c.cx + moved[0], cy=c.cy + moved[1]) for c in mended]
    iou = 1.0 if more else float(overlap(silhouettes, some.masks).mean())
    found.problems += _outside(replace(frames, cameras=tuple(mended)), iou)
    return found


def _best_hypothesis(
    some: CheckedFrames, renderer: SilhouetteRenderer
) -> tuple[Hypothesis, str] | None:
    """Return the accepted hypothesis that fits best, and its figure."""
    silhouettes = renderer.silhouettes(some)
    plain = overlap(silhouettes, some.masks)
    in_place = overlap(laid_over(silhouettes, some.masks), some.masks)
    found: list[tuple[float, Hypothesis, str]] = []

    def consider(hypothesis: Hypothesis, iou: np.ndarray, laid: np.ndarray | None = None) -> None:
        there = ~np.isnan(iou)
        before, after = plain[there], iou[there]
        likely = laid is None or sure(laid[there] - in_place[there], LIKELY)
        if likely and accepts(after - before, before):
            figure = f"IoU {before.mean():.2f}, so read {after.mean():.2f}"
            found.append((float(after.mean()), hypothesis, figure))

    mirrored = MIRRORED.apply(some).masks
    laid = overlap(laid_over(silhouettes, mirrored), mirrored)
    consider(MIRRORED, overlap(silhouettes, mirrored), laid)
    if plain.mean() < FITS:
        tried = spread(range(len(some)), TRIED)
        for hypothesis in _likely(some):
            other = hypothesis.apply(some.of(tried))
            iou = np.full(len(some), np.nan)
            iou[tried] = overlap(renderer.silhouettes(other), other.masks)
            if np.nanmean(iou) >= FITS:
                consider(hypothesis, iou)
    return max(found, key=lambda x: x[0])[1:] if found else None


def accepts(gained: np.ndarray, plain: np.ndarray) -> bool:
    """Return whether a gain (n,) in IoU is sure (eq. 1) and worth a word (eq. 2)."""
    if len(gained) < min(FEWEST, len(plain)):
        return False
    return sure(gained, SURE) and bool(gained.mean() > WORTH * (1 - plain.mean()))


def sure(gained: np.ndarray, errors: float) -> bool:
    """Return whether the mean of a gain (n,) lies ``errors`` standard errors above zero."""
    means = np.array([x.mean() for x in np.array_split(gained, min(BLOCKS, len(gained)))])
    standard_error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 1 else 0.0
    return bool(gained.mean() > errors * standard_error)


def _likely(some: CheckedFrames) -> list[Hypothesis]:
    """Return up to three coarse hypotheses, those under which most joints lie in the masks.

    Joints cost little beside a rendering. All joints of a person who is one pixel large would be
    inside, too: so they have to reach as far as the mask does, to a factor of two.
    """
    scores = []
    for hypothesis in COARSE:
        other = hypothesis.apply(some)
        reach = np.array([
            radius(m) / max(1e-9, np.sqrt(x.var(0).sum())) if np.isfinite(x).all() else np.inf
            for m, x in zip(other.masks, other.pixels(), strict=True)
        ])  # fmt: skip
        scores.append(float((other.inside() * ((reach > 0.5) & (reach < 2))).mean()))
    order = sorted(range(len(COARSE)), key=lambda i: -scores[i])[:3]
    return [COARSE[i] for i in order if scores[i] >= OUTSIDE]


def _size_and_place(
    some: CheckedFrames, renderer: SilhouetteRenderer
) -> tuple[list[Problem], float, np.ndarray]:
    """Compare size and place of silhouettes and of masks that the picture's border does not cut.

    Returns problems, and what mends the cameras: a factor on the focal length, and pixels (2,) to
    the right and down.
    """
    problems, factor, moved = [], 1.0, np.zeros(2)
    cut = lambda m: m[0].any() or m[-1].any() or m[:, 0].any() or m[:, -1].any()
    some = some.of(spread([i for i, m in enumerate(some.masks) if not cut(m)], BLOCKS))
    # Rendered three times as wide and high around the picture, so that silhouettes are whole.
    grown = [c.cropped(-c.width, -c.height, 3 * c.width, 3 * c.height) for c in some.cameras]
    shown = renderer.silhouettes(replace(some, cameras=tuple(grown))) if grown else ()
    pairs = [(m, s) for m, s in zip(some.masks, shown, strict=True) if m.any() and s.any()]
    if not pairs:
        return problems, factor, moved
    ratio = float(np.median([radius(m) / radius(s) for m, s in pairs]))
    if (wrong := max(ratio, 1 / ratio)) > DOUBTFUL_SIZE:
        factor = ratio
        problems.append((error if wrong > WRONG_SIZE else doubt)(
            "focal length or distance",
            f"masks are {ratio:.2f} times as large as the body, over {len(pairs)} frames",
            "K is of pictures of another size, or the poses' distance belongs to another lens",
            f"fx, fy {ratio:.2f} times as long, or the person {1 / ratio:.2f} times as far away",
        ))  # fmt: skip
    corner = some.masks.shape[2], some.masks.shape[1]
    away = [middle(m) - middle(s) + corner for m, s in pairs]
    aside = np.median([x / radius(m) for x, (m, _) in zip(away, pairs, strict=True)], axis=0)
    if np.linalg.norm(aside) > ASIDE:
        moved = np.median(away, axis=0)
        problems.append(error(
            "masks beside the poses",
            f"by {aside[0]:+.2f}, {aside[1]:+.2f} of the person's radius to the right, down",
            "pictures were cropped after the cameras were made, or cx, cy are not theirs",
            "subtract the crop's corner from cx, cy",
        ))  # fmt: skip
    return problems, factor, moved


def _outside(frames: CheckedFrames, iou: float) -> Iterator[Problem]:
    """Yield frames whose joints are not in their masks; without any, a low IoU."""
    outside = frames.inside() < OUTSIDE
    numbers = np.array(frames.numbers)[outside]
    figure = f"{outside.sum()} of {len(frames)} frames"
    if outside.mean() > 0.5:
        yield error("poses outside the masks", figure,
                    "another person, or cameras and poses of another world",
                    "see the overlay (--sheet), and choose person and cameras again",
                    numbers)  # fmt: skip
    elif outside.any():
        yield doubt("poses outside the masks", figure,
                    "the estimator or the segmenter lost the person for some frames",
                    "see the overlay (--sheet); delete masks that are wrong", numbers)  # fmt: skip
    elif iou < FITS:
        yield doubt("silhouettes beside the masks", f"IoU {iou:.2f}",
                    "wide clothes, a part of the person alone in the masks, or another body",
                    "see the overlay (--sheet)")  # fmt: skip


def overlap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the IoU (n,) of two stacks of masks (n, h, w) bool; 0 if both are empty."""
    both, either = (a & b).sum((1, 2)), (a | b).sum((1, 2))
    return both / np.maximum(either, 1)


def laid_over(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Move masks ``a`` (n, h, w) onto masks ``b`` by their median displacement, whole pixels."""
    both = [(x, y) for x, y in zip(a, b, strict=True) if x.any() and y.any()]
    if not both:
        return a
    right, down = np.rint(np.median([middle(y) - middle(x) for x, y in both], axis=0)).astype(int)
    height, width = a.shape[1:]
    grown = np.pad(a, ((0, 0), (height, height), (width, width)))
    return grown[:, height - down : 2 * height - down, width - right : 2 * width - right]


def radius(mask: np.ndarray) -> float:
    """Return the root mean square distance of a mask from its middle, px."""
    y, x = np.nonzero(mask)
    return float(np.sqrt(x.var() + y.var() + 1 / 6)) if len(x) else 0.0


def middle(mask: np.ndarray) -> np.ndarray:
    """Return the middle (x, y) of a mask's pixels; NaN for none."""
    y, x = np.nonzero(mask)
    return np.array([x.mean(), y.mean()]) if len(x) else np.full(2, np.nan)
