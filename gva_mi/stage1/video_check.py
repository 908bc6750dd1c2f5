"""What a video does not show, or shows badly, and how to film it better.

An avatar knows only what its video shows. These findings compare the video with a good one, which
shows one person from all sides, from head to feet, large, sharp, in enough light, with both hands
and with arms away from the body, and whose camera stands still.

How sharp a picture shows the person is the ratio of fine to coarse structure of its luma I, in the
mask M, at scales s that follow the person's height, by blurs G along rows or columns:

    1. q = sqrt( Σ_M (G_s I - G_2s I)² / Σ_M (G_4s I - G_8s I)² )

It depends little on how much texture the clothes have. Motion blur lowers it, in its direction,
against the video's other pictures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.matting.camera import ShrunkPicture, camera_motions, moved_pixels
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.pictures import in_8_bits
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
SHORT_FRAMES, SHORT_SECONDS = 40, 2.0  # videos of fewer are reported
SMALL_PIXELS = 250  # of a person's height, below which it is reported
DARK_LUMA = 0.25  # of the brighter parts of a person, below which it is reported
SURE_CONFIDENCE = 0.5  # of a landmark that the picture shows
HIDDEN_FEET_SHARE = 0.5  # of the frames with a hidden foot, above which it is reported
GAP_SHARE = 0.05  # of the person's height: so much background parts a wrist from the trunk
APART_SHARE = 0.25  # of the frames with such a gap, below which the arms are reported
SAMPLED_PICTURES = 24  # whose light, sharpness and background are measured
FINEST_SHARE = 0.002  # s of eq. 1, of the person's height
BLURRED_RATIO = 0.5  # of q to the sharper quarter's, below which a picture is blurred
MOVED_SHARE = 0.008  # of the picture's width, above which the camera moves
# Weights of red, green and blue: Rec. 709.
LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
ALL_SIDES = "not seen from all sides"  # what a problem is called
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
        *_outlines(video, landmarks, there),
        *_hands(landmarks),
        *_overlay(video),
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


def sides_seen(
    video: Video, body: BodyModel, frames: Sequence[int]
) -> tuple[int, list[str], list[str]]:
    """Return how many of 360 degrees some frames show well, the sides seen, and those never seen.

    By the pelvis's turns toward the camera. A side is one of :data:`_SIDES`.
    """
    centres = np.arange(SECTORS) * 360 / SECTORS
    apart = np.abs(centres[:, None] - seen_from(video, body, frames)) % 360
    nearest = np.minimum(apart, 360 - apart).min(1)
    seen = {n: nearest[angle * SECTORS // 360] <= SEEN_DEGREES for angle, n in _SIDES.items()}
    degrees = round(360 * float((nearest <= WELL_SEEN_DEGREES).mean()))
    return degrees, [n for n in seen if seen[n]], [n for n in seen if not seen[n]]


def _sides(video: Video, body: BodyModel, frames: Sequence[int]) -> Iterator[Problem]:
    """Find the sides of the person that no frame shows."""
    degrees, _, unseen = sides_seen(video, body, frames)
    if degrees >= 360 * SEEN_SHARE:
        return
    sides = f"; never seen: {', '.join(unseen)}" if unseen else ""
    yield doubt(
        ALL_SIDES,
        f"{degrees} of 360 degrees{sides}",
        "the person did not turn round",
        "turn round once, slowly, with the arms away from the body",
    )


def _outlines(video: Video, landmarks: Landmarks, frames: Sequence[int]) -> Iterator[Problem]:
    """Find frames that cut the person off, arms at the body, and persons of few pixels."""
    edges, tall = {"feet or legs": [], "head": [], "sides": []}, []
    arms = {side: _wrist_and_trunk(landmarks, side) for side in ("left", "right")}
    apart, touching = ({side: [] for side in arms} for _ in range(2))
    for outline in video.outlines(frames):
        inside = outline.mask > 0.5
        rows = np.flatnonzero(inside.any(1))
        tall.append(rows[-1] + 1 - rows[0])
        touched = inside[-1].any(), inside[0].any(), inside[:, [0, -1]].any()
        for cut, found in zip(touched, edges.values(), strict=True):
            if cut:
                found.append(outline.index)
        for side, joints in arms.items():
            if np.isfinite(joints[outline.index]).all():
                parted = _parted(joints[outline.index], inside, GAP_SHARE * tall[-1])
                (apart if parted else touching)[side].append(outline.index)
    for part, cut in edges.items():
        if len(cut) > FAULTY_SHARE * len(frames):
            yield doubt(
                f"{part} cut off",
                f"{len(cut)} of {len(frames)} frames",
                "the person reaches the edge of the picture",
                "step back until head, feet and stretched arms are in the picture all the time",
                cut,
            )
    shown = {side: len(apart[side]) + len(touching[side]) for side in arms}
    close = [side for side in arms if len(apart[side]) < APART_SHARE * shown[side]]
    if close:
        yield doubt(
            "arms at the body",
            ", ".join(f"{n}: apart in {len(apart[n])} of {shown[n]} frames" for n in close),
            "the arms hang down, are folded, or are hidden by wide clothes",
            "hold both arms away from the body, by 30 degrees or more, so that the wall is seen "
            "between arm and trunk; where they touch, the avatar confuses sleeve, skin and trunk",
            {k for side in close for k in touching[side]},
        )
    if not edges["feet or legs"]:
        yield from _feet(landmarks, frames)
    if np.median(tall) < SMALL_PIXELS:
        yield doubt(
            "few pixels",
            f"the person is {np.median(tall):.0f} pixels tall",
            "the camera was far away, or its pictures are small",
            f"fill the height of the picture; {SMALL_PIXELS} pixels at least, 600 for a sharp face",
        )


def _wrist_and_trunk(landmarks: Landmarks, side: str) -> np.ndarray:
    """Return a wrist, both shoulders and both hips (T, 5, 2), pixels; NaN if it is not seen."""
    trunk = [f"{one}_{joint}" for joint in ("shoulder", "hip") for one in ("left", "right")]
    names = [f"{side}_wrist", *trunk]
    if not set(names) <= set(landmarks.names):
        return np.full((len(landmarks), len(names), 2), np.nan)
    which = landmarks.indices(names)
    sure = landmarks.confidence[:, which[0]] > SURE_CONFIDENCE
    return np.where(sure[:, None, None], landmarks.pixels[:, which], np.nan)


def _parted(joints: np.ndarray, inside: np.ndarray, least: float) -> bool:
    """Return whether a mask (H, W) bool shows background between a wrist and the trunk's axis.

    ``joints`` (5, 2) are those of :func:`_wrist_and_trunk`; a gap has ``least`` pixels.
    """
    wrist, top, end = joints[0], joints[1:3].mean(0), joints[3:].mean(0)
    axis, limits = end - top, np.array(inside.shape[::-1]) - 1
    along = ((wrist - top) @ axis / (axis @ axis + 1e-9)).clip(0, 1)
    way = top + along * axis - wrist
    places = wrist + np.linspace(0, 1, 2 + int(np.linalg.norm(way)))[:, None] * way
    x, y = places.astype(int).clip(0, limits).T
    person = np.flatnonzero(inside[y, x])
    return len(person) > 0 and np.ptp(person) + 1 - len(person) >= least


def _feet(landmarks: Landmarks, frames: Sequence[int]) -> Iterator[Problem]:
    """Find feet that the network does not see."""
    names = [(f"{side}_heel", f"{side}_foot_index") for side in ("left", "right")]
    if not {n for pair in names for n in pair} <= set(landmarks.names):
        return
    sure = [landmarks.confidence[frames][:, landmarks.indices(n)].mean(1) for n in names]
    hidden = np.asarray(frames)[np.min(sure, axis=0) < SURE_CONFIDENCE]
    if len(hidden) > HIDDEN_FEET_SHARE * len(frames):
        yield doubt(
            "feet hidden",
            f"{len(hidden)} of {len(frames)} frames",
            "furniture, a long garment or writing is before them",
            "clear the floor and show both shoes all the time",
            hidden,
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


def _overlay(video: Video) -> Iterator[Problem]:
    """Find captions and the like over the person."""
    if video.overlay is not None:
        rows, columns = (np.flatnonzero(video.overlay.any(axis)) for axis in (1, 0))
        yield doubt(
            "writing before the person",
            f"{video.overlay.mean():.1%} of the picture, in columns {columns[0]} to {columns[-1]}, "
            f"rows {rows[0]} to {rows[-1]}",
            "a caption or a logo was laid over the video, or furniture stands before the person",
            "use the video without captions, and clear the room; what they hide stays unseen",
        )


def _pictures(video: Video, frames: Sequence[int], progress: Progress | None) -> Iterator[Problem]:
    """Find dark and blurred pictures, and a camera that moves."""
    light, sharp, shrunk = [], [], {}
    for done, frame in enumerate(video.frames(frames), 1):
        luma = frame.image @ LUMA
        light.append(np.quantile(luma[frame.mask > 0.5], 0.9))
        sharp.append(_sharpness(luma, frame.mask > 0.5))
        shrunk[frame.index] = ShrunkPicture.of(in_8_bits(frame.image), in_8_bits(frame.mask))
        if progress:
            progress(done, len(frames))
    if np.median(light) < DARK_LUMA:
        yield doubt(
            "too dark",
            f"the brighter parts of the person have {np.median(light):.0%} of white",
            "too little light, or a bright background",
            "film by daylight or with all lamps on, not against a window",
        )
    relative = (sharp / np.quantile(sharp, 0.75, axis=0)).min(1)
    blurred = np.asarray(frames)[relative < BLURRED_RATIO]
    if len(blurred) > FAULTY_SHARE * len(frames):
        yield doubt(
            "motion blur",
            f"{len(blurred)} of {len(frames)} sampled frames",
            "the person moved fast, the light was weak, or the focus was lost",
            "turn slowly, in more light; tap on the person to hold the focus",
            blurred,
        )
    motions = camera_motions(shrunk.__getitem__, frames).values()
    moved = max(moved_pixels(A, video.size) for A in motions if A is not None)
    lost = sum(A is None for A in motions)
    if lost or moved > MOVED_SHARE * video.size[0]:
        away = f"; {lost} of {len(frames)} sampled frames show another place" if lost else ""
        yield doubt(
            "camera moves",
            f"pictures shift by up to {moved:.0f} pixels{away}",
            "the phone was held in a hand, or pushed",
            "prop the phone up, or use a tripod; it must stand still",
        )


def _people_and_length(video: Video, crowded: Sequence[int], fps: float) -> Iterator[Problem]:
    """Find frames with other people, frames without the person, and videos that are too short."""
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
    if len(video) / fps < SHORT_SECONDS:
        yield doubt(
            "short video",
            f"{len(video)} frames, {len(video) / fps:.1f} s",
            "the video is short, or was cut",
            "film 5 to 15 seconds",
        )
    elif len(video) < SHORT_FRAMES:
        yield doubt(
            "few frames",
            f"{len(video)} in {len(video) / fps:.1f} s",
            "the video has few frames a second, or --fps leaves most of them out",
            "record 24 frames a second or more, and use them all",
        )


def _sharpness(luma: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return q of eq. 1 (2,) along columns and rows of a picture (H, W); ``inside`` is M, bool."""
    from scipy.ndimage import binary_erosion, gaussian_filter1d

    rows, columns = (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
    part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    luma, inside, s = luma[part], inside[part], FINEST_SHARE * len(rows)
    inner = binary_erosion(inside, iterations=max(1, round(8 * s)))
    found = []
    for axis in (0, 1):
        G = {n: gaussian_filter1d(luma, n * s, axis=axis)[inner] for n in (1, 2, 4, 8)}
        fine, coarse = (np.square(G[n] - G[2 * n]).sum() for n in (1, 4))
        found.append(np.sqrt(fine + 1e-9) / np.sqrt(coarse + 1e-9))
    return np.array(found)
