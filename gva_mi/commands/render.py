"""The command ``gva-mi render``: an avatar driven by any poses, seen by any cameras."""

from __future__ import annotations

import json
from pathlib import Path

from tyro.conf import Positional

from gva_mi.body.pose import load_poses
from gva_mi.commands.arguments import Switch
from gva_mi.console import bar, say
from gva_mi.data.pictures import write_image, write_movie
from gva_mi.data.video import load_cameras
from gva_mi.errors import InputError
from gva_mi.files import make_room, versions
from gva_mi.fit.renders import render_sequence
from gva_mi.fit.run_folder import load_avatar

MARKER = "render.json"  # every folder of renders that was made here holds it
MOVIE = "video.mp4"


def render(
    run: Positional[Path],
    *,
    poses: Path,
    cameras: Path,
    out: Path,
    video: Switch = False,
    overwrite: Switch = False,
) -> None:
    """Drive an avatar by any poses, seen by any cameras: pictures, or a film.

    Args:
        run: the folder of a finished fit, or an avatar.npz.
        poses: SMPL-X's names, each (T, ...).
        cameras: K, T_camera_world, width, height; one for all frames, or T.
        out: folder for 000000.png ...
        video: also write video.mp4 there.
        overwrite: replace renders that are there.
    """
    avatar = load_avatar(run)
    pose, _ = load_poses(poses)
    views = load_cameras(cameras)
    if len(views) not in (1, len(pose)):
        raise InputError(
            f"{cameras}: holds {len(views)} cameras, expected one, or one for each of the "
            f"{len(pose)} frames of {poses}"
        )
    make_room(out, MARKER, overwrite)
    out.mkdir(parents=True, exist_ok=True)
    (out / MARKER).write_text(json.dumps({"avatar": str(run), "versions": versions()}))
    images = []
    with bar("render") as progress:
        for k, image in enumerate(render_sequence(avatar, pose, views)):
            write_image(out / f"{k:06d}.png", image)
            if video:
                images.append(image)
            progress(k + 1, len(pose))
    if video:
        write_movie(out / MOVIE, images, lossless=False)
    say(f"{len(pose)} pictures: {out}")
