"""Find the masks of a film from its pictures and a network's rough probabilities.

1. The plate and the colours of person and background are gathered from some pictures of the whole
   film, twice: first by the probabilities, then by the masks that follow from them.
2. Each picture then gets its evidence, its cut and the shares at the outline.

Memory does not grow with the film's length: pictures are read one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.core.console import Progress, listed
from gva_mi.data.matting.alpha import outline_alpha
from gva_mi.data.matting.colors import ColorsByHeight
from gva_mi.data.matting.cut import smoothest_cut
from gva_mi.data.matting.grid import WorkGrid
from gva_mi.data.matting.odds import log_odds
from gva_mi.data.matting.plate import Plate
from gva_mi.data.pictures import write_image

GATHERED = 48  # pictures that the plate and the colours are gathered from
PERSON = 0.5  # probability from which a pixel counts to the person's extent
SMALLEST = 64  # pixels of that kind: with fewer there is no person
POSSIBLE, CERTAIN = 0.05, 0.95  # probabilities: below the one is background, above the other person
NEAR = 4  # pixels around what is possible that count as possible, too
PRICE, FLAT_PRICE, EDGE = 1.0, 4.0, 0.08  # of an outline: at any place; more where colours differ
# by less than EDGE
STEPS = 60  # of the cut
ISLAND = 0.002  # share of the largest piece's area: smaller ones are dropped


@dataclass(frozen=True)
class FilmScene:
    """What a film shows as a whole, on the working grid."""

    plate: Plate
    person: ColorsByHeight
    background: ColorsByHeight


@dataclass(frozen=True)
class GridPicture:
    """One picture on the working grid."""

    image: np.ndarray  # (h, w, 3) 8-bit
    probability: np.ndarray  # (h, w) in [0, 1]
    height: np.ndarray  # (h,) of each row: 0 at the person's highest pixel, 1 at the lowest


def film_masks(
    pictures: Sequence[np.ndarray],
    probabilities: Sequence[np.ndarray],
    out: Path,
    progress: Progress | None = None,
) -> list[str]:
    """Write a soft mask of each picture, ``out/000000.png`` and so on; return notes.

    Args:
        pictures: T pictures (H, W, 3) 8-bit of one film. Each is read a few times; only the one
            that is worked on, and some parts, stay in memory.
        probabilities: T probabilities of the person (H, W) 8-bit, 255 for certain; all zero where
            there is nobody.
        out: folder of the masks. A picture without a person gets an empty one.
        progress: told about each picture.
    """
    extents = np.array([_extent(probabilities[k]) for k in range(len(probabilities))])
    shown = np.flatnonzero(extents[:, 2] > 0)
    if len(shown):
        grid = WorkGrid.around(extents[shown], pictures[shown[0]].shape[:2])

        def view(k: int) -> GridPicture:
            image, P = (np.ascontiguousarray(grid.cut(x[k])) for x in (pictures, probabilities))
            top, bottom = extents[k, 1::2]
            rows = grid.box[1] + (np.arange(grid.size[0]) + 0.5) / grid.scale
            return GridPicture(image, P.astype(np.float32) / 255, (rows - top) / (bottom - top))

        chosen = shown[np.unique(np.linspace(0, len(shown) - 1, GATHERED).round().astype(int))]
        scene = _gathered([view(k) for k in chosen])
    for k in range(len(pictures)):
        if extents[k, 2] > 0:
            mask = grid.paste(picture_mask(view(k), scene))
        else:
            mask = np.zeros(pictures[k].shape[:2], np.uint8)
        write_image(Path(out) / f"{k:06d}.png", mask)
        if progress:
            progress(k + 1, len(pictures))
    absent = np.setdiff1d(np.arange(len(pictures)), shown)
    return [f"frames without a person, whose masks are empty: {listed(absent)}"] * bool(len(absent))


def picture_mask(view: GridPicture, scene: FilmScene) -> np.ndarray:
    """Return the mask (h, w) float32 in [0, 1] of a picture."""
    image = view.image.astype(np.float32) / 255
    inside = _cut(view, scene)
    return outline_alpha(image, inside, scene.plate)


def _cut(view: GridPicture, scene: FilmScene) -> np.ndarray:
    """Return where the person is (h, w) bool."""
    image = view.image.astype(np.float32) / 255
    rows = np.linspace(0, 1, len(image))
    odds = log_odds(
        image,
        view.probability,
        scene.plate,
        scene.person.density(view.image, view.height),
        scene.background.density(view.image, rows),
    )
    price = lambda axis: (
        PRICE + FLAT_PRICE * np.exp(-((np.abs(np.diff(image, axis=axis)).max(-1) / EDGE) ** 2))
    ).astype(np.float32)
    u = smoothest_cut(odds, (price(1), price(0)), odds > 0, STEPS)
    return _person_alone(u > 0.5, view.probability)


def _gathered(views: list[GridPicture]) -> FilmScene:
    """Gather plate and colours: by the probabilities, then by the masks found with these."""
    from scipy.ndimage import binary_dilation, binary_erosion

    pictures = np.stack([view.image for view in views])
    inside = np.stack([view.probability > CERTAIN for view in views])
    outside = np.stack(
        [~binary_dilation(view.probability > POSSIBLE, iterations=NEAR) for view in views]
    )
    for last in (False, True):
        plate = Plate.gather(pictures, outside)
        person, background = ColorsByHeight(), ColorsByHeight()
        for k, view in enumerate(views):
            person.add(view.image, binary_erosion(inside[k], iterations=2), view.height)
            background.add(view.image, outside[k], np.linspace(0, 1, len(view.image)))
        scene = FilmScene(plate, person, background)
        if last:
            return scene
        for k, view in enumerate(views):
            inside[k] = _cut(view, scene)
            outside[k] = ~binary_dilation(inside[k] | (view.probability > CERTAIN), iterations=3)
    raise AssertionError


def _person_alone(inside: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Drop pieces (h, w) bool that are small, or that the network holds for background."""
    from scipy.ndimage import label

    pieces, count = label(inside)
    if count < 2:
        return inside
    area = np.bincount(pieces.ravel())[1:]
    likely = np.bincount(pieces.ravel(), probability.ravel())[1:] / area
    kept = (area >= ISLAND * area.max()) & ((likely > 0.3) | (area == area.max()))
    return np.concatenate([[False], kept])[pieces]


def _extent(probability: np.ndarray) -> np.ndarray:
    """Return left, top, right, bottom (4,) of the person; zeros if there is none."""
    inside = probability > 255 * PERSON
    if inside.sum() < SMALLEST:
        return np.zeros(4)
    columns, rows = (np.flatnonzero(inside.any(axis)) for axis in (0, 1))
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)
