"""The command ``gva-mi view``: show an avatar in the browser."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import torch
from tyro.conf import Positional

from gva_mi.app.driving import motion_of
from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.rig import digest
from gva_mi.body.body_file import EXPRESSIONS
from gva_mi.body.pose import JOINTS, Pose, is_pose_file
from gva_mi.body.smplx import load_body
from gva_mi.core.console import say
from gva_mi.core.cpu import one_torch_thread
from gva_mi.core.errors import InputError
from gva_mi.core.options import Within
from gva_mi.fit.run_folder import TRAINED_POSES, body_of_run, load_avatar, other_pictures
from gva_mi.subject.video import Video, load_video
from gva_mi.viewer.panel import FPS, Panel
from gva_mi.viewer.server import Shapes, address, pages, serving, when_moved
from gva_mi.viewer.session import Session
from gva_mi.viewer.state import start


def view(
    run: Positional[Path],
    *,
    poses: Path | None = None,
    subject: Path | None = None,
    body: Path | None = None,
    host: str = "127.0.0.1",
    port: Annotated[int, Within(0, 65535)] = 8080,
) -> None:
    """Turn, pose and play an avatar in the browser, until Ctrl-C.

    Args:
        run: the folder of a finished fit, or an avatar.npz.
        poses: poses under SMPL-X's names, each (T, ...), or any motion that gva-mi motion reads;
            without it, the poses trained with the avatar.
        subject: the folder of the video that these poses belong to; it is shown beside the avatar.
        body: the body file of an avatar without its body; without it, the run's, else the built-in.
        host: address to listen on: 127.0.0.1 for this machine alone, 0.0.0.0 for the whole network.
        port: port of the page; 0 picks a free one.
    """
    body = body_of_run(run, body)
    avatar = load_avatar(run, body)
    motion, _ = motion_of(run, avatar, poses, FPS, body)
    video = None if subject is None else _video_of(run, subject, poses)
    begin, changed = start(avatar.rig, motion), threading.Event()
    title = f"{run.name}: {len(avatar.canonical):,} Gaussians"
    with serving(host, port, begin, title) as server, suppress(KeyboardInterrupt):
        when_moved(server, changed.set)
        joints, expressions = _turning_joints(avatar), _expressions(avatar)
        panel = Panel(server.gui, len(motion), joints, expressions, video is not None, changed.set)
        session = Session(avatar, motion, panel, Shapes(server.scene, avatar.rig), video)
        say(f"{address(server)}: open it in a browser; Ctrl-C ends it")
        sys.stdout.flush()  # a program may read the address from a pipe
        with one_torch_thread():
            while True:
                changed.clear()
                changed.wait(session.step(pages(server), time.monotonic()))


def _video_of(run: Path, subject: Path, poses: Path | None) -> Video:
    """Return the video whose poses are shown; without ``--poses`` it must be the run's own."""
    if poses is not None and not is_pose_file(poses):
        raise InputError(
            f"{poses}: a motion of another program does not belong to a video; expected poses of "
            f"{subject}, or no --subject"
        )
    run = run if run.is_dir() else run.parent
    video = load_video(subject, poses or run / TRAINED_POSES, "none")
    if poses is None and (others := other_pictures(run, video)):
        raise InputError(
            f"{run}: was fitted to another video than {subject}, whose {others} differ; give the "
            "subject that it was fitted to, or --poses of this one"
        )
    return video


def _expressions(avatar: Avatar) -> Sequence[str]:
    """Return what each coefficient of the avatar's expression does, or its number."""
    count = avatar.rig.expression_joints.shape[2]
    of_built_in = count == len(EXPRESSIONS) and avatar.rig.body == digest(load_body())
    return EXPRESSIONS if of_built_in else [f"expression {k + 1}" for k in range(count)]


def _turning_joints(avatar: Avatar) -> Sequence[str]:
    """Return the joints whose rotation moves the avatar."""
    every = Pose(torch.ones(1, len(JOINTS), 3), torch.zeros(1, 3), torch.zeros(1, 0))
    turned = avatar.applied_rotations(every).any(2)[0].tolist()
    return [name for name, turns in zip(JOINTS, turned, strict=True) if turns]
