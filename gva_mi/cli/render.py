"""The command ``gva-mi render``: render an avatar under any poses and cameras."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional

from gva_mi.body.pose import Pose
from gva_mi.cli.arguments import Flat, Switch
from gva_mi.cli.driving import motion_of
from gva_mi.cli.resume import series, stamp_of
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.options import Within
from gva_mi.data.cameras import load_cameras
from gva_mi.data.film import SEE_THROUGH, require_alpha_codec, write_film
from gva_mi.data.folder import VIDEO, frame_name
from gva_mi.data.pictures import read_background, read_image, write_image
from gva_mi.fit.renders import CameraPath, CameraShot, over, render_shots, shots, to_rgba
from gva_mi.fit.run_folder import body_of_run, load_avatar

MARKER = "render.json"  # every folder of renders holds it


def render(
    run: Positional[Path],
    view: Flat[CameraPath] = CameraPath(),  # noqa: B008 (frozen)
    *,
    out: Path,
    poses: Path | None = None,
    cameras: Path | None = None,
    background: str = "white",
    alpha: Switch = False,
    video: Switch = False,
    fps: Annotated[int, Within(1, 1000)] = 25,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Drive an avatar by any poses, seen by any cameras: pictures, or a film.

    If it was interrupted, the same command resumes it.

    Args:
        run: the folder of a finished fit, or an avatar.npz.
        view: where cameras stand, without --cameras.
        out: folder for 000000.png ...
        poses: SMPL-X's names, each (T, ...), or any motion that gva-mi motion reads; without it
            the poses trained with the avatar.
        cameras: K, T_camera_world, width, height; one for all frames, or T.
        background: a colour, such as white or #ff8800, or a picture file.
        alpha: pictures are transparent around the avatar, and so is a film, then a .webm.
        video: also write video.mp4 there; with --alpha video.webm.
        fps: frames a second of films; motions of other programs are resampled to it.
        body: the body file of an avatar without its body; without it the run's, or the puppet.
        overwrite: replace existing renders.
    """
    if cameras is not None and view != CameraPath():
        raise InputError("render: give --cameras, or say where cameras stand; not both")
    body = body_of_run(run, body)
    avatar = load_avatar(run, body)
    motion, _ = motion_of(run, avatar, poses, fps, body)
    if cameras is None:
        pictures = shots(view.or_usual(moving=poses is not None), avatar.rig, motion)
    else:
        pictures = _given(cameras, motion)
    size = pictures[0].camera.width, pictures[0].camera.height
    behind = read_background(background, *size)
    movie = Path(VIDEO).stem + SEE_THROUGH if alpha else VIDEO
    if video and alpha:
        require_alpha_codec(out / movie)
    made_of = stamp_of(avatar, motion, pictures, behind, alpha, video, fps)
    about = {"avatar": str(run), "poses": poses, "cameras": cameras}
    files = [frame_name(k) for k in range(len(pictures))]
    names = [*files, movie] if video else files

    def images(missing: Collection[str]) -> Iterator[np.ndarray]:
        """Render and write the missing pictures, and yield them; for a film yield all."""
        drawn = [k for k, file in enumerate(files) if file in missing]
        layers = render_shots(avatar, motion, [pictures[k] for k in drawn], progress)
        for k in range(len(files)) if movie in missing else drawn:
            path = out / files[k]
            if files[k] not in missing:
                yield read_image(path, 4 if alpha else 3)
                continue
            layer = next(layers)
            image = to_rgba(layer) if alpha else over(layer, behind)
            write_image(path, image)
            yield image

    folder = series(out, MARKER, names, overwrite, about, made_of)
    with folder as missing, bar("render") as progress:
        if movie in missing:
            write_film(out / movie, images(missing), fps, "alpha" if alpha else "playable")
        else:
            deque(images(missing), maxlen=0)
    say(f"{len(pictures)} pictures: {out}")


def _given(cameras: Path, motion: Pose) -> list[CameraShot]:
    """Return a shot of each frame of the motion by the cameras of a file."""
    views = load_cameras(cameras)
    if len(views) not in (1, len(motion)):
        raise InputError(
            f"{cameras}: holds {len(views)} cameras, expected one, or one for each of the "
            f"{len(motion)} frames of the poses"
        )
    return [CameraShot(k, views[k % len(views)]) for k in range(len(motion))]
