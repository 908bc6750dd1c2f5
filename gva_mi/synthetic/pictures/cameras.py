"""Cameras of a synthetic subject: one around the person on white, or a phone in a room.

The phone stands at eye height and looks down, with the whole person in view. One tilt and one focal
length hold for a video. Held by hand, it sways slowly and trembles. Its video has the noise of the
sensor, then H.264 at the bits per pixel of phones:

    noisy = picture + N(0, σ²),    σ = σ₀ (1 - 0.5 picture)

in encoded values: noise of photons, on sRGB's curve, is weaker where it is bright.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.random import Generator

from gva_mi.core.atomic import atomic_write
from gva_mi.splat import Camera, look_at

# On white; chosen: a moderate lens, and room for points that are left out of the measure.
FOCAL_ON_WHITE = 1.45  # focal length over the width of the picture
MARGIN_ON_WHITE = 0.06  # share of the picture kept free around the person
# Ranges of a phone; chosen: how people prop up or hold one.
PHONE_HEIGHTS = (1.2, 1.7)  # m above the floor
PHONE_FOCALS = (1.1, 1.5)  # focal length over the width of the picture
PERSON_SHARES = (0.60, 0.86)  # largest height of the person over the picture's
PHONE_MARGIN = 0.03  # share of the picture that is free around all places of the person
MAX_TILT = np.radians(15)  # most that the phone looks down
# Size of a hand's motion; chosen: a slow sway of some pixels, and a tremor of about one.
HAND_SWAY, HAND_DRIFT, HAND_TREMOR = 0.015, 0.008, 0.0007  # m; rad; rad, at 4 to 9 Hz


def camera_around(
    surface: np.ndarray, size: int, azimuth: float = 0.0, elevation: float = 0.06
) -> Camera:
    """Return a camera that sees all points (..., 3) of a surface, metres.

    Its picture has ``size`` x ``size`` pixels and a principal point off-centre, as in crops. The
    azimuth is around the vertical, 0 in front; both angles are in radians.
    """
    points = surface.reshape(-1, 3)
    # Points may be left out, because the margin has room for them.
    points = points[:: max(1, len(points) // 50_000)].astype(np.float64)
    middle = (points.min(0) + points.max(0)) / 2
    flat = np.cos(elevation)
    away = np.array([np.sin(azimuth) * flat, np.sin(elevation), np.cos(azimuth) * flat])
    centre = np.array([0.515, 0.485]) * size
    free = (0.485 - MARGIN_ON_WHITE) * size
    distance, focal = 2.0, FOCAL_ON_WHITE * size
    for _ in range(30):  # move until it just fits; converges geometrically
        T_camera_world = look_at(middle + distance * away, middle)
        camera = Camera(focal, focal, *centre, T_camera_world, size, size)
        reach = np.abs(camera.project(points) - centre).max() / free
        distance *= max(reach, 0.2)
        if abs(reach - 1) < 1e-4:
            break
    return camera


@dataclass(frozen=True)
class PhoneCamera:
    """The placing of a phone around the middle of a person's path."""

    middle: np.ndarray  # (3,) metres, on the floor
    height: float  # m
    distance: float  # m, along the floor
    tilt: float  # rad, down
    focal: float  # over the width of the picture
    size: int  # pixels, width and height

    def camera(
        self, moved: np.ndarray | float = 0.0, turned: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> Camera:
        """Return the camera, in front of the person.

        ``moved`` (3,), m, and ``turned`` (3,), rad to the right, upwards and clockwise, are those
        of the hand that holds it.
        """
        right, above, away = np.eye(3)
        eye = self.middle + self.distance * away + self.height * above + moved
        ahead = -np.cos(self.tilt) * away - np.sin(self.tilt) * above
        target = eye + ahead + turned[0] * right + turned[1] * above
        focal, half = self.focal * self.size, self.size / 2
        T = look_at(eye, target, above + turned[2] * right)
        return Camera(focal, focal, half, half, T, self.size, self.size)

    @staticmethod
    def draw(rng: Generator, points: np.ndarray, size: int) -> PhoneCamera:
        """Draw a phone that sees all points (T, n, 3) of a person."""
        flat = points.reshape(-1, 3)
        middle = (flat.min(0) + flat.max(0)) / 2 * [1, 0, 1]
        height, focal, tall = (
            float(rng.uniform(*ends)) for ends in (PHONE_HEIGHTS, PHONE_FOCALS, PERSON_SHARES)
        )
        aim = float(rng.uniform(-0.03, 0.03))  # share of the picture, below its middle
        placed = PhoneCamera(middle, height, 3.0, 0.1, focal, size)
        for _ in range(40):  # until the person fits; converges geometrically
            seen = placed.camera().project(points) / size
            rows = seen[..., 1]
            tallest = np.ptp(rows, axis=-1).max() / tall
            widest = 2 * np.abs(seen - 0.5).max() / (1 - 2 * PHONE_MARGIN)
            distance = placed.distance * max(tallest, widest, 0.3) ** 0.8
            tilt = placed.tilt + 0.8 * ((rows.min() + rows.max()) / 2 - 0.5 - aim) / focal
            tilt = float(np.clip(tilt, 0, MAX_TILT))
            placed = PhoneCamera(middle, height, float(distance), tilt, focal, size)
        return placed


def held_by_hand(rng: Generator) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    """Draw how a hand moves (3,), m, and turns (3,), rad, a phone: functions of a moment, s."""

    def wave(size: float, *hertz: float) -> Callable[[float], np.ndarray]:
        reach, rate = rng.normal(0, size / 2, (3, 4)), rng.uniform(*hertz, (3, 4))
        phase = rng.uniform(size=(3, 4))
        return lambda t: (reach * np.sin(2 * np.pi * (rate * t + phase))).sum(1)

    sway, drift = wave(HAND_SWAY, 0.1, 0.6), wave(HAND_DRIFT, 0.1, 0.7)
    tremor = wave(HAND_TREMOR, 4, 9)
    return lambda t: (sway(t), drift(t) + tremor(t))


PHONE_VIDEO = "phone.mp4"  # in a subject's folder
SENSOR_NOISE = (1.0, 3.5)  # grey levels of 255, range of σ₀; chosen: from clean to plainly noisy
BITS_PER_PIXEL = 0.27  # chosen: 17 Mbit/s at 1920 x 1080 and 30 a second
MIN_BIT_RATE = 10_000  # bits a second, the least that the encoder accepts
# Always one thread; mbtree reads uninitialised memory: see gva_mi.subject.pictures.
ENCODER = {"threads": "1", "mbtree": "0", "preset": "veryfast"}


def write_phone_video(
    path: Path, pictures: Iterable[np.ndarray], fps: Fraction, rng: Generator
) -> None:
    """Write pictures (H, W, 3) 8-bit, of even sides, as an .mp4 of H.264 with BT.709 colours."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    strength = rng.uniform(*SENSOR_NOISE)
    with atomic_write(path) as unfinished, av.open(str(unfinished), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.pix_fmt, stream.options = "yuv420p", ENCODER
        context = stream.codec_context
        context.colorspace, context.color_primaries, context.color_trc = 1, 1, 1
        context.color_range = ColorRange.MPEG
        for k, picture in enumerate(pictures):
            if k == 0:
                stream.height, stream.width = picture.shape[:2]
                bits = int(BITS_PER_PIXEL * picture.shape[0] * picture.shape[1] * fps)
                stream.bit_rate = max(bits, MIN_BIT_RATE)
            value = picture.astype(np.float32)
            noise = rng.standard_normal(picture.shape, dtype=np.float32)
            value += strength * (1 - value / 510) * noise
            noisy = np.round(np.clip(value, 0, 255)).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(noisy, "rgb24").reformat(
                format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
            )
            frame.pts = None
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
