"""``Capture``: a source's people, with its pictures, masks and split if it has them.

An estimator's file holds people alone; a data set also has pictures, masks and a split.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gva_mi.data.importers.footage import Pictures, masks
from gva_mi.data.importers.tracks import Track
from gva_mi.data.masks import MaskMeaning
from gva_mi.data.splits import Splits

Numbered = Mapping[int, Path]  # files by the data set's numbers


@dataclass(frozen=True)
class FixedCamera:
    """One of a data set's cameras: x_cam = R x + T."""

    frames: Numbered
    masks: Numbered  # those that are there
    K: np.ndarray  # (3, 3) pixels
    R: np.ndarray  # (3, 3)
    T: np.ndarray  # (3,) metres
    distortion: np.ndarray  # (k1, k2, p1, p2, k3); zeros: a pinhole

    @staticmethod
    def of_opencv(
        frames: Numbered, masks: Numbered, K: object, R: object, T: object, distortion: object
    ) -> FixedCamera:
        """Make a camera from OpenCV's, whose first pixel has its centre at 0 and not at 0.5."""
        flat = lambda x: np.ravel(np.asarray(x, np.float64))
        half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        K, R = flat(K).reshape(3, 3) + half, flat(R).reshape(3, 3)
        return FixedCamera(frames, masks, K, R, flat(T), flat(distortion))


@dataclass(frozen=True)
class Capture:
    """People, and the pictures that show them."""

    tracks: list[Track]
    frames: Pictures
    masks: Pictures | None  # None: the source has none
    distortion: np.ndarray | None = None  # (k1, k2, p1, p2, k3) of the lens; None: a pinhole
    meaning: MaskMeaning | None = None  # of the masks' values; None: what they say themselves
    splits: Splits | None = None  # of the data set's own protocol
    loose: bool = False  # pictures, masks and poses may differ in number; the fewest count
    note: str = ""
    own: FixedCamera | None = None  # the video's, where there are others
    others: Mapping[str, Callable[[], FixedCamera]] = field(default_factory=dict)  # by name
    numbers: Sequence[int] = ()  # the data set's, of the video's frames; where there are others

    def read_masks(self, source: Pictures | None = None) -> Iterator[np.ndarray]:
        """Yield the data set's masks, or those of another source, with 255 inside."""
        return masks(source or self.masks, self.meaning)
