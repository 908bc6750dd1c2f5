"""The report of a film's avatar: the page of a run, which begins with films and findings.

There is no ground truth of a real film. So the page shows the avatar from all around and in two
motions that the film does not have, and how to film it better (:mod:`gva_mi.pose.film.film_check`).
The moving pictures are also written as .mp4 files.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

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
from gva_mi.data.film import write_film
from gva_mi.data.problems import Problem
from gva_mi.data.video import Video
from gva_mi.fit import run_folder
from gva_mi.fit.renders import WHITE, CameraPath, over, render_shots, shots
from gva_mi.pose.film.prepare_film import FilmRecord
from gva_mi.study.page import Picture, Section, Table, animation
from gva_mi.study.report import write_report
from gva_mi.synthetic.motion import perform

FINDINGS = "film_check.json"  # on the film, in the subject's folder
TURNTABLE = "turntable"
DRIVEN = ("walk", "dance")  # motions of gva_mi.synthetic.motion
FPS = 20  # frames a second of the films
SECONDS = 6.0  # of a motion's round
SIZE = (384, 512)  # pixels
IN_PAGE = 3  # every 3rd picture of a film is in the page
SEED = 0  # of the motions

_MOVES = (
    "From all around in a pose of the film, and in two motions that the film does not have: "
    f"{TURNTABLE}.mp4, {', '.join(f'{name}.mp4' for name in DRIVEN)}. What no frame shows is a "
    "guess."
)
_BETTER = "What the film does not show, and how to film it better."
_GOOD = "The film shows the person from all sides, whole, sharp and alone, before a still camera."


def write_film_report(
    out: Path,
    run: Path,
    video: Video,
    body: BodyModel,
    title: str,
    progress: Progress | None = None,
) -> None:
    """Write the page ``out/report.html``, and films of the avatar beside it.

    Args:
        out: folder.
        run: the folder of a run that was evaluated.
        video: opened with the poses that the avatar was trained under.
        body: the fitted body model.
        title: heading of the page.
        progress: called after each rendered picture.
    """
    avatar, record = run_folder.load_avatar(run), FilmRecord.load(video.folder)
    films = list(_films(out, avatar, video, progress))
    better = _better(_problems(video.folder / FINDINGS), record.notes)
    first = [Section("The avatar", _MOVES, films, columns=3), better]
    subtitle = f"{record.frames} frames at {record.fps:.3g} a second. {_height(record)}"
    where = out / run_folder.REPORT, run
    write_report(*where, avatar, video, title, body, subtitle, first, {"film": vars(record)})


def _height(record: FilmRecord) -> str:
    """Say what is known of the person's size."""
    if record.height is not None:
        return f"The person is {record.height:.2f} m tall."
    return (
        "The person's height was not given, and an average one is assumed: size and distances are "
        "uncertain by 5 %. --height 1.75 gives it."
    )


def _films(out: Path, avatar: Avatar, video: Video, progress: Progress | None) -> Iterator[Picture]:
    """Write the films of the avatar, and yield each as an animation."""
    front = _frame_from_front(avatar, video)
    motions = {TURNTABLE: (video.pose[front], "turntable")}
    motions |= {name: (driven_motion(avatar, name), "static") for name in DRIVEN}
    plans = {
        name: (motion, shots(CameraPath(path=path, size=SIZE), avatar.rig, motion))
        for name, (motion, path) in motions.items()
    }
    done, total = 0, sum(len(plan) for _, plan in plans.values())
    for name, (motion, plan) in plans.items():
        images = []
        for layer in render_shots(avatar, motion, plan):
            images.append(over(layer, np.array(WHITE)))
            done += 1
            if progress:
                progress(done, total)
        write_film(out / f"{name}.mp4", images, FPS, way="playable")
        yield animation(name, images[::IN_PAGE])


def driven_motion(avatar: Avatar, name: str) -> Pose:
    """Return one round of a motion of :data:`DRIVEN` for an avatar, as if the camera went along."""
    joints = avatar.rig.joints.double().numpy()
    expressions = avatar.rig.expression_joints.shape[2]
    t = np.arange(round(FPS * SECONDS)) / (FPS * SECONDS)
    pose = perform(name, t, joints, expressions, np.random.default_rng(SEED))
    pose = pose.map(lambda x: torch.as_tensor(x, dtype=torch.float32))
    return replace(pose, transl=pose.transl * torch.tensor([0.0, 1.0, 0.0]))


def _frame_from_front(avatar: Avatar, video: Video) -> int:
    """Return the frame in which the person faces the camera most."""
    there = [k for k in range(len(video)) if k not in video.absent]
    ahead = to_matrix(video.pose.rotations[there, 0])[:, :, 2].double().numpy()
    axes = np.stack([video.cameras[k].T_camera_world[2, :3] for k in there])
    return there[int(np.argmin((ahead * axes).sum(1)))]


def _problems(path: Path) -> list[Problem]:
    """Read the findings of ``gva-mi avatar``'s check."""
    expected = "the findings on a film"
    record = read_json(path, expected)
    with expecting(path, expected):
        return [from_json(Problem, one) for one in record["findings"]]


def _better(problems: Sequence[Problem], notes: Sequence[str]) -> Section:
    """List what went wrong with the film, and what to do about it."""
    tables = []
    if problems:
        rows = [(p.what, p.figure, p.cause, p.remedy) for p in problems]
        tables.append(Table(("what", "measured", "likely cause", "what to do"), rows, words=True))
    if notes:
        tables.append(Table(("notes",), [(note,) for note in notes], words=True))
    return Section("What to film better", _BETTER if problems else _GOOD, tables=tables)
