"""Pair the renders of any method with the pictures that they should equal, by frame number."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from gva_mi.body.smplx import BodyModel
from gva_mi.core.errors import InputError
from gva_mi.data.backdrop import alone
from gva_mi.data.film import Film
from gva_mi.data.importers.footage import files_of, masks
from gva_mi.data.importers.numbering import number_in
from gva_mi.data.pictures import in_8_bits, read_image
from gva_mi.data.video import Video
from gva_mi.study.regions import Details
from gva_mi.study.score_pictures import PicturePair

Color = np.ndarray | None  # (3,) in [0, 1]; None: pictures stay as they are


Numbered = Mapping[int, Callable[[], np.ndarray]]  # pictures (H, W, 3 or 4) 8-bit by number


def numbered(source: Path) -> Numbered:
    """Open the pictures of a folder by the numbers in their names, or of a film in their order."""
    files = files_of(source)
    if files is None:
        film = Film(source)
        return {k: partial(film.__getitem__, k) for k in range(len(film))}
    try:
        return {number_in(path): partial(read_image, path, 4) for path in files}
    except ValueError as error:
        raise InputError(f"{source}: {error}; expected a frame's number in each") from None


def pairs_of_subject(
    renders: Path, video: Video, body: BodyModel, color: Color
) -> Iterator[PicturePair]:
    """Pair renders with a subject's frames, masks, and boxes of visible hands and faces.

    Raises:
        InputError: the subject has no frame of a render's number.
    """
    rendered, details = numbered(renders), Details.of(video, body)
    _require_all(rendered, set(range(len(video))) - set(video.absent), video.folder)

    def pair(number: int) -> PicturePair:
        frame = video.truly_cut(video[number])
        picture = _on(color, in_8_bits(frame.image), frame.mask)
        boxes = tuple(details.boxes(number))
        render = _on(color, rendered[number]())
        return PicturePair(f"frame {number}", render, picture, frame.mask, boxes)

    return map(pair, rendered)


def pairs_of_pictures(
    renders: Path, truth: Path, masked: Path | None, color: Color
) -> Iterator[PicturePair]:
    """Pair renders with pictures of the same numbers, and with their masks if given.

    Raises:
        InputError: there is no picture, or no mask, of a render's number.
    """
    rendered, seen = numbered(renders), numbered(truth)
    _require_all(rendered, seen, truth)
    inside: dict[int, np.ndarray] = {}
    if masked is not None:
        named = masked.is_dir() and not any(masked.glob("*.npy"))
        numbers = map(number_in, files_of(masked)) if named else range(len(seen))
        inside = dict(zip(numbers, masks(masked), strict=False))
        _require_all(rendered, inside, masked)

    def pair(number: int) -> PicturePair:
        mask = inside[number].astype(np.float32) / 255 if inside else None
        pictures = _on(color, rendered[number]()), _on(color, seen[number](), mask)
        return PicturePair(f"frame {number}", *pictures, mask)

    return map(pair, rendered)


def _require_all(rendered: Numbered, known: Container[int], source: Path) -> None:
    """Raise an InputError for the first render without a counterpart."""
    for number in rendered:
        if number not in known:
            raise InputError(
                f"{source}: has no frame {number}, of which there is a render; expected files of "
                "the same numbers, or films of the same length"
            )


def _on(color: Color, picture: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """Put a picture (H, W, 3 or 4) on a colour, by its mask (H, W) or else by its alpha."""
    rgb = picture[..., :3]
    if color is None:
        return rgb
    if mask is None and picture.shape[2] == 3:
        return rgb
    if mask is None:
        alpha = picture[..., 3:].astype(np.float32) / 255
        return in_8_bits(rgb / 255 * alpha + color * (1 - alpha))
    if mask.shape != rgb.shape[:2]:
        sizes = f"{rgb.shape[1]}x{rgb.shape[0]}, its mask {mask.shape[1]}x{mask.shape[0]}"
        raise InputError(f"score: a picture has {sizes}; expected the same size")
    person = alone(rgb.astype(np.float32) / 255, mask)
    return in_8_bits(person + color * (1 - mask[..., None]))
