"""Pictures, arrays and films on disk: 8-bit PNG, .npy, mp4; and what lies behind a render."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gva_mi.errors import InputError
from gva_mi.files import replacing

# x264 writes its settings, the number of threads among them, into the file: one thread, one file.
LOSSLESS = {"crf": "0", "preset": "veryfast", "threads": "1"}  # with libx264rgb
PLAYABLE = {"crf": "18", "threads": "1"}  # with libx264 and yuv420p


def read_image(path: Path, channels: int) -> np.ndarray:
    """An 8-bit picture, (H, W, 3) or, with ``channels`` 1, (H, W)."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB" if channels == 3 else "L"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected an 8-bit PNG") from None
    except (UnidentifiedImageError, OSError) as error:
        raise InputError(f"{path}: not a readable picture ({error})") from None


def write_image(path: Path, image: np.ndarray) -> None:
    """Write a picture, floats in [0, 1] or 8-bit, grey (H, W), RGB (H, W, 3) or RGBA (H, W, 4)."""
    from PIL import Image

    if image.dtype != np.uint8:
        image = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path)


def read_background(name: str, width: int, height: int) -> np.ndarray:
    """What lies behind a render, float32 in [0, 1].

    Args:
        name: of a colour, such as "white" or "#ff8800"; or a picture file, which is scaled to cover
            the size, and cut at its longer sides.
        width, height: pixels.

    Returns:
        (3,) for a colour, (height, width, 3) for a picture.

    Raises:
        InputError: it is neither.
    """
    from PIL import Image, ImageColor, ImageOps

    try:
        return np.array(ImageColor.getrgb(name)[:3], dtype=np.float32) / 255
    except ValueError:
        if not Path(name).is_file():
            raise InputError(
                f"{name}: neither a picture file nor a colour, such as white or #ff8800"
            ) from None
    picture = Image.fromarray(read_image(Path(name), 3))
    return np.asarray(ImageOps.fit(picture, (width, height)), dtype=np.float32) / 255


def read_array(path: Path, mapped: bool = False) -> np.ndarray:
    """One array of a ``.npy``, which must not hold pickled objects.

    Args:
        path: of the file.
        mapped: leave it on disk until it is looked at.
    """
    try:
        return np.load(path, allow_pickle=False, mmap_mode="r" if mapped else None)
    except (ValueError, OSError, EOFError) as error:
        raise InputError(f"{path}: not a readable .npy ({str(error).splitlines()[0]})") from None


def write_movie(
    path: Path, images: Iterable[np.ndarray], fps: int = 25, lossless: bool = True
) -> None:
    """Write an mp4, RGB without loss by default; otherwise yuv420p, which every player shows.

    An older one is replaced once the new one is whole.
    """
    import av

    with replacing(path) as unfinished, av.open(str(unfinished), "w", format="mp4") as container:
        stream = container.add_stream("libx264rgb" if lossless else "libx264", rate=fps)
        stream.pix_fmt = "rgb24" if lossless else "yuv420p"
        stream.options = LOSSLESS if lossless else PLAYABLE
        for k, image in enumerate(images):
            if image.dtype != np.uint8:
                image = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
            if not lossless:  # 4:2:0 wants even sizes
                image = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
            if k == 0:
                stream.height, stream.width = image.shape[:2]
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), "rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
