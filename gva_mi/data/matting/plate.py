"""The background without the person: the median of what is seen of each pixel in a whole film.

A pixel that the person nearly always hides has no median. There the plate continues the nearest
pixel that has one, and says by a larger spread how little it knows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.data.matting.camera import moved

SEEN = 3  # pictures that have to show a pixel of the background
LEAST = 0.012  # smallest spread, of colours in [0, 1]: noise and compression
GUESSED = 0.06  # spread of a colour that is continued from the nearest pixel, and per further
FARTHER = 0.003  # pixel of distance this much more
ROWS = 64  # computed at once


@dataclass(frozen=True)
class Plate:
    """Colours of the background on a grid."""

    color: np.ndarray  # (h, w, 3) float32 in [0, 1]
    spread: np.ndarray  # (h, w) float32, standard deviation of a colour
    seen: np.ndarray  # (h, w) bool: where the background was seen; elsewhere the colour is a guess

    @staticmethod
    def gather(pictures: np.ndarray, bare: np.ndarray) -> Plate:
        """Return the plate of pictures (N, h, w, 3) 8-bit, where ``bare`` (N, h, w) of the person.

        It says nothing if no pixel was seen often enough.
        """
        count = bare.sum(0)
        color = np.zeros(pictures.shape[1:], np.float32)
        spread = np.full(count.shape, LEAST, np.float32)
        for top in range(0, len(count), ROWS):
            part = np.s_[top : top + ROWS]
            values, shown = pictures[:, part].astype(np.int16), bare[:, part, :, None]
            middle = _median(values, shown)
            color[part] = middle / 255
            away = _median(np.abs(values - middle), shown).mean(-1)
            spread[part] = np.maximum(LEAST, 1.4826 / 255 * away)
        seen = count >= min(SEEN, len(pictures))
        if not seen.any():
            return Plate.unknown(seen.shape)
        return Plate(*_continued(color, spread, seen), seen)

    @staticmethod
    def unknown(shape: tuple[int, int]) -> Plate:
        """Return a plate (h, w) that says nothing."""
        h, w = shape
        grey, wide = np.full((h, w, 3), 0.5, np.float32), np.ones((h, w), np.float32)
        return Plate(grey, wide, np.zeros((h, w), bool))

    def part(self, part: tuple[slice, slice]) -> Plate:
        """Return some rows and columns."""
        return Plate(self.color[part], self.spread[part], self.seen[part])

    def exposed_as(self, image: np.ndarray, bare: np.ndarray) -> Plate:
        """Return the plate in the exposure of a picture (h, w, 3) 8-bit, by its ``bare`` pixels."""
        half = np.s_[::2]  # of the rows tells enough
        some = bare[half] & self.seen[half]
        if some.sum() < ROWS:
            return self
        add = lambda x: x[:, 0] + x[:, 1] + x[:, 2]  # numpy's sum over an axis of 3 is slow
        seen, plate = add(image[half][some].astype(np.uint32)), add(self.color[half][some])
        gain = np.median(seen / (255 * plate + 1e-3))
        return Plate(self.color * np.float32(gain), self.spread, self.seen)

    def moved(self, A: np.ndarray) -> Plate:
        """Return the plate (A x), as in :func:`.camera.moved`; what it lacks is a guess."""
        both = moved(np.concatenate([self.color, self.spread[..., None]], -1), A)
        seen = moved(self.seen[..., None], A, outside=0)[..., 0] > 0.99
        spread = np.where(seen, both[..., 3], np.maximum(both[..., 3], np.float32(GUESSED)))
        return Plate(both[..., :3], spread, seen)


def _median(values: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return the lower median over the first axis of values (N, ...) int16 that are shown."""
    count = shown.sum(0)
    ordered = np.sort(np.where(shown, values, np.int16(1000)), axis=0)
    index = np.broadcast_to(np.maximum(count - 1, 0) // 2, ordered.shape[1:])
    return np.take_along_axis(ordered, index[None], 0)[0]


def _continued(
    color: np.ndarray, spread: np.ndarray, seen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Give unseen pixels the mean colour around the nearest seen one, and a larger spread."""
    from scipy.ndimage import distance_transform_edt, uniform_filter

    if seen.all():
        return color, spread
    away, nearest = distance_transform_edt(~seen, return_indices=True)
    share = uniform_filter(seen.astype(np.float32), 7, mode="constant").clip(1e-6)
    total = uniform_filter(color * seen[..., None], (7, 7, 1), mode="constant")
    mean = (total / share[..., None])[tuple(nearest)]
    color = np.where(seen[..., None], color, mean)
    return color, np.where(seen, spread, GUESSED + FARTHER * away).astype(np.float32)
