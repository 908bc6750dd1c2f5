"""Read and write pictures and films; read a render's background."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from gva_mi.core.atomic import atomic_write
from gva_mi.core.errors import MALFORMED, InputError, reason_of
from gva_mi.core.files import once_a_file, require_file, require_room
from gva_mi.data.film_colors import rgb_of
from gva_mi.data.mattes import matte_of

if TYPE_CHECKING:
    import av
    from PIL import Image

MOST_PIXELS = 1 << 25  # of a picture; 8K UHD has fewer
FORMAT_OF = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}  # of pictures that are written
FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP")  # none starts another program
SEE_THROUGH = ".webm"  # of films with alpha, which an .mp4 cannot hold
_WAYS = {  # of a film: container, codec, its pixels and options, the pixels that it is given
    # x264 writes its settings into the file, the number of threads among them: always use one.
    "lossless": ("mp4", "libx264rgb", "rgb24", {
        "crf": "0", "preset": "veryfast", "threads": "1"}, "rgb24"),
    # mbtree reads uninitialised memory: other bits in every run.
    "playable": ("mp4", "libx264", "yuv420p", {
        "crf": "18", "threads": "1", "mbtree": "0"}, "rgb24"),
    "alpha": ("webm", "libvpx-vp9", "yuva420p", {
        "crf": "12", "b": "0", "deadline": "good", "cpu-used": "4", "threads": "1", "row-mt": "0",
        "auto-alt-ref": "0"}, "rgba"),
}  # fmt: skip


def read_image(path: Path, channels: int) -> np.ndarray:
    """Read a picture, turned as its metadata say.

    ``channels`` is 3 for RGB (H, W, 3) or 4 for RGBA, of 8 bits; or 1 for the values of a mask
    (H, W), of 8 bits (:mod:`.mattes`) or 16, which :mod:`.masks` interprets.
    """
    from PIL import Image, ImageOps

    with opened(path) as stored:
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
        return np.asarray(image.convert({3: "RGB", 4: "RGBA"}[channels]))


@once_a_file
def size_of_whole(path: Path) -> tuple[int, int]:
    """Decode a picture, because damage shows nowhere else, and return its size (W, H)."""
    return read_image(path, 3).shape[1::-1]


@contextmanager
def opened(path: Path) -> Iterator[Image.Image]:
    """Open a picture of an acceptable size, whose pixels are not decoded yet."""
    from PIL import Image

    require_file(path, "an 8-bit PNG")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is checked
            with Image.open(path, formats=FORMATS) as image:
                require_size(str(path), *image.size)
                yield image
    except InputError:
        raise
    except Exception as error:  # each of its decoders has its own
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
        kind = FORMAT_OF[Path(path).suffix.lower()]
        # For a PNG a quarter of the usual level's time, for a tenth more bytes.
        Image.fromarray(in_8_bits(image)).save(unfinished, kind, compress_level=2)


def in_8_bits(image: np.ndarray) -> np.ndarray:
    """Convert a picture of floats in [0, 1] to 8 bits; one of 8 bits is returned as it is."""
    if image.dtype == np.uint8:
        return image
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)


def require_picture(path: Path, overwrite: bool) -> None:
    """Check that a .png can be written, before the work whose result it shows."""
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


def decoded(path: Path) -> Iterator[av.VideoFrame]:
    """Yield the frames of a film."""
    count = 0
    with decoding(path), open_film(path) as container:
        for frame in _with_alpha(container):
            require_size(str(path), frame.width, frame.height)
            yield frame
            count += 1
    if not count:
        raise InputError(f"{path}: holds no picture")


def _with_alpha(container: av.container.InputContainer) -> Iterator[av.VideoFrame]:
    """Yield the frames of a film; with their alpha, which FFmpeg's own decoder of VP9 drops."""
    import av

    stream = container.streams.video[0]
    decoder = {"vp8": "libvpx", "vp9": "libvpx-vp9"}.get(stream.codec_context.name)
    alpha = ("alpha_mode", "1") in {(key.lower(), x) for key, x in stream.metadata.items()}
    if not alpha or decoder not in av.codecs_available:
        yield from container.decode(stream)
        return
    decoder = av.CodecContext.create(decoder, "r")
    for packet in container.demux(stream):
        yield from decoder.decode(packet)


def open_film(path: Path) -> av.container.InputContainer:
    """Open a film whose pictures have an acceptable size."""
    import av

    with decoding(path):
        container = av.open(str(path))
        if not container.streams.video:
            raise InputError(f"{path}: holds no picture, only sound; expected a film")
        stream = container.streams.video[0]
        require_size(str(path), stream.width, stream.height)
        return container


@contextmanager
def decoding(path: Path) -> Iterator[None]:
    """Convert any decoding error of a film to an InputError of one sentence."""
    import av

    try:
        yield
    except InputError:
        raise
    except (*MALFORMED, av.FFmpegError, OSError, MemoryError) as error:
        raise InputError(f"{path}: cannot be decoded as a video ({reason_of(error)})") from None


def pixels_of(frame: av.VideoFrame, form: str) -> np.ndarray:
    """Return a decoded frame as a picture (H, W, C) 8-bit, turned as its metadata say.

    ``form`` is FFmpeg's name of the pixels' format: "rgb24", or "rgba" for masks.
    """
    return turned(rgb_of(frame) if form == "rgb24" else frame.to_ndarray(format=form), frame)


def turned(pixels: np.ndarray, frame: av.VideoFrame) -> np.ndarray:
    """Turn a picture (H, W, C) as the metadata of its frame say."""
    return np.ascontiguousarray(np.rot90(pixels, _quarter_turns(frame)))


def size_of(frame: av.VideoFrame) -> tuple[int, int]:
    """Return the size (W, H) of the picture that :func:`pixels_of` returns."""
    size = frame.width, frame.height
    return size[::-1] if _quarter_turns(frame) % 2 else size


def _quarter_turns(frame: av.VideoFrame) -> int:
    """Return how many quarter turns counter-clockwise a frame's metadata ask for."""
    return round(frame.rotation / 90) % 4


def steps_of(path: Path) -> tuple[np.ndarray, float]:
    """Return the seconds (T − 1,) between a film's pictures, and one tick of its clock."""
    import av

    with decoding(path), av.open(str(path)) as container:
        stream = container.streams.video[0]
        moments = [packet.pts for packet in container.demux(stream) if packet.pts is not None]
        tick = float(stream.time_base or 0)
    return np.diff(np.sort(np.array(moments, np.float64))) * tick, tick


def require_alpha_codec(path: Path) -> None:
    """Raise an InputError where films with alpha cannot be written."""
    import av

    if "libvpx-vp9" not in av.codecs_available:
        raise InputError(
            f"{path}: the installed PyAV has no libvpx-vp9, which films with alpha need; expected "
            "its own wheel, pip install av"
        )


def write_film(
    path: Path,
    images: Iterable[np.ndarray],
    fps: int = 25,
    way: Literal["lossless", "playable", "alpha"] = "lossless",
) -> None:
    """Write a film of pictures (H, W, C), floats in [0, 1] or 8-bit.

    Lossless is an mp4 in RGB; playable is an mp4 that every player shows; alpha is a .webm of RGBA
    pictures, straight alpha. The last two drop the last row or column of odd sizes.
    """
    import av

    kind, codec, pixels, options, given = _WAYS[way]
    bare = {"fflags": "+bitexact"} if way == "alpha" else {}  # no time stamp or random number
    with (
        atomic_write(path) as unfinished,
        av.open(str(unfinished), "w", format=kind, options=bare) as container,
    ):
        stream = container.add_stream(codec, rate=fps)
        stream.pix_fmt, stream.options = pixels, options
        if way == "alpha":
            stream.metadata["alpha_mode"] = "1"  # players need it
        for k, image in enumerate(images):
            image = in_8_bits(image)
            if way != "lossless":  # halved colours: even sizes
                image = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
            if k == 0:
                stream.height, stream.width = image.shape[:2]
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), given)
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
