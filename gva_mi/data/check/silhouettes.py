"""Joints and silhouettes against masks, under the plain reading of a folder and under others.

A reading is compared with the plain one by the IoU of the body's silhouette with the mask, frame by
frame. It counts where, with d the gain of n frames and I their plain IoU,

    1. mean d > SURE · std d / √n                 more than chance: some 40 readings are tried
    2. mean d > WORTH · (1 − mean I)              part of what is lacking, not a shade
    3. mean e > LIKELY · std e / √n               not by the place alone

where e is the gain once both silhouettes lie on the masks, each moved by one displacement for all
frames: a body that is always to the left by as much as the person is to the right gains as much by
mirroring. Frames that follow each other err alike, so n counts stretches of them, BLOCKS at most.

A coarse reading, which moves the person altogether, counts by 1 and 2, and only where the plain one
is wrong (mean I < FITS) and it is right. So no shift of a noisy pose is taken for another axis. The
best that counts is applied, and the rest is looked for under it, so that several faults are found
at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from gva_mi.data.check.findings import Finding
from gva_mi.data.check.readings import COARSE, MIRRORED, Reading, shifted
from gva_mi.data.check.seen import Seen, Silhouettes, cut_off, laid_over, middle, overlap, radius
from gva_mi.data.video import spread

LOOKED = 48  # frames that are rendered, evenly spaced
BLOCKS = 12  # stretches of these whose errors are taken for independent
TRIED = 6  # of these, for a reading that moves the person altogether
FEWEST = 4  # frames from which a spread can be told
FITS = 0.5  # IoU: more of both pictures is the person in common than not
SURE = 4.0  # standard errors: one reading in 30,000 gets there by chance
LIKELY = 2.0
# Clothes and the estimator's errors are lacking under every reading, so no more than a part can be
# asked for. A heading that is off by 10 degrees all the time looks late on who turns steadily, and
# being read so gains it a sixth of what is lacking.
WORTH = 0.2
# The root mean square radius of a standing person is some 45 cm. Clothes and hair add 5 cm all
# round, and grown-ups differ by 8 % from the mean person whom zero betas stand for: a sixth in all.
DOUBTFUL_SIZE, WRONG_SIZE = 1.2, 1.35
ASIDE = 0.5  # radii; an eighth of a person's height is wider than a limb
OUTSIDE = 0.5  # of a frame's joints: a joint is in the body, so half of them outside is no chance
TINY, HUGE = 0.02, 20.0  # a person's height in heights of the picture: nothing, or a patch, is seen
LATEST = 30  # frames; who trims a video by more than a second sees it


@dataclass
class Compared:
    """What silhouettes say."""

    plain: Seen
    some: Seen  # the frames that were rendered, under the plain reading
    images: np.ndarray  # (n, h, w, 4) of these: normals and silhouette
    iou: np.ndarray  # (n,) of these
    inside: np.ndarray  # shares of the joints of all frames that lie in their masks
    findings: list[Finding] = field(default_factory=list)
    accepted: list[Reading] = field(default_factory=list)
    final: Seen | None = None  # under the accepted readings, and its pictures
    final_images: np.ndarray | None = None


def compare(plain: Seen, renderer: Silhouettes) -> Compared:
    """Compare what is seen with the body, and name what is wrong."""
    some = plain.of(spread(range(len(plain)), LOOKED))
    images = renderer.render(some)
    iou = overlap(images[..., 3] > 0.5, some.masks)
    found = Compared(plain, some, images, iou, plain.inside())
    seen = plain
    for _ in range(3):  # faults that come together; more than three nobody would untangle
        best = _best_reading(seen, some, images, renderer)
        if best is None:
            break
        reading, figure = best
        found.accepted.append(reading)
        found.findings.append(Finding("error", reading.what, figure, reading.cause, reading.remedy))
        seen = reading.apply(seen)
        some = seen.of(spread(range(len(seen)), LOOKED))
        images = renderer.render(some)
    found.final, found.final_images = some, images
    if not any(reading in COARSE for reading in found.accepted):
        found.findings += _distance(seen)
    more, factor, aside = _sizes(some, images, renderer)
    found.findings += more
    iou = None if more else float(overlap(images[..., 3] > 0.5, some.masks).mean())
    found.findings += _outside(_mended(seen, factor, aside), iou)
    return found


def _best_reading(
    seen: Seen, some: Seen, images: np.ndarray, renderer: Silhouettes
) -> tuple[Reading, str] | None:
    """The reading that fits best of those that count, and its figure."""
    silhouettes = images[..., 3] > 0.5
    plain = overlap(silhouettes, some.masks)
    in_place = overlap(laid_over(silhouettes, some.masks), some.masks)
    found: list[tuple[float, Reading, str]] = []

    def consider(reading: Reading, iou: np.ndarray, moved: np.ndarray | None = None) -> None:
        there = ~np.isnan(iou)
        before, after = plain[there], iou[there]
        if not counts(after - before, before):
            return
        if moved is not None and not sure(moved[there] - in_place[there], LIKELY):
            return
        figure = f"IoU {before.mean():.2f}, so read {after.mean():.2f}"
        found.append((float(after.mean()), reading, figure))

    mirrored = MIRRORED.apply(some).masks
    mirrored_in_place = overlap(laid_over(silhouettes, mirrored), mirrored)
    consider(MIRRORED, overlap(silhouettes, mirrored), mirrored_in_place)
    for offset in range(-LATEST, LATEST + 1):
        if offset and (late := _late(seen, some, silhouettes, offset)) is not None:
            consider(shifted(offset), *late)
    if plain.mean() < FITS:
        tried = spread(range(len(some)), TRIED)
        for reading in _likely(some):
            other = reading.apply(some.of(tried))
            iou = np.full(len(some), np.nan)
            iou[tried] = overlap(renderer.render(other)[..., 3] > 0.5, other.masks)
            if np.nanmean(iou) >= FITS:
                consider(reading, iou)
    if not found:
        return None
    _, reading, figure = max(found, key=lambda x: x[0])
    return reading, figure


def counts(gained: np.ndarray, plain: np.ndarray) -> bool:
    """Whether a gain (n,) in IoU is sure (eq. 1) and worth a word (eq. 2)."""
    if len(gained) < min(FEWEST, len(plain)):
        return False
    return sure(gained, SURE) and bool(gained.mean() > WORTH * (1 - plain.mean()))


def sure(gained: np.ndarray, errors: float) -> bool:
    """Whether the mean of a gain (n,) is so many of its standard errors above zero."""
    means = np.array([x.mean() for x in np.array_split(gained, min(BLOCKS, len(gained)))])
    error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 1 else 0.0
    return bool(gained.mean() > errors * error)


def _likely(some: Seen) -> list[Reading]:
    """Up to three coarse readings, those under which most joints lie in the masks.

    Joints cost little beside a rendering. A person so far away that all joints are in one pixel
    would have them inside, too: so they have to reach as far as the mask does, to a factor of two.
    """
    scores = []
    for reading in COARSE:
        other = reading.apply(some)
        pixels = other.pixels()
        reach = np.array([
            radius(m) / max(1e-9, np.sqrt(x.var(0).sum())) if np.isfinite(x).all() else np.inf
            for m, x in zip(other.masks, pixels, strict=True)
        ])  # fmt: skip
        plausible = (reach > 0.5) & (reach < 2)
        scores.append(float((other.inside() * plausible).mean()))
    order = sorted(range(len(COARSE)), key=lambda i: -scores[i])[:3]
    return [COARSE[i] for i in order if scores[i] >= OUTSIDE]


def _late(
    seen: Seen, some: Seen, silhouettes: np.ndarray, offset: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """IoU of the rendered frames with the masks of ``offset`` frames later, NaN without one.

    Once where they are, and once moved onto the masks.
    """
    places = {frame: i for i, frame in enumerate(seen.frames)}
    there = [(i, places[f + offset]) for i, f in enumerate(some.frames) if f + offset in places]
    if len(there) < max(2, len(some) // 2):
        return None
    mine, theirs = map(list, zip(*there, strict=True))
    found = np.full((2, len(some)), np.nan)
    own, masks = silhouettes[mine], seen.masks[theirs]
    found[:, mine] = overlap(own, masks), overlap(laid_over(own, masks), masks)
    return found[0], found[1]


def _distance(seen: Seen) -> Iterator[Finding]:
    """Persons behind the camera, or too far or near to be seen."""
    depth = seen.places()[:, 0, 2]
    behind = depth <= 0
    numbers = lambda which: tuple(f for f, w in zip(seen.frames, which, strict=True) if w)
    if behind.any():
        yield Finding(
            "error", "behind the camera", f"{behind.sum()} of {len(seen)} frames",
            "another place or another axis of the camera than T_camera_world says",
            "x_camera = T_camera_world x_world, z forward", numbers(behind),
        )  # fmt: skip
    height = float(np.ptp(seen.joints[:, 1]))
    tall = np.array([c.fy * height / c.height for c in seen.cameras]) / np.maximum(depth, 1e-6)
    wrong = ~behind & ((tall < TINY) | (tall > HUGE))
    if wrong.any():
        where = "far from" if tall[wrong][0] < TINY else "close to"
        yield Finding(
            "error", f"cameras {where} the person",
            f"{np.median(depth[wrong]):.3g} m; {np.median(tall[wrong]):.2g} of the picture's "
            "height", "millimetres, or another world than that of the poses",
            "metres, and T_camera_world of the world that the poses are in", numbers(wrong),
        )  # fmt: skip


def _sizes(
    some: Seen, images: np.ndarray, renderer: Silhouettes
) -> tuple[list[Finding], float, np.ndarray]:
    """Silhouettes of another size than the masks, or beside them, over the frames.

    Returns:
        Findings, and what mends the cameras: a factor on the focal length, and pixels (2,) to the
        right and down.
    """
    findings, factor, moved = [], 1.0, np.zeros(2)
    whole = [i for i in range(len(some)) if not cut_off(some.masks[i]) and some.masks[i].any()]
    shown = images[..., 3] > 0.5
    if any(cut_off(shown[i]) for i in whole):  # then the rest of them counts, too
        some = some.of(spread(whole, FEWEST))
        whole = list(range(len(some)))
        shown = renderer.render(_padded(some))[..., 3] > 0.5
    height, width = some.masks.shape[1:]
    corner = np.array([shown.shape[2] - width, shown.shape[1] - height]) / 2
    whole = [i for i in whole if shown[i].any()]
    if not whole:
        return findings, factor, moved
    of_masks = np.array([radius(some.masks[i]) for i in whole])
    ratio = float(np.median(of_masks / [max(radius(shown[i]), 1e-9) for i in whole]))
    if (wrong := max(ratio, 1 / ratio)) > DOUBTFUL_SIZE:
        factor = ratio
        depth = float(np.median(some.places()[:, 0, 2]))
        findings.append(
            Finding(
                "error" if wrong > WRONG_SIZE else "doubtful", "focal length or distance",
                f"masks are {ratio:.2f} times as large as the body, over {len(whole)} frames",
                "K is of pictures of another size, or the poses' distance belongs to another lens",
                f"fx, fy {ratio:.2f} times as long, or the person {depth / ratio:.2g} m away "
                f"instead of {depth:.2g} m",
            )
        )  # fmt: skip
    away = [middle(some.masks[i]) - middle(shown[i]) + corner for i in whole]
    aside = np.median([x / r for x, r in zip(away, of_masks, strict=True)], axis=0)
    if np.linalg.norm(aside) > ASIDE:
        moved = np.median(away, axis=0)
        findings.append(
            Finding(
                "error", "masks beside the poses",
                f"by {aside[0]:+.2f}, {aside[1]:+.2f} of the person's radius to the right, down",
                "pictures were cropped after the cameras were made, or cx, cy are not theirs",
                "subtract the crop's corner from cx, cy",
            )
        )  # fmt: skip
    return findings, factor, moved


def _mended(seen: Seen, factor: float, moved: np.ndarray) -> Seen:
    """The same with other focal lengths and principal points."""
    cameras = [c.zoomed(factor) for c in seen.cameras]
    cameras = [replace(c, cx=c.cx + moved[0], cy=c.cy + moved[1]) for c in cameras]
    return replace(seen, cameras=tuple(cameras))


def _padded(some: Seen) -> Seen:
    """The same in pictures three times as wide and high, with the old ones in the middle."""
    grown = [c.cropped(-c.width, -c.height, 3 * c.width, 3 * c.height) for c in some.cameras]
    return replace(some, cameras=tuple(grown))


def _outside(seen: Seen, iou: float | None) -> Iterator[Finding]:
    """Frames whose joints are not in their masks; the mean IoU, where it means anything."""
    outside = seen.inside() < OUTSIDE
    if outside.any():
        most = outside.mean() > 0.5
        yield Finding(
            "error" if most else "doubtful", "poses outside the masks",
            f"{outside.sum()} of {len(seen)} frames",
            "another person, or cameras and poses of another world" if most
            else "the estimator or the segmenter lost the person for some frames",
            "see the overlay (--sheet), and choose person and cameras again" if most
            else "see the overlay (--sheet); delete masks that are wrong",
            tuple(f for f, out in zip(seen.frames, outside, strict=True) if out),
        )  # fmt: skip
    elif iou is not None and iou < FITS:
        yield Finding(
            "doubtful", "silhouettes beside the masks", f"IoU {iou:.2f}",
            "wide clothes, a part of the person alone in the masks, or another body",
            "see the overlay (--sheet)",
        )  # fmt: skip
