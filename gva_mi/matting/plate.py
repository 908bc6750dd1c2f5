"""What stays in its place while the person moves: the background behind, overlays before.

The plate is the background without the person: the median of each pixel over the pictures that show
it. A pixel that the person nearly always hides has no median. There the plate has the colour of the
nearest pixel that has one, with a larger spread: it is a guess.

An overlay is a caption or a logo. An edge of the background is in the picture unless the person
hides it; an edge of a caption is there in any case. With the gradients g_k of pictures, summed over
the n that have the person at a pixel, and again over those that do not, the edge there is steady by

1. ``S = |Σ g_k|² / (n Σ |g_k|²)``     1 if all are equal

A pixel is on an overlay if S is nearly 1 over both kinds of pictures, and over all of them. Where
the person always is, or never, nothing tells an overlay from the person's clothes, or from the
wall: there it continues along steady edges, for a little way. Furniture before the person is
found, too: it hides the person as captions do.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.matting.camera import ALL_BACKGROUND, moved

# All chosen; spreads and differences are of colours in [0, 1].
LEAST_SIGHTS = 3  # pictures that have to show a pixel of the background
LEAST_SPREAD = 0.006  # about an 8-bit step and a half: rounding alone spreads colours so far
GUESSED_SPREAD = 0.06  # of a colour that is continued from the nearest seen pixel
SPREAD_PER_PIXEL = 0.003  # by which this spread grows with the distance from that pixel
AGREEING_DIFFERENCE = 0.04  # mean over the channels, below which two colours agree
ROWS_AT_ONCE = 64  # rows whose median is computed together, which bounds the memory
LEAST_PIXELS = 64  # seen pixels that show a picture's exposure
MEAN_SQUARE = 7  # pixels, side of the squares whose mean is the colour, or the shade, near a pixel
DEVIATION_PER_MAD = 1.4826  # of a Gaussian: standard deviation over median absolute deviation


@dataclass(frozen=True)
class Plate:
    """Colours of the background on a grid."""

    color: np.ndarray  # (h, w, 3) float32 in [0, 1]
    spread: np.ndarray  # (h, w) float32, standard deviation of a colour
    seen: np.ndarray  # (h, w) bool: where the background was seen; elsewhere the colour is a guess

    @staticmethod
    def gather(pictures: np.ndarray, bare: np.ndarray) -> Plate:
        """Return the plate of pictures (N, h, w, 3) 8-bit; ``bare`` (N, h, w): no person there.

        If no pixel was seen often enough, it is :meth:`unknown`.
        """
        count = bare.sum(0)
        color = np.zeros(pictures.shape[1:], np.float32)
        spread = np.full(count.shape, LEAST_SPREAD, np.float32)
        for top in range(0, len(count), ROWS_AT_ONCE):
            part = np.s_[top : top + ROWS_AT_ONCE]
            values, shown = pictures[:, part].astype(np.int16), bare[:, part, :, None]
            middle = _median(values, shown)
            color[part] = middle / 255
            away = _median(np.abs(values - middle), shown).mean(-1)
            spread[part] = np.maximum(LEAST_SPREAD, DEVIATION_PER_MAD / 255 * away)
        seen = count >= min(LEAST_SIGHTS, len(pictures))
        if not seen.any():
            return Plate.unknown(seen.shape)
        return Plate(*_continued(color, spread, seen), seen)

    @staticmethod
    def unknown(shape: tuple[int, int]) -> Plate:
        """Return a plate (h, w) of which nothing was seen: grey, with a spread of 1."""
        h, w = shape
        grey, wide = np.full((h, w, 3), 0.5, np.float32), np.ones((h, w), np.float32)
        return Plate(grey, wide, np.zeros((h, w), bool))

    def part(self, part: tuple[slice, slice]) -> Plate:
        """Cut out rows and columns."""
        return Plate(self.color[part], self.spread[part], self.seen[part])

    def exposed_as(self, image: np.ndarray, bare: np.ndarray) -> Plate:
        """Return the plate in the exposure of a picture (h, w, 3) 8-bit, by its ``bare`` pixels."""
        half = np.s_[::2]  # of the rows are enough for a median
        shown = bare[half] & self.seen[half]
        if shown.sum() < LEAST_PIXELS:
            return self
        add = lambda x: x[:, 0] + x[:, 1] + x[:, 2]  # numpy's sum over an axis of 3 is slow
        seen, plate = add(image[half][shown].astype(np.uint32)), add(self.color[half][shown])
        gain = np.median(seen / (255 * plate + 1e-3))
        return Plate(self.color * np.float32(gain), self.spread, self.seen)

    def beside(self, image: np.ndarray, bare: np.ndarray) -> np.ndarray:
        """Return the background (h, w, 3) of a picture (h, w, 3) in [0, 1], by its bare pixels.

        It is the plate, times the shade that is seen around the nearest bare pixels; where the
        plate is a guess, it is their mean colour.
        """
        shaded = self._shaded(image, Around.of(bare & self.seen))
        return np.where(self.seen[..., None], shaded, Around.of(bare).mean(image))

    def agreeing(self, image: np.ndarray, bare: np.ndarray) -> Plate:
        """Return the plate; where it differs from a picture's nearest bare pixels, it is a guess.

        Use it for pictures whose camera may have moved.
        """
        known = bare & self.seen
        if not known.any():
            return Plate.unknown(self.seen.shape)
        around = Around.of(known)
        off = np.abs(image - self._shaded(image, around)).mean(-1, keepdims=True)
        return replace(self, seen=self.seen & (around.mean(off)[..., 0] < AGREEING_DIFFERENCE))

    def _shaded(self, image: np.ndarray, around: Around) -> np.ndarray:
        """Return the plate in the shade of known pixels of a picture."""
        B = self.color
        shade = np.einsum("ijk,ijk->ij", image, B) / (np.einsum("ijk,ijk->ij", B, B) + 1e-3)
        return around.mean(shade[..., None].clip(0.2, 1.3)) * B

    def moved(self, A: np.ndarray) -> Plate:
        """Return the plate at A x (:func:`.camera.moved`); what lies outside it is a guess."""
        both = moved(np.concatenate([self.color, self.spread[..., None]], -1), A)
        seen = moved(self.seen[..., None], A, outside=0)[..., 0] > ALL_BACKGROUND
        spread = np.where(seen, both[..., 3], np.maximum(both[..., 3], np.float32(GUESSED_SPREAD)))
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
    share = uniform_filter(seen.astype(np.float32), MEAN_SQUARE, mode="constant").clip(1e-6)
    total = uniform_filter(color * seen[..., None], (MEAN_SQUARE, MEAN_SQUARE, 1), mode="constant")
    mean = (total / share[..., None])[tuple(nearest)]
    color = np.where(seen[..., None], color, mean)
    spread = np.where(seen, spread, GUESSED_SPREAD + SPREAD_PER_PIXEL * away)
    return color, spread.astype(np.float32)


@dataclass(frozen=True)
class Around:
    """Known pixels around each pixel of a grid (h, w), for means of any values there.

    A pixel without a known one in its square takes the mean around the nearest that has one.
    """

    weight: np.ndarray  # (h, w) float32: 1 where known
    total: np.ndarray  # (h, w) float32, share of known pixels in each square
    nearest: tuple[np.ndarray, ...] | None  # rows and columns; None: every square has a known one

    @staticmethod
    def of(known: np.ndarray) -> Around:
        """Look around each pixel for known ones (h, w) bool."""
        from scipy.ndimage import distance_transform_edt

        weight = known.astype(np.float32)
        total = _blurred(weight)
        near = total > 0.5 / MEAN_SQUARE**2
        nearest = None
        if near.any() and not near.all():
            nearest = distance_transform_edt(~near, return_distances=False, return_indices=True)
        return Around(weight, total, None if nearest is None else tuple(nearest))

    @property
    def empty(self) -> bool:
        """Whether no pixel is known."""
        return not self.weight.any()

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Return the mean (h, w, C) of known values (h, w, C); 0 if none is known."""
        if self.empty:
            return np.zeros_like(values)
        mean = _blurred(values * self.weight[..., None]) / np.maximum(self.total, 1e-6)[..., None]
        return mean if self.nearest is None else mean[self.nearest]

    def moments(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return :meth:`mean`, and the variance (h, w) of all channels; 1 if none is known."""
        mean, square = self.mean(values), self.mean((values**2).sum(-1, keepdims=True))
        if self.empty:
            return mean, np.ones(self.weight.shape, np.float32)
        return mean, np.maximum(square[..., 0] - (mean**2).sum(-1), 0)


def _blurred(x: np.ndarray) -> np.ndarray:
    """Return the mean of x (h, w, ...) over the square around each pixel, zero outside."""
    from scipy.ndimage import uniform_filter

    return uniform_filter(x, (MEAN_SQUARE, MEAN_SQUARE, 1)[: x.ndim], mode="constant")


# All chosen, by captions over a rendered person. Lengths are shares of the person's height.
STEADY, SURELY_STEADY = 0.8, 0.95  # least S: of edges that continue, and of those to begin from
LEAST_CONTRAST = 0.04  # root mean square of g, grey in [0, 1] per pixel: sharper than shading
LEAST_PICTURES = 3  # of each kind
STROKE = 0.01  # half a letter's stroke: a network may leave letters out of the person
REACH = 0.05  # along steady edges, from pixels that are surely on an overlay
FILLED = 0.015  # gaps between edges, such as the inside of a letter
EDGE_MARGIN = 2  # pixels around the edges: codecs blur them
# Pixels that are surely on an overlay, all together. Some stripes of a shirt lie where shelves are
# behind it: in rendered videos without captions up to 0.06.
SMALLEST_OVERLAY = 0.125
LARGEST_OVERLAY = 0.15  # share of the picture: what covers more is no caption


def overlay_of(
    pictures: Iterable[tuple[np.ndarray, np.ndarray]], height: float
) -> np.ndarray | None:
    """Return where an overlay is, (h, w) bool; None without one.

    Args:
        pictures: each (h, w, 3) 8-bit, with the person's probability (h, w) in [0, 1].
        height: of the person, pixels.
    """
    from scipy.ndimage import binary_dilation, binary_fill_holes, distance_transform_edt

    stroke = max(1, round(STROKE * height))
    sums: dict[bool, np.ndarray] = {}  # of g along both axes, |g|² and 1, with and without person
    for image, P in pictures:
        g = np.stack(np.gradient(image.mean(-1) / 255))
        terms = np.stack([*g, np.square(g).sum(0), np.ones(P.shape)])
        person = _closed(P > 0.5, 2 * stroke)
        away = ~binary_dilation(person, iterations=stroke)
        for kind, there in ((True, _eroded(person, stroke)), (False, away)):
            sums[kind] = sums.get(kind, 0) + there * terms
    total = sums[True] + sums[False]
    contrast = np.sqrt(total[2] / total[3].clip(1)) > LEAST_CONTRAST
    steady = contrast & (_steadiness(total) > STEADY)
    sure = contrast & (_steadiness(total) > SURELY_STEADY)
    for part in sums.values():
        sure &= (_steadiness(part) > SURELY_STEADY) & (part[3] >= LEAST_PICTURES)
    if sure.sum() < SMALLEST_OVERLAY * height:
        return None
    near = steady & (distance_transform_edt(~sure) <= REACH * height)
    edges = _closed(near, max(1, round(FILLED * height)))
    found = binary_dilation(binary_fill_holes(edges), iterations=EDGE_MARGIN)
    return found if found.mean() < LARGEST_OVERLAY else None


def filled_in(values: np.ndarray, overlay: np.ndarray) -> np.ndarray:
    """Return values (h, w, ...) with those on the overlay taken from the nearest pixel beside."""
    from scipy.ndimage import distance_transform_edt

    return values[
        tuple(distance_transform_edt(overlay, return_distances=False, return_indices=True))
    ]


def _steadiness(sums: np.ndarray) -> np.ndarray:
    """Return S of eq. 1 (h, w) of sums (4, h, w): of g, |g|² and 1."""
    return np.square(sums[:2]).sum(0) / np.maximum(sums[2] * sums[3], 1e-9)


def _closed(inside: np.ndarray, pixels: int) -> np.ndarray:
    """Fill gaps of up to twice so many pixels."""
    from scipy.ndimage import binary_closing

    wide = np.pad(inside, 2 * pixels)  # else the picture's border counts as empty
    return binary_closing(wide, iterations=pixels)[tuple([slice(2 * pixels, -2 * pixels)] * 2)]


def _eroded(inside: np.ndarray, pixels: int) -> np.ndarray:
    from scipy.ndimage import binary_erosion

    return binary_erosion(inside, iterations=pixels, border_value=1)
