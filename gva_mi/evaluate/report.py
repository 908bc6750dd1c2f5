"""The pages of a run (its pictures and figures) and of a video's avatar.

Both are made from the run's folder (:mod:`gva_mi.fit.run_folder`) and the subject's. A real video
has no ground truth. So the page of its avatar begins with the avatar from all around
and in two motions that the video does not have, and says how to film it better
(:mod:`gva_mi.stage1.video_check`). The moving pictures are also written as .mp4 files.
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
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import to_matrix
from gva_mi.core.console import Progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json
from gva_mi.core.options import from_json
from gva_mi.evaluate.figures import Table, label_of, pivot, table, where
from gva_mi.evaluate.measure import ALIGNED, REGIONS, SPLITS, Metrics
from gva_mi.evaluate.page import Headline, Picture, Section, animation, picture, write_page
from gva_mi.evaluate.pictures import dots, picture_sections, shown_views, turntable
from gva_mi.evaluate.refinement import OVERLAYS, pose_tables
from gva_mi.fit import run_folder
from gva_mi.fit.renders import WHITE, CameraPath, over, render_shots, shots
from gva_mi.stage1.prepare import Stage1Record
from gva_mi.subject.pictures import read_image
from gva_mi.subject.problems import Problem
from gva_mi.subject.video import Video
from gva_mi.subject.video_file import write_video
from gva_mi.synthetic.motion.motions import ROUND_SECONDS, perform

# Chosen: a page of a few megabytes, and motions at a natural speed.
FRAMES_SHOWN = 4  # of a split
TURN_FRAMES = 24  # pictures of the turning avatar

FINDINGS = "video_check.json"  # on the video, in the subject's folder
TURNTABLE = "turntable"
DRIVEN_MOTIONS = ("walk", "dance")  # motions of gva_mi.synthetic.motion
VIDEO_FPS = 20  # frames a second of the videos
VIDEO_SIZE = (384, 512)  # pixels, width and height
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
        settings: what else the page lists at its end.
    """
    metrics = Metrics.load(run)
    views = shown_views(avatar, video, body)
    width, height = metrics.size
    write_page(
        path,
        title=title,
        subtitle=f"{subtitle} {width} x {height} pixels, seed {metrics.options['seed']}.",
        headlines=headlines(metrics),
        sections=[
            *(first or [_turning(avatar, video)]),
            *picture_sections(avatar, views, FRAMES_SHOWN),
            *_refinement(metrics, video.folder / OVERLAYS),
            *_reinitialisation(run, metrics),
            _scores(metrics),
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
            name = label_of((f.split, f.alignment, pixels))
            found.append(Headline(f"{f.value:.1f} dB", f"PSNR, {name}"))
    for f in where(figures, metric=("Gaussians", "steps", "seconds")):
        found.append(Headline(f"{f.value:,.0f}", f.metric))
    return found


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
) -> None:
    """Write the page ``out/report.html``, and videos of the avatar beside it.

    Args:
        out: folder.
        run: the folder of a run that was evaluated.
        video: opened with the poses that the avatar was trained under.
        body: the fitted body model.
        title: heading of the page.
        progress: called after each rendered picture.
    """
    avatar, record = run_folder.load_avatar(run), Stage1Record.load(video.folder)
    moving = Section("The avatar moves", list(_videos(out, avatar, video, progress)), columns=3)
    tall = "height was not given: sizes and distances are uncertain by 5 %."
    if record.height is not None:
        tall = f"height is given as {record.height:.2f} m."
    subtitle = f"{record.frames} frames at {record.fps:.3g} a second. The person's {tall}"
    first, settings = [moving, _findings(video, record)], {"video": vars(record)}
    page = out / run_folder.REPORT
    write_report(page, run, avatar, video, title, body, subtitle, first, settings)


def _videos(
    out: Path, avatar: Avatar, video: Video, progress: Progress | None
) -> Iterator[Picture]:
    """Write the videos of the avatar, and yield each as an animation."""
    motions = {TURNTABLE: (video.pose[_frame_from_front(video)], "turntable")}
    motions |= {name: (driven_motion(avatar, name), "static") for name in DRIVEN_MOTIONS}
    for name, (motion, path) in motions.items():
        plan, images = shots(CameraPath(path=path, size=VIDEO_SIZE), avatar.rig, motion), []
        for layer in render_shots(avatar, motion, plan):
            images.append(over(layer, np.array(WHITE)))
            if progress:
                progress(len(images), len(plan))
        write_video(out / f"{name}.mp4", images, VIDEO_FPS, way="playable")
        yield animation(name, images[::PAGE_STRIDE])


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


def _findings(video: Video, record: Stage1Record) -> Section:
    """List what went wrong with the video, and what to do about it."""
    path, expected = video.folder / FINDINGS, "the findings on a video"
    found, tables = read_json(path, expected), []
    with expecting(path, expected):
        problems = [from_json(Problem, one) for one in found["findings"]]
    if problems:
        rows = [(p.what, p.figure, p.cause, p.remedy) for p in problems]
        tables.append(Table(("what", "measured", "likely cause", "what to do"), rows, words=True))
    if record.notes:
        tables.append(Table(("notes",), [(note,) for note in record.notes], words=True))
    return Section("What to film better" if problems else "A good video", tables=tables)
