"""What a video does not show, or shows badly, and how to film it better.

An avatar knows only what its video shows. These findings compare the video with a good one, which
shows one person from all sides, from head to feet, large, in enough light and with both hands, and
whose camera stands still.

The camera's motion from the first picture to another is the shift that aligns their backgrounds
best, by phase correlation of the luma ``I`` and ``I'`` without the person:

    1. s = argmax of  F⁻¹( F(I)* F(I') / |F(I)* F(I')| )
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.problems import Problem, doubt
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Video

# All limits are chosen by eye.
SECTORS = 36  # directions around the person
WELL_SEEN_DEGREES = 30  # to either side of the camera, which a frame shows well
SEEN_DEGREES = 60  # to either side of the camera, which a frame shows at all
SEEN_SHARE = 0.95  # of the sectors that a good video shows
RARE_HAND_SHARE = 0.3  # of the frames with a hand, below which its fingers are a guess
FAULTY_SHARE = 0.1  # of the frames with a fault, above which the fault is reported
SHORT_FRAMES, SHORT_SECONDS = 40, 2.0  # shorter videos are reported
SMALL_PIXELS = 250  # of a person's height, below which it is reported
DARK_LUMA = 0.25  # of the brighter parts of a person, below which it is reported
SAMPLED_PICTURES = 24  # whose light and background are measured
MOTION_WIDTH = 240  # pixels, width at which the camera's motion is measured
MOVED_SHARE = 0.008  # of the picture's width, above which the camera moves
SMALLEST_PEAK = 0.1  # of eq. 1 for the same background; equal pictures give 1, noise 0.03
# Weights of red, green and blue: Rec. 709.
LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
_SIDES = {0: "front", 90: "left side", 180: "back", 270: "right side"}  # degrees to the left


def check_video(
    video: Video,
    body: BodyModel,
    landmarks: Landmarks,
    fps: float,
    crowded: Sequence[int] = (),
    progress: Progress | None = None,
) -> list[Problem]:
    """Return what to film better, the most important first.

    Args:
        video: a prepared video.
        body: of its poses.
        landmarks: that the networks found in its frames.
        fps: frames a second.
        crowded: frames with several people.
        progress: called after each sampled picture.
    """
    there = [k for k in range(len(video)) if k not in video.absent]
    return [
        *_sides(video, body, there),
        *_outlines(video, there),
        *_hands(landmarks),
        *_pictures(video, spread(there, SAMPLED_PICTURES), progress),
        *_people_and_length(video, crowded, fps),
    ]


def seen_from(video: Video, body: BodyModel, frames: Sequence[int]) -> np.ndarray:
    """Return the direction of the camera (n,), degrees from the person's front to their left."""
    joints = body.rest(video.shape).joints
    pose = video.pose[list(frames)]
    maps = joint_transforms(pose.rotations, joints, body.parents, pose.transl)[:, 0]
    R, t = maps[:, :3, :3].double().numpy(), maps[:, :3, 3].double().numpy()
    pelvis = R @ joints[0].double().numpy() + t
    eyes = np.stack([video.cameras[k].position for k in frames])
    toward = np.einsum("tji,tj->ti", R, eyes - pelvis)  # in the body's axes
    return np.degrees(np.arctan2(toward[:, 0], toward[:, 2])) % 360


def _sides(video: Video, body: BodyModel, frames: Sequence[int]) -> Iterator[Problem]:
    """Find the sides of the person that no frame shows."""
    centres = np.arange(SECTORS) * 360 / SECTORS
    apart = np.abs(centres[:, None] - seen_from(video, body, frames)) % 360
    nearest = np.minimum(apart, 360 - apart).min(1)
    seen = (nearest <= WELL_SEEN_DEGREES).mean()
    if seen >= SEEN_SHARE:
        return
    unseen = [n for angle, n in _SIDES.items() if nearest[angle * SECTORS // 360] > SEEN_DEGREES]
    sides = f"; never seen: {', '.join(unseen)}" if unseen else ""
    yield doubt(
        "not seen from all sides",
        f"{360 * seen:.0f} of 360 degrees{sides}",
        "the person did not turn round",
        "turn round once, slowly, with the arms away from the body",
    )


def _outlines(video: Video, frames: Sequence[int]) -> Iterator[Problem]:
    """Find frames that cut the person off, and persons of few pixels."""
    edges, tall = {"feet or legs": [], "head": [], "sides": []}, []
    for outline in video.outlines(frames):
        inside = outline.mask > 0.5
        rows = np.flatnonzero(inside.any(1))
        tall.append(rows[-1] + 1 - rows[0])
        touched = inside[-1].any(), inside[0].any(), inside[:, [0, -1]].any()
        for cut, found in zip(touched, edges.values(), strict=True):
            if cut:
                found.append(outline.index)
    for part, cut in edges.items():
        if len(cut) > FAULTY_SHARE * len(frames):
            yield doubt(
                f"{part} cut off",
                f"{len(cut)} of {len(frames)} frames",
                "the person reaches the edge of the picture",
                "step back until head, feet and stretched arms are in the picture all the time",
                cut,
            )
    if np.median(tall) < SMALL_PIXELS:
        yield doubt(
            "few pixels",
            f"the person is {np.median(tall):.0f} pixels tall",
            "the camera was far away, or its pictures are small",
            f"fill the height of the picture; {SMALL_PIXELS} pixels at least, 600 for a sharp face",
        )


def _hands(landmarks: Landmarks) -> Iterator[Problem]:
    """Find hands that the network rarely recognised."""
    for side in ("left", "right"):
        (wrist,) = landmarks.indices([f"{side}_hand_wrist"])
        share = float(np.isfinite(landmarks.pixels[:, wrist, 0]).mean())
        if share < RARE_HAND_SHARE:
            seldom = "never seen" if share == 0 else "rarely seen"
            yield doubt(
                f"{side} hand {seldom}",
                f"{share:.0%} of the frames",
                "it was hidden, a fist, blurred or too small",
                "show both hands to the camera from all sides, with fingers apart",
            )


def _pictures(video: Video, frames: Sequence[int], progress: Progress | None) -> Iterator[Problem]:
    """Find dark pictures, and a camera that moves."""
    light, backgrounds = [], []
    for done, frame in enumerate(video.frames(frames), 1):
        luma = frame.image @ LUMA
        light.append(np.quantile(luma[frame.mask > 0.5], 0.9))
        backgrounds.append(_background(luma, frame.mask))
        if progress:
            progress(done, len(frames))
    if np.median(light) < DARK_LUMA:
        yield doubt(
            "too dark",
            f"the brighter parts of the person have {np.median(light):.0%} of white",
            "too little light, or a bright background",
            "film by daylight or with all lamps on, not against a window",
        )
    moved = max((_shift(backgrounds[0], other) for other in backgrounds[1:]), default=0.0)
    if moved > MOVED_SHARE:
        yield doubt(
            "camera moves",
            f"by up to {moved:.1%} of the picture's width",
            "the phone was held in a hand, or pushed",
            "prop the phone up, or use a tripod; it must stand still",
        )


def _people_and_length(video: Video, crowded: Sequence[int], fps: float) -> Iterator[Problem]:
    """Find frames with other people, frames without the person, and short videos."""
    if len(crowded):
        yield doubt(
            "several people",
            f"{len(crowded)} of {len(video)} frames",
            "somebody else is in the picture, also in a mirror, a poster or on a screen",
            "film one person alone; --person chooses another one, counted from the left",
            crowded,
        )
    if len(video.absent) > FAULTY_SHARE * len(video):
        yield doubt(
            "person not found",
            f"{len(video.absent)} of {len(video)} frames",
            "the person left the picture, or crouched or lay in a way the network does not know",
            "stay in the picture; ffmpeg -ss 3 -to 9 -i VIDEO PART cuts a video, seconds",
            video.absent,
        )
    if len(video) < SHORT_FRAMES or len(video) / fps < SHORT_SECONDS:
        yield doubt(
            "short",
            f"{len(video)} frames, {len(video) / fps:.1f} s",
            "the video is short, or was cut",
            "film 5 to 15 seconds",
        )


def _background(luma: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the fine structure of a background (h, w), about :data:`MOTION_WIDTH` pixels wide.

    Slopes of brightness, as on a wall, are left out, and so is what is near the person.
    """
    from scipy.ndimage import gaussian_filter

    times = max(1, luma.shape[1] // MOTION_WIDTH)
    luma, near = _shrunk(luma, times), gaussian_filter(_shrunk(mask, times), 4.0) > 0.01
    return np.where(near, 0, luma - gaussian_filter(luma, 2.0))


def _shift(one: np.ndarray, other: np.ndarray) -> float:
    """Return the length of eq. 1, a share of the picture's width; 0 for unlike backgrounds."""
    product = np.fft.rfft2(one).conj() * np.fft.rfft2(other)
    alike = np.fft.irfft2(product / np.maximum(np.abs(product), 1e-9), one.shape)
    if alike.max() < SMALLEST_PEAK:
        return 0.0
    at = np.unravel_index(alike.argmax(), alike.shape)
    way = [min(k, size - k) for k, size in zip(at, alike.shape, strict=True)]
    return float(np.hypot(*way)) / one.shape[1]


def _shrunk(image: np.ndarray, times: int) -> np.ndarray:
    """Return means (h, w) of blocks of pixels; an incomplete block at the edge is left out."""
    height, width = (size // times for size in image.shape)
    blocks = image[: height * times, : width * times].reshape(height, times, width, times)
    return blocks.mean((1, 3))
