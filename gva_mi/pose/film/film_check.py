"""What a film does not show, or shows badly, and how to film it better.

An avatar knows only what its film shows. These findings (:class:`Problem`) compare the film with
what a good one has: a person seen from all sides, from head to feet, large, sharp and in enough
light, with both hands, alone, before a camera that stands still.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.data.landmarks import Landmarks
from gva_mi.data.problems import Problem, doubt
from gva_mi.data.video import Video
from gva_mi.pose.film.picture_quality import PictureQuality

SECTORS = 36  # directions from which a person may be seen
VISIBLE = 30  # degrees to either side of the camera that a frame shows well
FACING = 60  # degrees, within which a side is seen at all
ENOUGH_SIDES = 0.95  # share of the sectors
RARELY = 0.3  # share of the frames with a hand, below which its fingers are a guess
OFTEN = 0.1  # share of the frames in which something is wrong
FEWEST, SHORTEST = 40, 2.0  # frames, seconds
SMALL = 250  # pixels of a person's height
DARK = 0.25  # luma of the brighter parts of a person
BLURRED = 0.85  # eq. 1 of picture_quality: as by a Gaussian of 1.7 pixels
MOVES = 0.008  # share of the picture's width
_SIDES = {0: "front", 90: "left side", 180: "back", 270: "right side"}  # degrees to the left


def check_film(
    video: Video,
    body: BodyModel,
    landmarks: Landmarks,
    fps: float,
    crowded: Sequence[int] = (),
    progress: Progress | None = None,
) -> list[Problem]:
    """Return what to film better, the most important first.

    Args:
        video: a prepared film.
        body: of its poses.
        landmarks: that the networks found in its frames.
        fps: frames a second.
        crowded: frames with several people.
        progress: called after each picture that is looked at.
    """
    there = [k for k in range(len(video)) if k not in video.absent]
    quality = PictureQuality.of(video, progress)
    return [
        *_sides(video, body, there),
        *_outlines(video, there),
        *_hands(landmarks),
        *_pictures(quality),
        *_people(video, crowded),
        *_length(len(video), fps),
    ]


def seen_from(video: Video, body: BodyModel, frames: Sequence[int]) -> np.ndarray:
    """Return from where the camera sees the pelvis, degrees to the person's left of its front."""
    joints = body.rest(video.shape).joints
    pose = video.pose[list(frames)]
    maps = (
        joint_transforms(pose.rotations, joints, body.parents, pose.transl)[:, 0].double().numpy()
    )
    pelvis = maps[:, :3, :3] @ joints[0].double().numpy() + maps[:, :3, 3]
    eyes = np.stack([video.cameras[k].position for k in frames])
    toward = np.einsum("tji,tj->ti", maps[:, :3, :3], eyes - pelvis)  # in the body's axes
    return np.degrees(np.arctan2(toward[:, 0], toward[:, 2])) % 360


def _sides(video: Video, body: BodyModel, frames: Sequence[int]) -> Iterator[Problem]:
    """Find the sides of the person that no frame shows."""
    centres = np.arange(SECTORS) * 360 / SECTORS
    apart = np.abs(centres[:, None] - seen_from(video, body, frames)) % 360
    nearest = np.minimum(apart, 360 - apart).min(1)
    seen = nearest <= VISIBLE
    if seen.mean() >= ENOUGH_SIDES:
        return
    unseen = [n for angle, n in _SIDES.items() if nearest[angle * SECTORS // 360] > FACING]
    sides = f"; never its {', '.join(unseen)}" if unseen else ""
    yield doubt(
        "not seen from all sides",
        f"{360 * seen.mean():.0f} of 360 degrees{sides}",
        "the person did not turn round",
        "turn round once, slowly, with the arms away from the body",
    )


def _outlines(video: Video, frames: Sequence[int]) -> Iterator[Problem]:
    """Find frames that cut the person off, and persons of few pixels."""
    edges = {"feet or legs": [], "head": [], "sides": []}
    tall = []
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


def _pictures(quality: PictureQuality) -> Iterator[Problem]:
    """Find dark and blurred pictures, and a camera that moves."""
    if (light := float(np.median(quality.light))) < DARK:
        yield doubt(
            "too dark",
            f"the brighter parts of the person have {light:.0%} of white",
            "too little light, or a bright background",
            "film by daylight or with all lamps on, not against a window",
        )
    blurred = [k for k, b in zip(quality.frames, quality.blur, strict=True) if b > BLURRED]
    if len(blurred) > OFTEN * len(quality.frames):
        yield doubt(
            "blurred",
            f"{len(blurred)} of {len(quality.frames)} frames that were looked at",
            "fast motion in little light, or the wrong distance in focus",
            "move slowly, in more light; tap on the person so that the phone keeps its focus",
            blurred,
        )
    if quality.drift > MOVES:
        yield doubt(
            "camera moves",
            f"by up to {quality.drift:.1%} of the picture's width",
            "the phone was held in a hand, or pushed",
            "lean the phone on something, or use a tripod; it must stand still",
        )


def _people(video: Video, crowded: Sequence[int]) -> Iterator[Problem]:
    """Find frames with other people, and frames without the person."""
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
            "stay in the picture; --start and --end cut a film, seconds",
            video.absent,
        )


def _length(frames: int, fps: float) -> Iterator[Problem]:
    """Find films that are short."""
    if frames < FEWEST or frames / fps < SHORTEST:
        yield doubt(
            "short",
            f"{frames} frames, {frames / fps:.1f} s",
            "the film is short, or was cut",
            "film 5 to 15 seconds",
        )
