"""Masks and normals that a user provides: files of another program, or a network that makes them.

A user's masks replace those of :mod:`gva_mi.matting`. Masks that a user's network makes are
combined with the probabilities of the landmark network (:class:`WithMasks`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np

from gva_mi.core.console import Progress, listed
from gva_mi.core.errors import InputError
from gva_mi.core.options import options_of
from gva_mi.networks.normals import NormalNetwork
from gva_mi.networks.segment_anything import MaskGuess, Prompt, SegmentAnything
from gva_mi.subject import footage
from gva_mi.subject.crop import bounds
from gva_mi.subject.folder import FRAMES, MASKS, SubjectWriter, frame_name
from gva_mi.subject.masks import INSIDE_ABOVE, read_mask, require_person
from gva_mi.subject.pictures import in_8_bits, read_image

# All chosen.
CERTAIN_PROBABILITY = 0.95  # no network counts as more certain than this
LEAST_HELD = 0.5  # share of the person's certain pixels, or points, that lie in a right mask
ASPECT_TOLERANCE = 0.01  # relative difference of a mask's aspect from the video's


@options_of("prepare")
class MaskOptions:
    """Masks that come from another program."""

    # Masks of the person: a video, a folder of pictures, or a .npy (T, H, W), one for each frame.
    # Or a folder of Segment Anything or SAM 2 as transformers saves it, which makes the masks. A
    # video and a data set have masks without it.
    masks: Path | None = None

    def mask_network(self) -> SegmentAnything | None:
        """Return the network that makes the masks, read before any work is done."""
        named = self.masks is not None and (self.masks / "config.json").is_file()
        return SegmentAnything.load(self.masks) if named else None


def write_own_masks(
    writer: SubjectWriter,
    source: Path,
    numbers: Sequence[int],
    total: int,
    size: tuple[int, int],
    probabilities: Sequence[np.ndarray],
    progress: Progress | None = None,
) -> list[str]:
    """Write a user's masks of a video's used pictures, and return notes.

    Args:
        writer: of the subject.
        source: what :func:`gva_mi.subject.footage.masks` reads, a mask for each picture of the
            video file.
        numbers: T numbers of the used pictures in the video file, ascending.
        total: pictures of the video file.
        size: (W, H) of the used pictures, which may be smaller than the masks.
        probabilities: T maps (H, W) 8-bit by a network, which reveal masks of another video.
        progress: called after each used picture.
    """
    used = {number: k for k, number in enumerate(numbers)}
    counts, held, read = np.zeros(256, np.int64), [], 0
    for read, mask in enumerate(footage.masks(source), 1):
        if (k := used.get(number := read - 1)) is None:
            continue
        mask = _in_size(f"{source}: mask {number}", mask, size)
        writer.mask(k, mask)
        counts += np.bincount(mask.ravel(), minlength=256)
        person = probabilities[k] > 255 * CERTAIN_PROBABILITY
        if person.any():
            held.append((mask[person] > INSIDE_ABOVE).mean())
        if progress:
            progress(k + 1, len(numbers))
    if read != total:
        raise InputError(
            f"{source}: holds {read} masks, but the video has {total} pictures; expected a mask "
            "for each picture of the video, in order"
        )
    require_person(str(source), counts)
    if held and np.median(held) < LEAST_HELD:
        raise InputError(
            f"{source}: its masks do not lie on the person of the video; expected a mask for each "
            "picture of the video, in order, of its upright pictures"
        )
    return [f"masks of {source}"]


def _in_size(where: str, mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a mask (h, w) 8-bit in the size (W, H) of the used pictures."""
    from PIL import Image

    height, width = mask.shape
    if abs(width / height / (size[0] / size[1]) - 1) > ASPECT_TOLERANCE:
        raise InputError(
            f"{where}: {width}x{height}, but the video's pictures are {size[0]}x{size[1]}"
        )
    if (width, height) == size:
        return mask
    return np.asarray(Image.fromarray(mask).resize(size, Image.Resampling.BOX))


def write_masks(
    writer: SubjectWriter,
    network: SegmentAnything,
    picture: Callable[[int], np.ndarray],
    prompts: Sequence[Prompt | None],
    progress: Progress | None = None,
) -> list[str]:
    """Segment the person in all frames, write the masks, and return notes.

    Each frame is guided by its prompt and by the mask before; a frame without a prompt gets no
    mask. ``picture`` returns a frame (H, W, 3) 8-bit.
    """
    before: MaskGuess | None = None
    none, doubtful = [], []
    for k, prompt in enumerate(prompts):
        if prompt is not None:
            before = network.find(picture(k), prompt, before)
        if prompt is None or not before.mask.any():
            before = None
            none.append(k)
        else:
            writer.mask(k, before.mask * np.uint8(255))
            x, y = np.floor(prompt.points[prompt.labels == 1]).astype(int).T
            if before.mask[y, x].mean() < LEAST_HELD:
                doubtful.append(k)
        if progress:
            progress(k + 1, len(prompts))
    if len(none) == len(prompts):
        raise InputError(
            f"{writer.folder}: Segment Anything found nobody in any frame; expected poses of this "
            "very video, and weights of Segment Anything"
        )
    notes = [f"frames where the network found nobody: {listed(none)}"] if none else []
    if doubtful:
        notes.append(f"masks that hold less than half of the person's points: {listed(doubtful)}")
    return notes


class WithMasks(Sequence[np.ndarray]):
    """A network's probabilities P combined with another network's masks Q: their odds multiply.

    The result is ``P Q / (P Q + (1 - P) (1 - Q))``. Where P and Q contradict each other it is near
    a half, and the matting decides by colours.
    """

    def __init__(self, probabilities: Sequence[np.ndarray], folder: Path) -> None:
        """Combine with the masks in a folder; a picture without a mask keeps its probability."""
        self._probabilities, self._folder = probabilities, folder

    def __len__(self) -> int:
        return len(self._probabilities)

    def __getitem__(self, index: int) -> np.ndarray:
        found = self._probabilities[index]
        path = self._folder / frame_name(index)
        if not path.exists():
            return found
        shares = (x.astype(np.float32) / 255 for x in (found, read_image(path, 1)))
        P, Q = (x.clip(1 - CERTAIN_PROBABILITY, CERTAIN_PROBABILITY) for x in shares)
        return in_8_bits(P * Q / (P * Q + (1 - P) * (1 - Q)))


def write_normals(
    writer: SubjectWriter,
    network: NormalNetwork,
    count: int,
    progress: Progress | None = None,
) -> list[str]:
    """Estimate the normals of a subject that has its masks, write them, and return notes.

    A map shows the part of the frame around the person, at the network's own resolution;
    ``normals.json`` has the boxes.

    Args:
        writer: of the subject.
        network: estimates the normals.
        count: number of frames.
        progress: called after every frame.
    """
    folder, boxes, maps = writer.folder, [[0, 0, 1, 1]] * count, 0
    for k in range(count):
        mask = read_mask(folder / MASKS, k)
        box = None if mask is None else bounds(mask > 0.5)
        if box is not None:
            image = read_image(folder / FRAMES / frame_name(k), 3)
            crop, normals = network.see(image, mask, box)
            boxes[k] = list(astuple(crop))
            writer.normals(k, normals)
            maps += 1
        if progress:
            progress(k + 1, count)
    writer.normals_record(network.spec.convention, boxes)
    return [f"normals of {maps} frames by {network.path.name}, {network.spec.convention}"]
