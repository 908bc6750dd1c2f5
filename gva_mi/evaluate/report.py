"""The pages of a run (its pictures and figures) and of a video's avatar.

Both are made from the run's folder (:mod:`gva_mi.fit.run_folder`) and the subject's. A real video
has no ground truth. So the page of its avatar begins with a verdict in words, and with the avatar
from all around and in two motions that the video does not have. Then it shows how well each part
was seen, and says how to film it better (:mod:`gva_mi.stage1.video_check`). Figures follow. Moving
pictures are also written as .mp4 files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.export import NamedMotion
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import to_matrix
from gva_mi.core.console import Progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json
from gva_mi.core.options import from_json
from gva_mi.core.tasks import on_all_cores
from gva_mi.evaluate.figures import Table, label_of, pivot, table, where
from gva_mi.evaluate.measure import ALIGNED, OF_VIDEO, REGIONS, SPLITS, Metrics
from gva_mi.evaluate.page import Headline, Picture, Section, animation, picture, write_page
from gva_mi.evaluate.pictures import (
    dots,
    picture_sections,
    seen_map,
    shown_views,
    trust_map,
    turntable,
)
from gva_mi.evaluate.refinement import OVERLAYS, joint_errors, load_uncertainty, pose_tables
from gva_mi.fit import run_folder
from gva_mi.fit.renders import WHITE, CameraPath, over, render_shots, shots
from gva_mi.fit.web_page import save_page
from gva_mi.stage1.prepare import Stage1Record
from gva_mi.stage1.video_check import ALL_SIDES, SEEN_SHARE, sides_seen
from gva_mi.subject.pictures import read_image
from gva_mi.subject.problems import Problem
from gva_mi.subject.video import Video, load_video
from gva_mi.subject.video_file import write_video
from gva_mi.synthetic.motion.motions import ROUND_SECONDS, perform

# Chosen: a page of a few megabytes, and motions at a natural speed.
FRAMES_SHOWN = 4  # of a split
TURN_FRAMES = 24  # pictures of the turning avatar

DRAFT = "A draft shows whether the video is good enough; --quality usual makes a better avatar."
FINDINGS = "video_check.json"  # on the video, in the subject's folder
TURNTABLE = "turntable"
DRIVEN_MOTIONS = ("walk", "dance")  # motions of gva_mi.synthetic.motion
THE_VIDEO = "the video"  # the name, on the page of an avatar, of the poses trained with it
WEB_PAGE = "avatar.html"  # beside the report of a video's avatar
VIDEO_FPS = 20  # frames a second of the videos
VIDEO_SIZE = (384, 512)  # pixels, width and height
# Chosen: dB in the person's box, of test frames. Rendered videos reach 25, and drafts of real ones
# 17 to 23: from 24 clothes look as in the video, below 18 limbs are in the wrong place.
GOOD_PSNR, FAIR_PSNR = 24, 18
PAGE_STRIDE = 3  # every 3rd picture of a video is in the page
MOTION_SEED = 0  # chosen: any


def write_report(
    path: Path,
    run: Path,
    avatar: Avatar,
    video: Video,
    title: str,
    body: BodyModel,
    subtitle: str = "A 3D Gaussian avatar of body and hands from a monocular video.",
    first: Sequence[Section] = (),
    last: Sequence[Section] = (),
    verdict: Headline | None = None,
    settings: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write the page.

    Args:
        path: of the page.
        run: the folder of a run that was evaluated.
        avatar: the fitted avatar.
        video: opened with the poses that the avatar was trained under.
        title, subtitle: head of the page.
        body: the fitted body model.
        first: sections that the page begins with; without them, the turning avatar.
        last: sections that it ends with.
        verdict: in words, above all sections.
        settings: what else the page lists at its end.
    """
    metrics = Metrics.load(run)
    views = shown_views(avatar, video, body)
    width, height = metrics.size
    write_page(
        path,
        title=title,
        subtitle=f"{subtitle} {width} x {height} pixels.",
        verdict=verdict,
        sections=[
            *(first or [_turning(avatar, video)]),
            *_trust(avatar, video),
            Section("In short", headlines=headlines(metrics)),
            *picture_sections(avatar, views, FRAMES_SHOWN),
            *_refinement(metrics, video.folder / OVERLAYS),
            *_reinitialisation(run, metrics),
            _scores(metrics),
            *last,
        ],
        settings={
            **settings,
            "options": metrics.options,
            "protocol": metrics.protocol,
            "versions": metrics.versions,
        },
    )


def headlines(metrics: Metrics) -> list[Headline]:
    """Return pose errors first, because they limit all else; then PSNR, size and time."""
    figures, found = metrics.figures, []
    poses = {"region": "body", "alignment": "pelvis-aligned"}
    poses["metric"] = ("stage 1 error, mm", "refined error, mm")
    if errors := [f"{figure.value:.0f}" for figure in where(figures, **poses)]:
        label = "pelvis-aligned error of the body: stage 1, refined"
        found.append(Headline(f"{' → '.join(errors)} mm", label))
    for f in where(figures, metric="PSNR, dB", region=("white", "person"), split=SPLITS[1:]):
        if f.alignment in ("", ALIGNED):
            pixels = "whole picture" if f.region == "white" else "person's box"
            judged = f.region == "person" and f.split in OF_VIDEO
            good = f": {_quality(f.value)} (good: {GOOD_PSNR} dB)" if judged else ""
            name = label_of((f.split, f.alignment, pixels))
            found.append(Headline(f"{f.value:.1f} dB", f"PSNR, {name}{good}"))
    for f in where(figures, metric=("Gaussians", "steps", "seconds")):
        found.append(Headline(f"{f.value:,.0f}", f.metric))
    return found


def _quality(psnr: float) -> str:
    """Return a word for a PSNR in the person's box, dB."""
    return "good" if psnr >= GOOD_PSNR else "fair" if psnr >= FAIR_PSNR else "poor"


def _trust(avatar: Avatar, video: Video) -> Iterator[Section]:
    """Show how uncertain each part is, if the refinement left it in the subject's folder."""
    if (found := load_uncertainty(video.folder)) is not None:
        yield trust_map(avatar, joint_errors(found), video.pose[_frame_from_front(video)])


def _turning(avatar: Avatar, video: Video) -> Section:
    caption = f"{len(avatar.canonical):,} Gaussians, {TURN_FRAMES} views"
    pictures = list(turntable(avatar, video.pose[len(video) // 2], TURN_FRAMES, video.size))
    return Section("The avatar", [animation(caption, pictures)], columns=3)


def _refinement(metrics: Metrics, overlays: Path) -> Iterator[Section]:
    """Show the refinement's picture and errors, if the subject's folder has the picture."""
    if overlays.exists():
        pictures = [picture("stage 1 above, refined below", read_image(overlays, 3))]
        tables = list(pose_tables(metrics.figures))
        yield Section("Pose refinement", pictures, columns=1, tables=tables)


def _reinitialisation(run: Path, metrics: Metrics) -> Iterator[Section]:
    """Show the Gaussians before and after each re-initialisation, and how they lie."""
    pictures = [
        dots(f"step {snapshot.step}, {name}", gaussians)
        for snapshot in run_folder.load_snapshots(run)
        for name, gaussians in (("before", snapshot.before), ("after", snapshot.after))
    ]
    shown = ("opaque Gaussians", "spacing", "bias, mm", "stray, mm")
    surface = pivot(where(metrics.figures, metric=shown), ("split",), ("region",))
    if pictures or surface:
        tables = [table(surface, "step")] if surface else []
        yield Section("Re-initialisation", pictures, columns=2, tables=tables)


def _scores(metrics: Metrics) -> Section:
    """List all scores, a table for each region."""
    tables = []
    for region in REGIONS:
        if own := where(metrics.figures, region=region, split=SPLITS):
            tables.append(table(pivot(own, ("split", "alignment", "region")), "renders"))
    return Section("Figures", tables=tables)


def write_avatar_report(
    out: Path,
    run: Path,
    video: Video,
    body: BodyModel,
    title: str,
    progress: Progress | None = None,
    draft: bool = False,
) -> None:
    """Write ``out/report.html``, and beside it videos and a page that plays the avatar.

    Args:
        out: folder.
        run: the folder of a run that was evaluated.
        video: opened with the poses that the avatar was trained under.
        body: the fitted body model.
        title: heading of the page.
        progress: called after each rendered picture.
        draft: whether the avatar is a preview.
    """
    avatar, record = run_folder.load_avatar(run), Stage1Record.load(video.folder)
    own = NamedMotion(THE_VIDEO, video.pose, record.fps)
    save_page(out / WEB_PAGE, avatar, [*driven_motions(avatar), own], title)
    tall = "the person's height was not given: sizes and distances are uncertain by 5 %"
    if record.height is not None:
        tall = f"the person's height is given as {record.height:.2f} m"
    subtitle = DRAFT if draft else f"From {record.frames} frames of one camera."
    problems, there = _problems(video), [k for k in range(len(video)) if k not in video.absent]
    seen = sides_seen(load_video(video.folder), body, there)  # as the check counted
    figures = where(Metrics.load(run).figures, split="test", region="person", metric="PSNR, dB")
    first = [
        Section(
            "The avatar moves",
            list(_videos(out, avatar, video, progress)),
            columns=3,
            link=(WEB_PAGE, "Turn, zoom and play the avatar"),
        ),
        seen_map(avatar, video, video.pose[_frame_from_front(video)]),
        _findings(problems, record.frames),
    ]
    notes = Table(("notes",), [(note,) for note in (tall, *record.notes)], words=True)
    write_report(
        out / run_folder.REPORT, run, avatar, video, title, body, subtitle, first,
        [Section("Assumptions", tables=[notes])],
        verdict(problems, *seen, next((f.value for f in figures if not f.alignment), None)),
        {"video": vars(record)},
    )  # fmt: skip


def verdict(
    problems: Sequence[Problem],
    degrees: int,
    seen: Sequence[str],
    unseen: Sequence[str],
    psnr: float | None,
) -> Headline:
    """Say in words whether an avatar is good, and why not.

    Args:
        problems: of the video.
        degrees, seen, unseen: what :func:`gva_mi.stage1.video_check.sides_seen` returns.
        psnr: of test frames in the person's box, dB; None: not measured.
    """
    parts = (
        f": {' and '.join(unseen)} are guesses" if unseen else ", and what lies between is a guess"
    )
    around = f"Seen {degrees} of 360 degrees{parts if degrees < 360 * SEEN_SHARE else ''}."
    errors = [f"{p.what} ({p.figure})" for p in problems if p.severity == "error"]
    if psnr is not None and psnr < FAIR_PSNR:
        errors.append(f"the avatar differs much from the video ({psnr:.1f} dB)")
    if errors:
        return Headline(f"Film again, because of this: {errors[0]}", around)
    faults = [p.what for p in problems if p.what != ALL_SIDES]
    because = f" To film better: {', '.join(faults)}." if faults else ""
    if degrees < 360 * SEEN_SHARE:
        sides = "the " + " and ".join(seen) if unseen else "most sides"
        return Headline(f"Usable from {sides}", around + because)
    good = not faults and (psnr is None or psnr >= GOOD_PSNR)
    return Headline("Good" if good else "Usable from all sides", around + because)


def _videos(
    out: Path, avatar: Avatar, video: Video, progress: Progress | None
) -> Iterator[Picture]:
    """Write the videos of the avatar, and yield each as an animation.

    Threads encode one while the next is rendered.
    """
    motions = {TURNTABLE: (video.pose[_frame_from_front(video)], "turntable")}
    motions |= {name: (driven_motion(avatar, name), "static") for name in DRIVEN_MOTIONS}

    def rendered() -> Iterator[tuple[str, list[np.ndarray]]]:
        for name, (motion, path) in motions.items():
            plan, images = shots(CameraPath(path=path, size=VIDEO_SIZE), avatar.rig, motion), []
            for layer in render_shots(avatar, motion, plan):
                images.append(over(layer, np.array(WHITE)))
                if progress:
                    progress(len(images), len(plan))
            yield name, images

    def encoded(of_motion: tuple[str, list[np.ndarray]]) -> Picture:
        name, images = of_motion
        write_video(out / f"{name}.mp4", images, VIDEO_FPS, way="playable")
        return animation(name, images[::PAGE_STRIDE])

    yield from on_all_cores(encoded, rendered())


def driven_motions(avatar: Avatar) -> list[NamedMotion]:
    """Return all :data:`DRIVEN_MOTIONS` for the page of an avatar."""
    return [NamedMotion(name, driven_motion(avatar, name), VIDEO_FPS) for name in DRIVEN_MOTIONS]


def driven_motion(avatar: Avatar, name: str) -> Pose:
    """Return one round of one of :data:`DRIVEN_MOTIONS`, as if the camera followed the person."""
    joints = avatar.rig.joints.double().numpy()
    expressions = avatar.rig.expression_joints.shape[2]
    t = np.arange(round(VIDEO_FPS * ROUND_SECONDS)) / (VIDEO_FPS * ROUND_SECONDS)
    pose = perform(name, t, joints, expressions, np.random.default_rng(MOTION_SEED))
    pose = pose.map(lambda x: torch.as_tensor(x, dtype=torch.float32))
    return replace(pose, transl=pose.transl * torch.tensor([0.0, 1.0, 0.0]))


def _frame_from_front(video: Video) -> int:
    """Return the frame in which the person faces the camera most."""
    there = [k for k in range(len(video)) if k not in video.absent]
    ahead = to_matrix(video.pose.rotations[there, 0])[:, :, 2].double().numpy()
    axes = np.stack([video.cameras[k].T_camera_world[2, :3] for k in there])
    return there[int(np.argmin((ahead * axes).sum(1)))]


def _problems(video: Video) -> list[Problem]:
    """Read what the check found wrong with the video."""
    path, expected = video.folder / FINDINGS, "the findings on a video"
    found = read_json(path, expected)
    with expecting(path, expected):
        return [from_json(Problem, one) for one in found["findings"]]


def _findings(problems: Sequence[Problem], frames: int) -> Section:
    """List what is wrong with a video, and what to do about it."""
    if not problems:
        return Section("Nothing to film better")
    rows = [(f"{p.what}{p.place(frames)}: {p.figure}", p.cause, p.remedy) for p in problems]
    head = "what", "likely cause", "what to do"
    return Section("How to film better", tables=[Table(head, rows, words=True)])
