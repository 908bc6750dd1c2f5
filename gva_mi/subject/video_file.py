"""Read any picture of a video file with few in memory, as sRGB; write video files.

Opening a file decodes all of it once, which finds any damage, and keeps the time stamps. The
pictures that were decoded last stay in memory in the decoder's format, mostly half as large as RGB.
Other pictures are decoded on demand, from the key frame before them.

**Colours** are sRGB of 8 bits, whatever the video was recorded in.

* **Matrix and range** follow the video's tags. Without a tag, a video of at least 720 rows or 1280
  columns is BT.709, a smaller one BT.601, as players take it.
* **HDR** (PQ of SMPTE ST 2084, HLG of BT.2100), as phones record it, becomes light in units of the
  reference white, 203 cd/m² (BT.2408). BT.2020's primaries become those of sRGB. Light x of the
  brightest channel is compressed above a knee k, and the others by the same factor:

  1. ``f(x) = x`` below k,  ``k + (1 − k) (1 − exp(−(x − k) / (1 − k)))`` above.

* **SDR with BT.2020's primaries** changes primaries alone.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from gva_mi.core.atomic import atomic_write
from gva_mi.core.errors import MALFORMED, InputError, reason_of
from gva_mi.subject.pictures import in_8_bits, require_size

if TYPE_CHECKING:
    import av

# Numbers of ITU-T H.273: transfer functions, primaries, and the matrices of a video without a tag.
PQ, HLG, BT2020, UNTAGGED = 16, 18, 9, (0, 2)
HDR = {PQ: "PQ", HLG: "HLG"}
REFERENCE_WHITE = 203.0  # cd/m², BT.2408
HLG_PEAK = 1000.0  # cd/m², of the nominal display of HLG: BT.2100
HIGHLIGHT_KNEE = 0.7  # k of eq. 1. Chosen: most of a picture is darker, and keeps its colours
HD_WIDTH, HD_HEIGHT = 1280, 720  # pixels: an untagged video of this size or more is BT.709
BT2020_TO_BT709 = np.array(  # of linear light: BT.2087
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32
)
BT2020_LUMA = np.array([0.2627, 0.6780, 0.0593], np.float32)  # luminance of linear RGB: BT.2100
_ENCODINGS = {  # codec, pixel format and options
    # x264 writes its settings into the file, the number of threads among them: always use one.
    "lossless": ("libx264rgb", "rgb24", {"crf": "0", "preset": "veryfast", "threads": "1"}),
    # mbtree reads uninitialised memory, which gives other bits in every run.
    "playable": ("libx264", "yuv420p", {"crf": "18", "threads": "1", "mbtree": "0"}),
}
KEPT_BYTES = 1 << 27  # of decoded pictures. Chosen: 43 pictures of 1920 x 1080 in 4:2:0


class _Position(NamedTuple):
    """Where a decoder stands in a file."""

    number: int  # of the next picture
    frames: Iterator[Any]  # from there on
    container: Any  # the open file


class VideoFile(Sequence[np.ndarray]):
    """The pictures of a video file, each (H, W, 3) 8-bit, turned as its metadata say."""

    def __init__(self, path: Path, kept: int = KEPT_BYTES) -> None:
        """Decode the whole video once; ``kept`` bytes of decoded pictures may stay in memory."""
        self.path = Path(path)
        self.sizes: list[tuple[int, int]] = []  # (W, H) of each picture
        self._moments: list[int | None] = []
        self._keys: list[int] = []  # numbers of the key pictures
        self._at: _Position | None = None  # None: no decoder is open
        self._near, self._kept = _Near(kept), kept
        with open_video_file(self.path) as container:
            self._tick = float(container.streams.video[0].time_base or 0)
            self.hdr: str | None = None  # the name of its transfer of high dynamic range
            for frame in self._decoded(container):
                require_size(str(self.path), frame.width, frame.height)
                if frame.key_frame:
                    self._keys.append(len(self))
                self._near.put(len(self), frame)
                self.hdr = HDR.get(frame.color_trc, self.hdr)
                self.sizes.append(size_of(frame))
                self._moments.append(frame.pts)
        if not self.sizes:
            raise InputError(f"{path}: holds no picture")

    @property
    def times(self) -> np.ndarray | None:
        """Seconds at which the pictures are shown, (T,); None if the video does not say."""
        if self._tick == 0 or None in self._moments:
            return None
        return (np.array(self._moments, np.float64) - self._moments[0]) * self._tick

    def __len__(self) -> int:
        return len(self.sizes)

    def __getitem__(self, index: int) -> np.ndarray:
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        index %= len(self)
        if index in self._near:
            return self._near.rgb(index)
        key = self._keys[max(0, bisect_right(self._keys, index) - 1)] if self._keys else 0
        if self._at is None or not key <= self._at.number <= index:
            self._seek(index)
        number, frames, container = self._at
        for frame in frames:
            self._at = _Position(number + 1, frames, container)
            self._near.put(number, frame)
            if number == index:
                return self._near.rgb(index)
            number += 1
        raise InputError(
            f"{self.path}: picture {index} was decoded before, but now fails; was the file changed?"
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the open file; another process opens its own."""
        return self.__dict__ | {"_at": None, "_near": _Near(self._kept)}

    def _seek(self, index: int) -> None:
        """Go to the key picture at or before a picture, or to the start."""
        if self._at is not None:
            self._at.container.close()
        # A decoder's memory is freed with its last picture, so drop all of the old decoder's.
        self._at, self._near = None, _Near(self._kept)
        known = {moment: k for k, moment in enumerate(self._moments)}
        moment = self._moments[index]
        if moment is not None and len(known) == len(self):
            container = open_video_file(self.path)
            container.seek(moment, stream=container.streams.video[0])
            frames = self._decoded(container)
            first = next(frames, None)
            number = None if first is None else known.get(first.pts)
            if number is not None and number <= index:
                self._at = _Position(number, chain([first], frames), container)
                return
            container.close()
        container = open_video_file(self.path)
        self._at = _Position(0, self._decoded(container), container)

    def _decoded(self, container: Any) -> Iterator[Any]:  # noqa: ANN401 (an import costs everybody)
        with decoding(self.path):
            yield from container.decode(video=0)


class _Near:
    """Buffer of the pictures decoded last, consecutive, in the decoder's format."""

    def __init__(self, room: int) -> None:
        """Make an empty buffer of ``room`` bytes; it keeps the last picture whatever its size."""
        self._room = room
        self._frames: dict[int, Any] = {}  # by number, in their order
        self._converter: Any = None  # one for all: each would keep tables of its own

    def __contains__(self, number: int) -> bool:
        return number in self._frames

    def put(self, number: int, frame: Any) -> None:  # noqa: ANN401 (as _decoded)
        """Add the next picture, and drop the oldest ones if there is no room."""
        self._frames[number] = frame
        self._room -= _bytes_of(frame)
        while self._room < 0 and len(self._frames) > 1:
            self._room += _bytes_of(self._frames.pop(next(iter(self._frames))))

    def rgb(self, number: int) -> np.ndarray:
        """Return a picture, (H, W, 3) 8-bit."""
        from av.video.reformatter import VideoReformatter

        if self._converter is None:
            self._converter = VideoReformatter()
        frame = self._frames[number]
        array = turned(rgb_of(frame, self._converter), frame)  # may share the frame's memory
        return array.copy() if frame.format.name == "rgb24" else array


def _bytes_of(frame: Any) -> int:  # noqa: ANN401 (as _decoded)
    return sum(plane.buffer_size for plane in frame.planes)


def decoded(path: Path) -> Iterator[av.VideoFrame]:
    """Yield the decoded frames of a video file."""
    count = 0
    with decoding(path), open_video_file(path) as container:
        for frame in container.decode(video=0):
            require_size(str(path), frame.width, frame.height)
            yield frame
            count += 1
    if not count:
        raise InputError(f"{path}: holds no picture")


def open_video_file(path: Path) -> av.container.InputContainer:
    """Open a video file; refuse one without pictures, or with too large ones."""
    import av

    with decoding(path):
        container = av.open(str(path))
        if not container.streams.video:
            raise InputError(f"{path}: holds no picture, only sound; expected a video")
        stream = container.streams.video[0]
        require_size(str(path), stream.width, stream.height)
        return container


@contextmanager
def decoding(path: Path) -> Iterator[None]:
    """Convert any decoding error of a video to an InputError of one sentence."""
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
    """Return the size (W, H) of a frame that is turned as its metadata say."""
    size = frame.width, frame.height
    return size[::-1] if _quarter_turns(frame) % 2 else size


def _quarter_turns(frame: av.VideoFrame) -> int:
    """Return how many quarter turns counter-clockwise a frame's metadata ask for."""
    return round(frame.rotation / 90) % 4


def steps_of(path: Path) -> tuple[np.ndarray, float]:
    """Return the seconds (T − 1,) between a video file's pictures, and one tick of its clock."""
    import av

    with decoding(path), av.open(str(path)) as container:
        stream = container.streams.video[0]
        moments = [packet.pts for packet in container.demux(stream) if packet.pts is not None]
        tick = float(stream.time_base or 0)
    return np.diff(np.sort(np.array(moments, np.float64))) * tick, tick


def write_video(
    path: Path,
    images: Iterable[np.ndarray],
    fps: int = 25,
    way: Literal["lossless", "playable"] = "lossless",
) -> None:
    """Write an mp4 of pictures (H, W, 3), floats in [0, 1] or 8-bit.

    Lossless is RGB; every player shows a playable one, without the last row or column of odd sizes.
    """
    import av

    codec, pixels, options = _ENCODINGS[way]
    with (
        atomic_write(path) as unfinished,
        av.open(str(unfinished), "w", format="mp4") as container,
    ):
        stream = container.add_stream(codec, rate=fps)
        stream.pix_fmt, stream.options = pixels, options
        for k, image in enumerate(images):
            image = in_8_bits(image)
            if way == "playable":  # halved colours: even sizes
                image = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
            if k == 0:
                stream.height, stream.width = image.shape[:2]
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), "rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())


def rgb_of(
    frame: av.VideoFrame, converter: av.video.reformatter.VideoReformatter | None = None
) -> np.ndarray:
    """Return a frame as sRGB, (H, W, 3) 8-bit, not turned; it may share the frame's memory.

    ``converter`` is reused for similar frames, because each converter keeps tables.
    """
    from av.video.reformatter import Colorspace, VideoReformatter

    wide_gamut = frame.color_primaries == BT2020
    matrix = None
    if frame.colorspace in UNTAGGED and not frame.format.is_rgb:
        large = (
            max(frame.width, frame.height) >= HD_WIDTH
            or min(frame.width, frame.height) >= HD_HEIGHT
        )
        matrix = Colorspace.BT2020 if wide_gamut else Colorspace.ITU709 if large else None
    # Convert more than 8 bits to 16, because the converter to 8 truncates, up to 2 levels too dark.
    deep = any(component.bits > 8 for component in frame.format.components)
    kind = "rgb48le" if deep or wide_gamut or frame.color_trc in HDR else "rgb24"
    found = (converter or VideoReformatter()).reformat(frame, format=kind, src_colorspace=matrix)
    pixels = found.to_ndarray()
    if kind == "rgb24":
        return pixels
    if not wide_gamut and frame.color_trc not in HDR:
        return _in_8_bits(False)[pixels]
    table, gamma = _light_of(frame.color_trc)
    light = table[pixels]
    if gamma != 1:  # HLG: a display's contrast depends on the luminance of the scene
        light *= np.maximum(light @ BT2020_LUMA, 1e-6)[..., None] ** (gamma - 1)
        light *= HLG_PEAK / REFERENCE_WHITE
    light = np.maximum(light @ BT2020_TO_BT709.T, 0)
    if frame.color_trc in HDR:
        most = np.maximum(light.max(axis=2), HIGHLIGHT_KNEE)
        light *= (
            (
                HIGHLIGHT_KNEE
                + (HIGHLIGHT_KNEE - 1) * np.expm1((HIGHLIGHT_KNEE - most) / (1 - HIGHLIGHT_KNEE))
            )
            / most
        )[..., None]
    return _in_8_bits(True)[np.round(np.minimum(light, 1) * 65535).astype(np.uint16)]


@lru_cache
def _light_of(transfer: int) -> tuple[np.ndarray, float]:
    """Return linear light of all 16-bit values, (65536,) float32, and the exponent for HLG.

    PQ in units of the reference white, HLG in [0, 1] of the scene, others as sRGB's in [0, 1].
    """
    value = np.arange(65536) / 65535
    if transfer == PQ:
        root = value ** (1 / 78.84375)
        light = np.maximum(root - 0.8359375, 0) / (18.8515625 - 18.6875 * root)
        return (1e4 / REFERENCE_WHITE * light ** (1 / 0.1593017578125)).astype(np.float32), 1.0
    if transfer == HLG:
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        light = np.where(value <= 0.5, value**2 / 3, (np.exp((value - c) / a) + b) / 12)
        return light.astype(np.float32), 1.2
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return light.astype(np.float32), 1.0


@lru_cache
def _in_8_bits(linear: bool) -> np.ndarray:
    """Return the 8-bit values (65536,) of sRGB's values, or of linear light, in 16 bits."""
    if not linear:
        return np.round(np.arange(65536) / 257).astype(np.uint8)
    x = np.arange(65536) / 65535
    value = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.round(255 * value).astype(np.uint8)
