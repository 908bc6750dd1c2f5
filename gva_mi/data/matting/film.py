"""Find the masks of a film from its pictures and a network's rough probabilities.

1. Does the camera move? If so, its motion is found from picture to picture.
2. The plate and the colours of person and background are gathered from some pictures of the whole
   film, twice: first by the probabilities, then by the masks that follow from them.
3. Each picture then gets its evidence, its cut and the shares at the outline.

Memory does not grow with the film's length: pictures are read one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.core.console import Progress, listed
from gva_mi.core.tasks import on_all_cores
from gva_mi.data.crop import bounds
from gva_mi.data.folder import frame_name
from gva_mi.data.matting.camera import ShrunkPicture, camera_motion
from gva_mi.data.matting.grid import WorkGrid
from gva_mi.data.matting.scene import FilmScene, GridPicture
from gva_mi.data.pictures import write_image
from gva_mi.data.splits import spread

GATHERED = 48  # pictures that the plate and the colours are gathered from
COMPARED = 6  # pictures that show whether the camera moves at all
STILL = 0.5  # pixels of the grid: the camera stands if the picture's corners move less
PERSON = 0.5  # probability from which a pixel counts to the person's extent
SMALLEST = 64  # pixels of that kind: with fewer there is no person
UNSTEADY = 0.04  # spread of colours: beyond it the background changes too much to help


def film_masks(
    pictures: Sequence[np.ndarray],
    probabilities: Sequence[np.ndarray],
    out: Path,
    progress: Progress | None = None,
) -> list[str]:
    """Write a soft mask of each picture, ``out/000000.png`` and so on; return notes.

    Args:
        pictures: T pictures (H, W, 3) 8-bit of one film. Each is read a few times; only the one
            that is worked on, and parts of some, stay in memory.
        probabilities: T probabilities of the person (H, W) 8-bit, 255 for certain; all zero where
            there is nobody.
        out: folder of the masks. A picture without a person gets an empty one.
        progress: called after each picture.
    """
    total = len(pictures)
    extents = np.array([_extent(probabilities[k]) for k in range(total)]).reshape(total, 4)
    shown = np.flatnonzero(extents[:, 2] > 0)
    notes: list[str] = []
    if len(shown):
        film = _FilmOnGrid(pictures, probabilities, extents, shown)
        scene = FilmScene.gather([film.view(k) for k in spread(shown, GATHERED)])
        notes = film.notes()
        if scene.plate.seen.any() and np.median(scene.plate.spread[scene.plate.seen]) > UNSTEADY:
            notes.append("the background changes, so masks rely on the network and on colours")
    nobody = np.zeros(pictures[0].shape[:2], np.uint8)

    def write(numbered: tuple[int, GridPicture | None]) -> int:
        k, view = numbered
        mask = nobody if view is None else film.grid.paste(scene.mask(view))
        write_image(Path(out) / frame_name(k), mask)
        return k

    views = ((k, film.view(k) if extents[k, 2] > 0 else None) for k in range(total))
    for k in on_all_cores(write, views):
        if progress:
            progress(k + 1, total)
    absent = np.setdiff1d(np.arange(total), shown)
    if len(absent):
        notes.append(f"frames without a person, whose masks are empty: {listed(absent.tolist())}")
    return notes


def _extent(probability: np.ndarray) -> np.ndarray:
    """Return left, top, right, bottom (4,) of a probability (H, W) 8-bit; zeros without anybody."""
    inside = probability > 255 * PERSON
    if inside.sum() < SMALLEST:
        return np.zeros(4)
    return bounds(inside)


@dataclass
class _FilmOnGrid:
    """A film's pictures on their working grid, and its camera's motion."""

    pictures: Sequence[np.ndarray]
    probabilities: Sequence[np.ndarray]
    extents: np.ndarray  # (T, 4) of the person
    shown: np.ndarray  # numbers of the pictures that show the person

    def __post_init__(self) -> None:
        first = int(self.shown[0])
        self.grid = WorkGrid.around(self.extents[self.shown], self.pictures[first].shape[:2])
        self._motions: dict[int, np.ndarray | None] | None = None  # None: the camera stands
        some = np.array(spread(self.shown, COMPARED))
        if any(A is None or self._pixels(A) > STILL for A in self._found(some).values()):
            self._motions = self._found(self.shown)

    def view(self, k: int) -> GridPicture:
        """Return a picture on the grid."""
        image, P = (self.grid.cut(x[k]) for x in (self.pictures, self.probabilities))
        A = np.eye(3) if self._motions is None else self._motions[k]
        motion = None if A is None else self.grid.in_shares(A)
        P = P.astype(np.float32) / 255
        return GridPicture(image, P, self.grid.heights(self.extents[k]), motion)

    def notes(self) -> list[str]:
        """Return a sentence if the camera moves, and one on pictures where it is lost."""
        if self._motions is None:
            return []
        moves = max(self._pixels(A) for A in self._motions.values() if A is not None)
        notes = [f"the camera moves: pictures shift by up to {moves / self.grid.scale:.0f} pixels"]
        lost = [k for k, A in self._motions.items() if A is None]
        if lost:
            notes.append(f"frames that share too little background with others: {listed(lost)}")
        return notes

    def _found(self, numbers: np.ndarray) -> dict[int, np.ndarray | None]:
        """Return the camera's motion (3, 3) from the middle picture to each, by number."""
        shrunk = lambda k: ShrunkPicture.of(self.pictures[k], self.probabilities[k])
        middle = len(self.shown) // 2
        reference, found = shrunk(int(self.shown[middle])), {}
        after = numbers >= self.shown[middle]
        for run in (numbers[after], numbers[~after][::-1]):
            last = np.eye(3)
            for k in run.tolist():
                found[k] = camera_motion(reference, shrunk(k), last)
                last = last if found[k] is None else found[k]
        return found

    def _pixels(self, A: np.ndarray) -> float:
        """Return how far the picture's corners move, in pixels of the grid."""
        corners = np.array([[x, y, 1.0] for x in (-1, 1) for y in (-1, 1)])
        away = (corners @ A.T - corners)[:, :2] * self.grid.picture[::-1] / 2
        return float(np.abs(away).max() * self.grid.scale)
