"""What a video does not show, or shows badly, and how to film it better.

An avatar knows only what its video shows. These findings compare the video with what a good one
has: a person seen from all sides, from head to feet, large and in enough light, with both
hands, alone, before a camera that stands still.

The camera's motion from the first picture to another is the shift that makes their backgrounds most
alike, by phase correlation of the luma ``I`` and ``I'`` without the person:

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

SECTORS = 36  # directions from which a person may be seen
VISIBLE = 30  # degrees to either side of the camera that a frame shows well
FACING = 60  # degrees, within which a side is seen at all
ENOUGH_SIDES = 0.95  # share of the sectors
RARELY = 0.3  # share of the frames with a hand, below which its fingers are a guess
OFTEN = 0.1  # share of the frames in which something is wrong
FEWEST, SHORTEST = 40, 2.0  # frames, seconds
SMALL = 250  # pixels of a person's height
DARK = 0.25  # luma of the brighter parts of a person
SHOWN = 24  # pictures whose light and background are measured
WIDE = 240  # pixels, width at which the camera's motion is measured
MOVES = 0.008  # share of the picture's width
ALIKE = 0.1  # least peak of eq. 1, which is 1 for equal pictures; of noise it is 0.03
LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
_SIDES = {0: "front", 90: "left side", 180: "back", 270: "right side"}  # degrees to the left


def check_recording(
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
        progress: called after each picture that is looked at.
    """
    there = [k for k in range(len(video)) if k not in video.absent]
    return [
        *_sides(video, body, there),
        *_outlines(video, there),
        *_hands(landmarks),
        *_pictures(video, spread(there, SHOWN), progress),
        *_people_and_length(video, crowded, fps),
    ]


def seen_from(video: Video, body: BodyModel, frames: Sequence[int]) -> np.ndarray:
    """Return from where the camera sees the pelvis, degrees to the person's left of its front."""
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
    seen = (nearest <= VISIBLE).mean()
    if seen >= ENOUGH_SIDES:
        return
    unseen = [n for angle, n in _SIDES.items() if nearest[angle * SECTORS // 360] > FACING]
    sides = f"; never its {', '.join(unseen)}" if unseen else ""
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
        if len(cut) > OFTEN * len(frames):
            yield doubt(
                f"{part} cut off",
                f"{len(cut)} of {len(frames)} frames",
                "the person reaches the edge of the picture",
                "step back until head, feet and stretched arms are in the picture all the time",
                cut,
            )
    if np.median(tall) < SMALL:
        yield doubt(
            "few pixels",
            f"the person is {np.median(tall):.0f} pixels tall",
            "the camera was far away, or its pictures are small",
            f"fill the height of the picture; {SMALL} pixels at least, 600 for a sharp face",
        )


def _hands(landmarks: Landmarks) -> Iterator[Problem]:
    """Find hands that the network rarely recognised."""
    for side in ("left", "right"):
        (wrist,) = landmarks.indices([f"{side}_hand_wrist"])
        share = float(np.isfinite(landmarks.pixels[:, wrist, 0]).mean())
        if share < RARELY:
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
    if np.median(light) < DARK:
        yield doubt(
            "too dark",
            f"the brighter parts of the person have {np.median(light):.0%} of white",
            "too little light, or a bright background",
            "film by daylight or with all lamps on, not against a window",
        )
    moved = max((_shift(backgrounds[0], other) for other in backgrounds[1:]), default=0.0)
    if moved > MOVES:
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
    if len(video.absent) > OFTEN * len(video):
        yield doubt(
            "person not found",
            f"{len(video.absent)} of {len(video)} frames",
            "the person left the picture, or crouched or lay in a way the network does not know",
            "stay in the picture; ffmpeg -ss 3 -to 9 -i VIDEO PART cuts a video, seconds",
            video.absent,
        )
    if len(video) < FEWEST or len(video) / fps < SHORTEST:
        yield doubt(
            "short",
            f"{len(video)} frames, {len(video) / fps:.1f} s",
            "the video is short, or was cut",
            "film 5 to 15 seconds",
        )


def _background(luma: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the fine structure of a background (h, w), about :data:`WIDE` pixels wide.

    Slopes of brightness, as on a wall, are left out, and so is what is near the person.
    """
    from scipy.ndimage import gaussian_filter

    times = max(1, luma.shape[1] // WIDE)
    luma, near = _shrunk(luma, times), gaussian_filter(_shrunk(mask, times), 4.0) > 0.01
    return np.where(near, 0, luma - gaussian_filter(luma, 2.0))


def _shift(one: np.ndarray, other: np.ndarray) -> float:
    """Return the length of eq. 1, a share of the picture's width; 0 for unlike backgrounds."""
    product = np.fft.rfft2(one).conj() * np.fft.rfft2(other)
    alike = np.fft.irfft2(product / np.maximum(np.abs(product), 1e-9), one.shape)
    if alike.max() < ALIKE:
        return 0.0
    at = np.unravel_index(alike.argmax(), alike.shape)
    way = [min(k, size - k) for k, size in zip(at, alike.shape, strict=True)]
    return float(np.hypot(*way)) / one.shape[1]


def _shrunk(image: np.ndarray, times: int) -> np.ndarray:
    """Return means (h, w) of blocks of pixels; an incomplete block at the edge is left out."""
    height, width = (size // times for size in image.shape)
    blocks = image[: height * times, : width * times].reshape(height, times, width, times)
    return blocks.mean((1, 3))
