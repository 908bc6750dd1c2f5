"""Drive an avatar by any motion, and render it.

A folder of renders holds only complete files, and a marker with the stamp
(:mod:`gva_mi.core.stamp`) of all inputs. The same call, made again, writes only the missing files,
with the bits of an uninterrupted run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn.functional import pad

from gva_mi.app.scenes import LIMITS, SceneOptions, StagedMotion
from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, Shape, is_pose_file
from gva_mi.core.atomic import folder_lock, require_writable
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.stamp import is_fresh, results_version, stamp, start_folder
from gva_mi.fit import run_folder
from gva_mi.fit.renders import CameraPath, CameraShot, over, render_shots, shots, to_rgba
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody
from gva_mi.subject.cameras import load_cameras
from gva_mi.subject.folder import VIDEO, frame_name
from gva_mi.subject.pictures import read_background, read_image, write_image
from gva_mi.subject.video_file import write_video

RENDERED = "render.json"  # the marker of a folder of renders


def render(
    run: Path | str,
    out: Path | str,
    path: CameraPath = CameraPath(),  # noqa: B008 (frozen)
    *,
    poses: Path | str | None = None,
    cameras: Path | str | None = None,
    background: str = "white",
    alpha: bool = False,
    video: bool = False,
    fps: int = 25,
    scene: SceneOptions = SceneOptions(),  # noqa: B008 (frozen)
    body: Path | str | None = None,
    overwrite: bool = False,
) -> None:
    """Drive an avatar by any poses, seen by any cameras: pictures, or a video.

    If it was interrupted, the same call resumes it.

    Args:
        run: the folder of a finished fit, or an avatar.npz.
        out: folder for the pictures 000000.png, 000001.png ...
        path: where the cameras stand, if ``cameras`` are not given.
        poses: a file of poses, or any motion that ``gva-mi motion`` reads; without it, the poses
            trained with the avatar.
        cameras: a file of cameras: one for all frames, or one for each.
        background: a colour, such as white or #ff8800, or a picture file.
        alpha: make the pictures transparent around the avatar.
        video: also write video.mp4 there; not with ``alpha``, because videos have no transparency.
        fps: frames per second of videos; motions of other programs are resampled to it.
        scene: a Mitsuba scene around the person, and how the person stands in it.
        body: the body file of an avatar without its body; without it, the run's, else the built-in.
        overwrite: replace existing renders.

    Example:
        One picture of 64 × 64 pixels of an avatar that was not fitted.

        >>> import tempfile
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import save_poses
        >>> from gva_mi.body.smplx import load_body
        >>> average, options = Shape(torch.zeros(10)), AvatarOptions(SeedOptions(count=500))
        >>> with tempfile.TemporaryDirectory() as name:
        ...     folder = Path(name)
        ...     seed_avatar(load_body(), average, options=options).save(folder / "avatar.npz")
        ...     save_poses(folder / "poses.npz", Pose.rest(), average, stage=1)
        ...     static = CameraPath("static", size=(64, 64))
        ...     render(folder / "avatar.npz", folder / "out", static, poses=folder / "poses.npz")
        ...     sorted(path.name for path in (folder / "out").iterdir())
        1 pictures: ...
        ['000000.png', 'render.json']
    """
    run, out = Path(run), Path(out)
    if out.suffix.lower() in (".mp4", ".mov", ".gif", ".png", ".jpg"):
        raise InputError(f"{out}: expected a folder; with --video, video.mp4 is written into it")
    if cameras is not None and path != CameraPath():
        raise InputError("render: give --cameras, or say where cameras stand; not both")
    if video and alpha:
        raise InputError("render: a video cannot be transparent; give --video or --alpha, not both")
    if scene.scene is None and scene != SceneOptions():
        raise InputError("render: --light, --exposure, --spp and --place need --scene")
    if scene.scene is not None and (alpha or background != "white"):
        raise InputError("render: a scene is the background; give --scene alone")
    body = run_folder.body_of_run(run, None if body is None else Path(body))
    avatar = run_folder.load_avatar(run, body)
    motion, _ = motion_of(run, avatar, poses, fps, body)
    staged, pictures = None, None
    if cameras is not None:
        pictures = _given_cameras(Path(cameras), motion)
    elif scene.scene is None or path != CameraPath():
        pictures = shots(path.or_usual(moving=poses is not None), avatar.rig, motion)
    if scene.scene is not None:
        staged = StagedMotion.of(run, avatar, motion, scene, pictures)
        pictures = staged.shots
    size = pictures[0].camera.width, pictures[0].camera.height
    behind = read_background(background, *size)
    made_of = _stamp(avatar, motion, pictures, behind, alpha, video, fps, *scene.inputs())
    about = {"avatar": str(run), "poses": poses, "cameras": cameras, "scene": scene.scene}
    files = [frame_name(k) for k in range(len(pictures))]
    names = [*files, VIDEO] if video else files

    def images(missing: Collection[str]) -> Iterator[np.ndarray]:
        """Render and write the missing pictures, and yield them; for a video yield all."""
        drawn = [k for k, file in enumerate(files) if file in missing]
        if staged is None:
            layers = render_shots(avatar, motion, [pictures[k] for k in drawn], progress)
        else:
            layers = staged.layers(drawn, progress)
        for k in range(len(files)) if VIDEO in missing else drawn:
            if files[k] not in missing:
                yield read_image(out / files[k], 4 if alpha else 3)
                continue
            layer = next(layers)
            image = to_rgba(layer) if alpha else over(layer, behind)
            write_image(out / files[k], image)
            yield image

    folder = _missing(out, names, overwrite, about, made_of)
    with folder as missing, bar("render") as progress:
        if VIDEO in missing:
            write_video(out / VIDEO, images(missing), fps, "playable")
        else:
            deque(images(missing), maxlen=0)
    if staged is not None:
        say(f"limits: {LIMITS}")
    say(f"{len(pictures)} pictures: {out}")


def _given_cameras(path: Path, motion: Pose) -> list[CameraShot]:
    """Return a shot of each frame of the motion by the cameras of a file."""
    views = load_cameras(path)
    if len(views) not in (1, len(motion)):
        raise InputError(
            f"{path}: holds {len(views)} cameras, expected one, or one for each of the "
            f"{len(motion)} frames of the poses"
        )
    return [CameraShot(k, views[k % len(views)]) for k in range(len(motion))]


def motion_of(
    run: Path, avatar: Avatar, poses: Path | str | None, fps: float, body: Path | None
) -> tuple[Pose, Shape]:
    """Return the motion that drives an avatar, and the shape of the person who moved.

    A motion that ``gva-mi motion`` reads is resampled to ``fps`` frames per second, and its notes
    are printed. Poses are played as they are; without ``poses``, the poses trained with the avatar.

    Example:
        >>> import tempfile
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import save_poses
        >>> from gva_mi.body.smplx import load_body
        >>> average, options = Shape(torch.zeros(10)), AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), average, options=options)
        >>> run = Path(tempfile.mkdtemp())
        >>> save_poses(run / "taller.npz", Pose.rest(frames=3), Shape(torch.ones(10)), stage=1)
        >>> motion, shape = motion_of(run, avatar, run / "taller.npz", fps=25, body=None)
        /...: poses of a person of another shape, used as they are: ...
        >>> len(motion)
        3
    """
    given = None if poses is None else Path(poses)
    if given is None or is_pose_file(given):
        pose, shape, path = run_folder.load_motion(run, given)
    else:
        found = read_motion(given, TargetBody.read(body), MotionOptions(fps=fps, default_fps=fps))
        pose, shape, path = found.pose, found.shape, given
        for note in found.notes:
            say(f"{given}: {note}")
    count = max(len(avatar.rig.betas), len(shape.betas))
    own, theirs = (pad(x.double(), (0, count - len(x))) for x in (avatar.rig.betas, shape.betas))
    if not torch.allclose(own, theirs, atol=1e-4):
        say(
            f"{path}: poses of a person of another shape, used as they are: joint rotations "
            "and the root's path are kept, bones have the avatar's lengths, so feet may slide"
        )
    return pose, shape


@contextmanager
def _missing(
    out: Path, names: Sequence[str], overwrite: bool, about: dict[str, Any], made_of: str
) -> Iterator[list[str]]:
    """Lock a folder, then start it anew or continue it; yield the ``names`` that are missing.

    ``about`` is the content of the marker, and ``made_of`` the stamp of all files. An InputError
    says that the folder holds something else, or already has all files.
    """
    with folder_lock(out, "gva-mi render"):
        missing = [name for name in names if not (out / name).exists()]
        if overwrite or not missing or not is_fresh(out / RENDERED, made_of):
            start_folder(out, RENDERED, overwrite, about, made_of)
            missing = list(names)
        else:
            require_writable(out)
            if len(missing) < len(names):
                say(f"{out}: resumed, {len(names) - len(missing)} of {len(names)} files exist")
        yield missing


def _stamp(avatar: Avatar, motion: Pose, pictures: Iterable[CameraShot], *how: object) -> str:
    """Return the stamp of renders; ``how`` holds all other inputs: numbers, words and arrays."""
    inputs: list[object] = [*avatar.record().values(), *motion.to_smplx().values(), *how]
    for shot in pictures:
        camera = shot.camera
        inputs += [shot.frame, camera.K, camera.T_camera_world]
        inputs += [camera.model, camera.width, camera.height]
    return stamp(inputs, version=results_version("avatar"))
