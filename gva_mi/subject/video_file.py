"""Decide what the pictures of a video file are, and read any of them; write video files.

Every reader of videos asks this module. A video's pictures are those that a player shows:

* of the first stream that is no cover picture, in the order in which they are shown;
* without pictures that an edit list hides, as in a video that a phone has trimmed;
* rotated and mirrored as the metadata say;
* in sRGB.

Opening a file decodes all of it once, which finds any damage, and keeps the time stamps. The
pictures that were decoded last stay in memory in the decoder's format, mostly half as large as RGB.
Other pictures are decoded on demand, from the key frame before them. A checksum verifies that they
are the same as at first; if not, they are decoded from the start.

**Colours** are sRGB of 8 bits, whatever the video was recorded in.

* **Matrix and range** follow the video's tags. Without a tag, a video of at least 720 rows or 1280
  columns is BT.709, a smaller one BT.601, as players take it.
* **HDR** (PQ of SMPTE ST 2084, HLG of BT.2100), as phones record it, becomes light in units of the
  reference white, 203 cd/m² (BT.2408). BT.2020's primaries become those of sRGB. Light x of the
  brightest channel is compressed above a knee k, and the others by the same factor:

  1. ``f(x) = x`` below k,  ``k + (1 − k) (1 − exp(−(x − k) / (1 − k)))`` above.

* **SDR with primaries of BT.2020 or Display P3** changes primaries alone.
"""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gva_mi.core import srgb
from gva_mi.core.atomic import atomic_write
from gva_mi.core.errors import MALFORMED, InputError, reason_of
from gva_mi.core.files import require_file
from gva_mi.subject.pictures import in_8_bits, require_size

if TYPE_CHECKING:
    import av

# Numbers of ITU-T H.273: transfer functions, primaries, and the matrices of a video without a tag.
PQ, HLG, BT2020, P3, UNTAGGED = 16, 18, 9, 12, (0, 2)
HDR = {PQ: "PQ", HLG: "HLG"}
REFERENCE_WHITE = 203.0  # cd/m², BT.2408
HLG_PEAK = 1000.0  # cd/m², of the nominal display of HLG: BT.2100
HIGHLIGHT_KNEE = 0.7  # k of eq. 1. Chosen: most of a picture is darker, and keeps its colours
HD_WIDTH, HD_HEIGHT = 1280, 720  # pixels: an untagged video of this size or more is BT.709
TO_BT709 = {  # primaries of linear light: BT.2087; SMPTE EG 432
    BT2020: np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083],
                      [-0.0182, -0.1006, 1.1187]], np.float32),
    P3: np.array([[1.2249, -0.2249, 0], [-0.0421, 1.0421, 0], [-0.0196, -0.0786, 1.0983]],
                 np.float32),
}  # fmt: skip
BT2020_LUMA = np.array([0.2627, 0.6780, 0.0593], np.float32)  # luminance of linear RGB: BT.2100
_ENCODINGS = {  # codec, pixel format and options
    # x264 writes its settings into the file, the number of threads among them: always use one.
    "lossless": ("libx264rgb", "rgb24", {"crf": "0", "preset": "veryfast", "threads": "1"}),
    # mbtree reads uninitialised memory, which gives other bits in every run.
    "playable": ("libx264", "yuv420p", {"crf": "18", "threads": "1", "mbtree": "0"}),
}
SQUARE_PIXELS = 0.01  # of the logarithm of width over height. Chosen: nobody sees the difference
_SQUEEZED = (
    "the video's pixels are {:.3g} times as wide as high, so that people look squeezed; convert it "
    "first: ffmpeg -i VIDEO -vf scale=iw*sar:ih,setsar=1 SQUARE.mp4"
)
_INTERLACED = (
    "the video is interlaced ({} of {} pictures): every other row is of another moment, so moving "
    "outlines look like combs; convert it first: ffmpeg -i VIDEO -vf bwdif=0 PROGRESSIVE.mp4"
)
_CUT_SHORT = "the file lasts {:.3g} s, but its pictures end at {:.3g} s: was it cut short?"
CUT_SECONDS = 0.5  # missing at the end of a video. Chosen: sound is rarely longer than pictures
KEPT_BYTES = 1 << 27  # of decoded pictures. Chosen: 43 pictures of 1920 x 1080 in 4:2:0


class VideoFile(Sequence[np.ndarray]):
    """The pictures of a video file, each (H, W, 3) 8-bit, as they are shown."""

    def __init__(self, path: Path, kept: int = KEPT_BYTES, end: float | None = None) -> None:
        """Decode the whole video once; ``kept`` bytes of decoded pictures may stay in memory.

        The video may be damaged after ``end`` seconds; then its last pictures are missing.
        """
        self.path = Path(path)
        self.sizes: list[tuple[int, int]] = []  # (W, H) of each picture
        self._moments: list[int | None] = []
        self._keys: list[int] = []  # numbers of the key pictures
        self._checksums: list[int] = []
        self._frames: Iterator[av.VideoFrame] | None = None  # of an open decoder
        self._next, self._sought = (
            0,
            False,
        )  # the decoder's next picture; whether it began in between
        self._near, self._kept = _Near(kept), kept
        stream = open_stream(self.path)
        self.tick = float(stream.time_base or 0)  # seconds
        hdr, interlaced, aspect = None, 0, float(stream.sample_aspect_ratio or 1)
        length = (stream.container.duration or 0) / 1e6  # seconds
        for frame in decoded(stream, end=end):
            if frame.key_frame:
                self._keys.append(len(self))
            self._near.put(len(self), frame)
            hdr, interlaced = HDR.get(frame.color_trc, hdr), interlaced + frame.interlaced_frame
            self.sizes.append(size_of(frame))
            self._moments.append(frame.pts)
            self._checksums.append(_checksum(frame))
        self._numbers = {moment: k for k, moment in enumerate(self._moments) if moment is not None}
        shown = (frame.duration or 0) * self.tick  # seconds, the last picture
        lasts = length if self.times is None else self.times[-1] + shown
        self.notes = [  # sentences for the user
            *([f"the video is HDR ({hdr}): its colours were mapped to sRGB"] if hdr else []),
            *([_SQUEEZED.format(aspect)] if abs(np.log(aspect)) > SQUARE_PIXELS else []),
            *([_INTERLACED.format(interlaced, len(self))] if interlaced else []),
            *([_CUT_SHORT.format(length, lasts)] if lasts < length - CUT_SECONDS else []),
        ]

    @property
    def times(self) -> np.ndarray | None:
        """Seconds at which the pictures are shown, (T,); None if the video does not say."""
        if self.tick == 0 or None in self._moments:
            return None
        return (np.array(self._moments, np.float64) - self._moments[0]) * self.tick

    def __len__(self) -> int:
        return len(self.sizes)

    def __getitem__(self, index: int) -> np.ndarray:
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        index %= len(self)
        if index not in self._near and not any(self._decode_to(index, x) for x in (True, False)):
            raise InputError(
                f"{self.path}: picture {index} was decoded before, but now fails; was the file "
                "changed?"
            )
        return self._near.rgb(index)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the open file; another process opens its own."""
        return self.__dict__ | {"_frames": None, "_near": _Near(self._kept)}

    def _decode_to(self, index: int, seek: bool) -> bool:
        """Decode a picture, from a key picture or from the start; return whether it succeeded.

        After a seek some decoders lack what came before: a palette, or blocks that are refreshed
        one after another. So only pictures with the same checksum as at first are kept.
        """
        key = self._keys[max(0, bisect_right(self._keys, index) - 1)] if self._keys else 0
        if self._frames is None or not seek or not key <= self._next <= index:
            self._open(index, seek and len(self._numbers) == len(self))
        for frame in self._frames:
            number = self._numbers.get(frame.pts, len(self)) if self._sought else self._next
            self._next = number + 1
            if number > index:
                return False
            if not self._sought or _checksum(frame) == self._checksums[number]:
                self._near.put(number, frame)
            if number == index:
                return index in self._near
        return False

    def _open(self, index: int, seek: bool) -> None:
        """Open a decoder at the key picture at or before a picture, or at the start."""
        if self._frames is not None:
            self._frames.close()
        # A decoder's memory is freed with its last picture, so drop all of the old decoder's.
        self._near = _Near(self._kept)
        self._frames = decoded(open_stream(self.path), self._moments[index] if seek else None)
        self._next, self._sought = 0, seek


class _Near:
    """Buffer of the pictures decoded last, in the decoder's format."""

    def __init__(self, room: int) -> None:
        """Make an empty buffer of ``room`` bytes; it keeps the last picture whatever its size."""
        self._room = room
        self._frames: dict[int, Any] = {}  # by number, in their order
        self._converter: Any = None  # one for all: each would keep tables of its own

    def __contains__(self, number: int) -> bool:
        return number in self._frames

    def put(self, number: int, frame: av.VideoFrame) -> None:
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
        return picture_of(self._frames[number], self._converter)


def _bytes_of(frame: av.VideoFrame) -> int:
    return sum(plane.buffer_size for plane in frame.planes)


def _checksum(frame: av.VideoFrame) -> int:
    """Return a checksum of a decoded frame's pixels, and of its palette."""
    found = 0
    for k, plane in enumerate(frame.planes):
        rows = np.frombuffer(plane, np.uint8).reshape(plane.height, -1)  # with padding
        used = sum(-(-part.bits // 8) for part in frame.format.components if part.plane == k)
        shown = rows[:, : plane.width * used] if used else rows  # else a palette
        found = zlib.crc32(np.ascontiguousarray(shown), found)
    return found


def open_stream(path: Path) -> av.VideoStream:
    """Open a video file's first stream of pictures that is no cover picture.

    Raises:
        InputError: the file is no video, or its pictures are too large.
    """
    import av

    path = Path(path)
    require_file(path, "a video file or a folder of pictures")
    with decoding(path):
        videos = av.open(str(path)).streams.video
        cover = av.stream.Disposition.attached_pic
        stream = next((x for x in videos if not x.disposition & cover), None)
        if stream is None:
            raise InputError(f"{path}: holds no picture, only sound; expected a video")
        require_size(str(path), stream.width, stream.height)
        return stream


def decoded(
    stream: av.VideoStream, moment: int | None = None, end: float | None = None
) -> Iterator[av.VideoFrame]:
    """Yield the pictures of a video stream in the order in which they are shown.

    Args:
        stream: of :func:`open_stream`; its file is closed at the end.
        moment: in ticks; the first picture is the key picture at or before it; None: the video's.
        end: seconds; if a later picture is damaged, the video ends before it.
    """
    import av

    path, count, first, last = stream.container.name, 0, None, None
    with stream.container as container, decoding(path):
        if moment is not None:
            container.seek(moment, stream=stream)
        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except av.FFmpegError as error:
                if moment is not None or (None not in (last, end) and last - first >= end):
                    return
                if None in (last, packet.pts):
                    raise
                at, before = float(packet.pts * stream.time_base), 100 * (last - first) // 1 / 100
                remedy = f"; --end {before:g} uses what comes before it" if before else ""
                raise InputError(
                    f"{path}: picture {_count_before(path, packet.pts)}, at {at - first:.2f} s, is "
                    f"damaged ({error.strerror}){remedy}"
                ) from None
            for frame in frames:
                require_size(path, frame.width, frame.height)
                count, last = count + 1, frame.time
                first = last if first is None else first
                yield frame
    if not count and moment is None:
        raise InputError(f"{path}: holds no picture")


def _count_before(path: str, moment: int) -> int:
    """Count the pictures that are shown before a moment, in ticks, without decoding them."""
    stream = open_stream(path)
    with stream.container as container:
        shown = (x.pts for x in container.demux(stream) if not x.is_discard)
        return sum(pts is not None and pts < moment for pts in shown)


@contextmanager
def decoding(path: Path | str) -> Iterator[None]:
    """Convert any decoding error of a video to an InputError of one sentence."""
    import av

    try:
        yield
    except InputError:
        raise
    except (*MALFORMED, av.FFmpegError, OSError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or reason_of(error)
        raise InputError(f"{path}: cannot be decoded as a video ({reason})") from None


def size_of(frame: av.VideoFrame) -> tuple[int, int]:
    """Return the size (W, H) of a frame as it is shown."""
    size = frame.width, frame.height
    return size[::-1] if _display(frame)[0] else size


def _display(frame: av.VideoFrame) -> tuple[bool, bool, bool]:
    """Return whether to swap a frame's axes, then to mirror its columns, and its rows.

    Metadata move a pixel to ``x' = a x + c y``, ``y' = b x + d y``; front cameras mirror.
    """
    stored = frame.side_data.get("DISPLAYMATRIX")
    a, b, _, c, d = np.frombuffer(stored, "=i4")[:5].tolist() if stored else (1, 0, 0, 0, 1)
    if abs(b) + abs(c) > abs(a) + abs(d):
        return True, c < 0, b < 0
    return False, a < 0, d < 0


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


def picture_of(
    frame: av.VideoFrame, converter: av.video.reformatter.VideoReformatter | None = None
) -> np.ndarray:
    """Return a frame as it is shown, sRGB (H, W, 3) 8-bit.

    ``converter`` is reused for similar frames, because each converter keeps tables.
    """
    swapped, columns, rows = _display(frame)
    pixels = _srgb(frame, converter)
    pixels = pixels.swapaxes(0, 1) if swapped else pixels
    pixels = pixels[:: -1 if rows else 1, :: -1 if columns else 1]
    return pixels.copy()  # because it may share the frame's memory


def _srgb(
    frame: av.VideoFrame, converter: av.video.reformatter.VideoReformatter | None
) -> np.ndarray:
    """Return a frame's pixels as they are stored, sRGB (H, W, 3) 8-bit."""
    from av.video.reformatter import Colorspace, VideoReformatter

    usual = TO_BT709[BT2020] if frame.color_trc in HDR else None
    to_bt709 = TO_BT709.get(frame.color_primaries, usual)
    matrix = None
    if frame.colorspace in UNTAGGED and not frame.format.is_rgb:
        shorter, longer = sorted((frame.width, frame.height))
        large = longer >= HD_WIDTH or shorter >= HD_HEIGHT
        matrix = (
            Colorspace.BT2020
            if frame.color_primaries == BT2020
            else Colorspace.ITU709
            if large
            else None
        )
    # Convert more than 8 bits to 16, because the converter to 8 truncates, up to 2 levels too dark.
    deep = any(component.bits > 8 for component in frame.format.components)
    kind = "rgb24" if to_bt709 is None and not deep else "rgb48le"
    found = (converter or VideoReformatter()).reformat(frame, format=kind, src_colorspace=matrix)
    pixels = found.to_ndarray()
    if kind == "rgb24":
        return pixels
    if to_bt709 is None:
        return _in_8_bits(False)[pixels]
    table, gamma = _light_of(frame.color_trc)
    light = table[pixels]
    if gamma != 1:  # HLG: a display's contrast depends on the luminance of the scene
        light *= np.maximum(light @ BT2020_LUMA, 1e-6)[..., None] ** (gamma - 1)
        light *= HLG_PEAK / REFERENCE_WHITE
    light = np.maximum(light @ to_bt709.T, 0)
    if frame.color_trc in HDR:
        k, most = HIGHLIGHT_KNEE, np.maximum(light.max(axis=2), HIGHLIGHT_KNEE)
        light *= ((k + (k - 1) * np.expm1((k - most) / (1 - k))) / most)[..., None]
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
    return srgb.decoded(value).astype(np.float32), 1.0


@lru_cache
def _in_8_bits(linear: bool) -> np.ndarray:
    """Return the 8-bit values (65536,) of sRGB's values, or of linear light, in 16 bits."""
    if not linear:
        return np.round(np.arange(65536) / 257).astype(np.uint8)
    return np.round(255 * srgb.encoded(np.arange(65536) / 65535)).astype(np.uint8)
