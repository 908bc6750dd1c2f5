"""Read and write pictures; read a picture as a mask, and a render's background.

A mask chooses the channel that marks the person:

=========================================  ====================================================
Picture                                    Inside
=========================================  ====================================================
with alpha that is somewhere below 255     its alpha
a palette of greys                         its luminance
any other palette                          its labels; 255 beside others is a border, and zero
grey, and RGB that is grey                 its luminance
colours                                    refused: a photograph, or a drawing of labels
=========================================  ====================================================

Alpha that is 255 everywhere is ignored: some programs always add it.

Colours become those of sRGB: phones write Display P3, and say so in an embedded profile (ICC). A
mask's values and normals are no colours, and stay as they are.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.core.atomic import atomic_write
from gva_mi.core.errors import InputError, reason_of
from gva_mi.core.files import once_a_file, require_file, require_room

if TYPE_CHECKING:
    from PIL import Image, ImageCms

MOST_PIXELS = 1 << 25  # of a picture. Chosen: 8K UHD has fewer, and memory holds some of them
WRITTEN_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}  # by suffix; Pillow's names
READ_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP")  # their decoders start no other program
VOID_LABEL = 255  # of pixels that belong to no object: borders in the drawings of PASCAL VOC
GREY_TOLERANCE = 32  # largest difference of a grey pixel's channels. Chosen: JPEG stays below it
SRGB_ROUNDING = 2  # levels by which profiles of sRGB differ. Chosen: nobody sees the difference
PNG_LEVEL = 2  # chosen: a quarter of the default level's time, for a tenth more bytes


def read_image(path: Path, channels: int, are_colors: bool = True) -> np.ndarray:
    """Read a picture, turned as its metadata say.

    ``channels`` is 3 for sRGB (H, W, 3) or 4 with alpha, of 8 bits; or 1 for the values of a mask
    (H, W), of 8 bits (as above) or 16, which :mod:`.masks` interprets. Values that are no colours,
    such as normals, are not converted to sRGB.
    """
    from PIL import Image, ImageOps

    with opened(path) as stored:
        stored.load()
        _require_whole(path, stored)
        image = ImageOps.exif_transpose(stored)
        if channels == 1 and image.mode.startswith("I"):
            raw = np.asarray(image)
            if 0 <= raw.min(initial=0) <= raw.max(initial=0) <= 65535:
                return raw.astype(np.uint16)
        if image.mode.startswith("I") or image.mode == "F":  # which Pillow would clip
            raw = np.asarray(image).astype(np.float64)
            raw = raw / (257 if raw.max(initial=0) > 255 else 1)
            image = Image.fromarray(raw.astype(np.uint8))
        if channels == 1:
            return matte_of(str(path), image)
        image = _in_srgb(image) if are_colors else image
        return np.asarray(image.convert({3: "RGB", 4: "RGBA"}[channels]))


def _in_srgb(image: Image.Image) -> Image.Image:
    """Convert a picture from its embedded profile; as viewers do, ignore one that does not fit."""
    from PIL import ImageCms

    if not (profile := image.info.get("icc_profile")):
        return image
    image = image.convert("RGBA") if image.mode == "P" else image
    try:
        transform = _srgb_transform(profile, image.mode)
        return image if transform is None else ImageCms.applyTransform(image, transform)
    except (ImageCms.PyCMSError, OSError, ValueError):
        return image


@lru_cache(maxsize=8)
def _srgb_transform(profile: bytes, mode: str) -> ImageCms.ImageCmsTransform | None:
    """Return a transform to sRGB; None for a profile of sRGB, so that no value moves."""
    from PIL import Image, ImageCms

    source, target = ImageCms.ImageCmsProfile(BytesIO(profile)), ImageCms.createProfile("sRGB")
    output = "RGBA" if mode == "RGBA" else "RGB"
    transform = ImageCms.buildTransform(source, target, mode, output)
    values = np.linspace(0, 255, 17).astype(np.uint8)
    colors = Image.fromarray(np.stack(np.meshgrid(values, values, values), -1).reshape(289, 17, 3))
    same = ImageCms.applyTransform(colors.convert(mode), transform)
    off = np.abs(np.asarray(same.convert("RGB")).astype(int) - np.asarray(colors)).max()
    return None if mode in ("RGB", "RGBA") and off <= SRGB_ROUNDING else transform


def _require_whole(path: Path, image: Image.Image) -> None:
    """Refuse a picture whose data end before its last row.

    Pillow takes it as whole if the file ends as it should. It leaves zeros, or the grey of a JPEG.
    """
    width, height = image.size
    corner = np.asarray(image.crop((max(0, width - 8), max(0, height - 2), width, height)))
    doubtful = {
        "PNG": not corner.reshape(len(corner), -1).any(1).all(),
        "JPEG": bool((corner == 128).all()) or "progressive" in image.info,
    }.get(image.format)
    if doubtful and _ends_early(path):
        raise InputError(f"{path}: its data end before the last row; expected a whole picture")


@once_a_file
def _ends_early(path: Path) -> bool:
    """Decode with other values for what is missing, and return whether the picture changes."""
    from PIL import Image

    data, found = path.read_bytes(), []
    end = data.rfind(b"\xff\xd9")  # the end of a JPEG, where its decoder would find more
    for value in (0, 85):
        more = bytes([value]) * 4096 if data.startswith(b"\xff\xd8") else b""
        with Image.open(BytesIO(data[:end] + more + data[end:]), formats=READ_FORMATS) as image:
            bands = len(image.getbands())
            image.im = Image.new(
                image.mode, image.size, (value,) * bands if bands > 1 else value
            ).im
            found.append(np.asarray(image))  # a PNG's decoder writes into these pixels
    return not np.array_equal(*found)


@once_a_file
def size_of_whole(path: Path) -> tuple[int, int]:
    """Decode a picture completely, which finds any damage, and return its size (W, H)."""
    return read_image(path, 3).shape[1::-1]


@contextmanager
def opened(path: Path) -> Iterator[Image.Image]:
    """Open a picture of an acceptable size, whose pixels are not decoded yet."""
    from PIL import Image

    require_file(path, "an 8-bit PNG")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is checked
            with Image.open(path, formats=READ_FORMATS) as image:
                require_size(str(path), *image.size)
                yield image
    except InputError:
        raise
    except Exception as error:  # each decoder of Pillow raises errors of its own
        raise InputError(f"{path}: not a readable picture ({reason_of(error)})") from None


def require_size(where: str, width: int, height: int) -> None:
    """Refuse a picture without pixels, or of more than :data:`MOST_PIXELS`, before it is read."""
    if min(width, height) < 1 or width * height > MOST_PIXELS:
        raise InputError(
            f"{where}: pictures must have from 1 to {MOST_PIXELS:,} pixels, got {width}x{height}"
        )


def require_sides(where: str, image: np.ndarray, width: int, height: int) -> None:
    """Refuse a picture (H, W, ...) of another size than its camera's."""
    if image.shape[:2] != (height, width):
        raise InputError(f"{where} is {image.shape[1]}x{image.shape[0]}, expected {width}x{height}")


def write_image(path: Path, image: np.ndarray) -> None:
    """Write a picture, floats in [0, 1] or 8-bit, grey (H, W), RGB (H, W, 3) or RGBA (H, W, 4)."""
    from PIL import Image

    with atomic_write(path) as unfinished:
        kind = WRITTEN_FORMATS[Path(path).suffix.lower()]
        Image.fromarray(in_8_bits(image)).save(unfinished, kind, compress_level=PNG_LEVEL)


def in_8_bits(image: np.ndarray) -> np.ndarray:
    """Convert a picture of floats in [0, 1] to 8 bits; one of 8 bits is returned as it is."""
    if image.dtype == np.uint8:
        return image
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)


def require_picture(path: Path, overwrite: bool) -> None:
    """Refuse a path where no .png can be written, before the work starts whose result it shows."""
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: a picture's name ends in .png")
    require_room(path, overwrite)


def read_background(name: str, width: int, height: int) -> np.ndarray:
    """Read a background, float32 in [0, 1]: (3,) for a colour, (height, width, 3) otherwise.

    ``name`` is of a colour, such as "white" or "#ff8800"; or of a picture, which is scaled to cover
    the size, and cropped.
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


def matte_of(where: str, image: Image.Image) -> np.ndarray:
    """Convert an 8-bit picture to a mask (H, W) 8-bit, 255 inside; ``where`` names it in errors.

    Labels of a palette are returned as they are: :mod:`.masks` says what they mean.
    """
    if image.mode in ("LA", "La", "RGBA", "RGBa", "PA") or (
        image.mode == "P" and "transparency" in image.info
    ):
        alpha = np.asarray(image.convert("RGBA").getchannel("A"))
        if alpha.min(initial=255) < 255:
            return alpha
    if image.mode in ("P", "PA"):
        return _of_palette(image)
    if image.mode in ("1", "L", "LA", "La"):
        return np.asarray(image.convert("L"))
    return matte_of_pixels(where, np.asarray(image.convert("RGB")))


def matte_of_pixels(where: str, pixels: np.ndarray) -> np.ndarray:
    """Convert 8-bit pixels (H, W, 3), such as a video's, to a mask."""
    from PIL import Image

    if (np.ptp(pixels, axis=2) > GREY_TOLERANCE).any():
        raise InputError(
            f"{where}: a mask in colours, such as a photograph or a drawing of labels, does not "
            "say what is inside; expected white before black, or alpha"
        )
    return np.asarray(Image.fromarray(pixels).convert("L"))


def _of_palette(image: Image.Image) -> np.ndarray:
    """Return the values of a palette picture: colours if all that is used is grey, else labels."""
    colors = np.asarray(image.convert("RGB"))
    if (colors == colors[..., :1]).all():
        return np.ascontiguousarray(colors[..., 0])
    labels = np.array(image if image.mode == "P" else image.getchannel(0))
    if (labels == VOID_LABEL).any() and ((labels > 0) & (labels < VOID_LABEL)).any():
        labels[labels == VOID_LABEL] = 0
    return labels
