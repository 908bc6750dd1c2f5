"""Make masks and normals of a subject's frames by networks that users bring."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np

from gva_mi.core.console import Progress, listed
from gva_mi.core.errors import InputError
from gva_mi.data.crop import bounds
from gva_mi.data.folder import FRAMES, MASKS, SubjectWriter, frame_name
from gva_mi.data.masks import read_mask
from gva_mi.data.networks.normals import NormalNetwork
from gva_mi.data.networks.segment_anything import MaskGuess, Prompt, SegmentAnything
from gva_mi.data.pictures import read_image, write_image

HELD = 0.5  # of the person's points: a mask with fewer is doubtful


def write_masks(
    folder: Path,
    network: SegmentAnything,
    picture: Callable[[int], np.ndarray],
    prompts: Sequence[Prompt | None],
    progress: Progress | None = None,
) -> list[str]:
    """Write masks into a folder, each guided by the mask before; return notes.

    ``picture`` gives a frame (H, W, 3) 8-bit. A frame without a prompt gets no mask.
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
            write_image(folder / frame_name(k), before.mask * np.uint8(255))
            x, y = np.floor(prompt.points[prompt.labels == 1]).astype(int).T
            if before.mask[y, x].mean() < HELD:
                doubtful.append(k)
        if progress:
            progress(k + 1, len(prompts))
    if len(none) == len(prompts):
        raise InputError(
            f"{folder}: Segment Anything found nobody in any frame; are the poses of this video, "
            "and the weights those of Segment Anything?"
        )
    notes = [f"frames where the network found nobody: {listed(none)}"] if none else []
    if doubtful:
        notes.append(f"masks that hold less than half of the person's points: {listed(doubtful)}")
    return notes


def write_normals(
    folder: Path,
    network: NormalNetwork,
    count: int,
    progress: Progress | None = None,
) -> list[str]:
    """Write ``normals/`` and ``normals.json`` of a subject that has its masks; return notes.

    A map shows a part of the frame, which ``normals.json`` says, at the network's own resolution.

    Args:
        folder: of the subject.
        network: that sees the pictures.
        count: of the frames.
        progress: called after every frame.
    """
    writer, boxes, maps = SubjectWriter(folder), [[0, 0, 1, 1]] * count, 0
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
