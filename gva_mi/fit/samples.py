"""The pictures that a fit is measured against, held in memory and served one a step.

Reading, decoding and cutting out a frame takes longer than rendering it: every training frame is
read once, kept as 8 bits, and composited when its turn comes:

    I = picture · S + background · (1 - S)

All random numbers of a step come from the run's seed and the step's number alone. A run that is
resumed therefore draws what an uninterrupted one would have drawn, with no state to save.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import torch
from torch import Tensor

from gva_mi.data.video import Video
from gva_mi.fit.losses import Window
from gva_mi.splat import Camera


class Stream(IntEnum):
    """The streams of random numbers in a run, one for each purpose."""

    ORDER = 0  # of the frames in a pass
    BACKGROUND = 1
    WINDOW = 2
    SEED = 3  # of the avatar
    DENSIFY = 4
    REINIT = 5


def random_state(seed: int, stream: Stream, number: int = 0) -> np.random.Generator:
    """The numpy generator of one stream at one step (or pass) of a run."""
    return np.random.default_rng([seed, stream, number])


def torch_state(seed: int, stream: Stream, number: int = 0) -> torch.Generator:
    """The torch generator of one stream at one step of a run."""
    drawn = random_state(seed, stream, number).integers(2**63)
    return torch.Generator().manual_seed(int(drawn))


@dataclass(frozen=True)
class Sample:
    """What one step of the fit is measured against."""

    frame: int  # its number in the video
    color: Tensor  # (H, W, 3) in [0, 1], the person on the background
    mask: Tensor  # (H, W) in [0, 1]
    background: Tensor  # (3,) in [0, 1]
    camera: Camera
    window: Window  # a random part of the image with some of the person in it


class Samples:
    """The training frames of a video.

    Args:
        video: the video they are read from.
        frames: numbers of the frames to hold.
        seed: seed of the run.
        random_background: whether the background has another colour at each step, or is white.
        window: side of the random part, pixels; a smaller image is taken whole.
    """

    def __init__(
        self, video: Video, frames: Sequence[int], seed: int, random_background: bool, window: int
    ) -> None:
        self.frames, self.seed = list(frames), seed
        self.random_background, self.window = random_background, window
        self.cameras = [video.cameras[k] for k in self.frames]
        pictures, masks, self.boxes = [], [], []
        for frame in video.frames(self.frames):
            pictures.append(torch.from_numpy(np.round(frame.image * 255).astype(np.uint8)))
            masks.append(torch.from_numpy(np.round(frame.mask * 255).astype(np.uint8)))
            self.boxes.append(_bounding_box(frame.mask > 0.5))
        self.pictures, self.masks = torch.stack(pictures), torch.stack(masks)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, step: int) -> Sample:
        """The sample of a step: every pass over the frames goes in another order."""
        which, position = divmod(step, len(self))
        k = int(random_state(self.seed, Stream.ORDER, which).permutation(len(self))[position])
        background = torch.ones(3)
        if self.random_background:
            drawn = random_state(self.seed, Stream.BACKGROUND, step).random(3, dtype=np.float32)
            background = torch.from_numpy(drawn)
        mask = self.masks[k].float() / 255
        color = self.pictures[k].float() / 255
        color = torch.lerp(background.expand_as(color), color, mask[..., None])
        return Sample(
            self.frames[k], color, mask, background, self.cameras[k], self._window(k, step)
        )

    def _window(self, k: int, step: int) -> Window:
        random = random_state(self.seed, Stream.WINDOW, step)
        sides = []
        for (first, last), size in zip(self.boxes[k], self.masks.shape[1:], strict=True):
            side = min(self.window, size)
            start = int(random.integers(first, last)) - side // 2
            start = min(max(start, 0), size - side)
            sides.append(slice(start, start + side))
        return sides[0], sides[1]


def _bounding_box(mask: np.ndarray) -> list[tuple[int, int]]:
    """Rows and columns, each (first, last + 1), that hold a mask (H, W) which is not empty."""
    spans = [np.flatnonzero(mask.any(axis)) for axis in (1, 0)]
    return [(int(span[0]), int(span[-1]) + 1) for span in spans]
