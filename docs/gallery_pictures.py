"""Pictures of the documentation that show the avatar of the demo.

    python docs/gallery_pictures.py DEMO OUT

DEMO is the folder of ``gva-mi demo``; ``overview.png``, ``check.png``, ``motions.png`` and
``exports.png`` are written into OUT.

The overview shows what an avatar is made of, and what it looks like in new poses. Above: a frame
that training left out, its normals, the Gaussians drawn small, and the avatar from other sides.
Below: the ground truth beside the render in two poses that are not in the video, and a raised hand.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from gva_mi import app
from gva_mi.avatar.avatar import Avatar
from gva_mi.body.smplx import load_body
from gva_mi.evaluate.measure import SplitView
from gva_mi.evaluate.pictures import shown_views, turntable
from gva_mi.evaluate.regions import person_box
from gva_mi.fit import run_folder
from gva_mi.fit.renders import CameraPath, cut_out, render_frame
from gva_mi.splat import render
from gva_mi.splat.axes import with_axes
from gva_mi.subject.normals import normal_colors
from gva_mi.subject.pictures import in_8_bits, read_image
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Video, load_video
from gva_mi.synthetic import SynthOptions, make_subject

ROW_HEIGHT = 440  # pixels of a row of the overview
TURNED = 3  # other sides of the avatar there
TIMES = 2  # renders in new poses are so much larger than the pictures beside them
SIZE = (240, 340)  # pixels of one picture
SHOWN = 6


def gva_mi(*words: str | Path) -> None:
    """Run a command, as a reader would."""
    command = [sys.executable, "-m", "gva_mi", *map(str, words)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def in_a_row(pictures: list[Path]) -> np.ndarray:
    """Lay pictures side by side, each cut to what is not white, all to the same rows."""
    images = [read_image(path, 3) for path in pictures]
    drawn = [image.min(-1) < 250 for image in images]
    all_rows, cut = person_box(np.any(drawn, axis=0)), []
    for image, inside in zip(images, drawn, strict=True):
        own = person_box(inside)
        cut.append(image[all_rows.top : all_rows.bottom, own.left : own.right])
    return np.concatenate(cut, axis=1)


def save(image: np.ndarray, out: Path) -> None:
    """Write a picture in few colours, because it is part of the documentation."""
    Image.fromarray(image).quantize(200, dither=Image.Dither.NONE).save(out, optimize=True)


def motions(run: Path, folder: Path) -> list[Path]:
    """The avatar in the steps of somebody else, who dances."""
    dancer = folder / "dancer"
    options = SynthOptions(
        motion="dance", frames=SHOWN, size=32, samples=1, bare=True,
        novel_poses=0, novel_views=0,
    )  # fmt: skip
    make_subject(dancer, options, load_body())
    out = folder / "motions"
    app.render(run, out, CameraPath("static", size=SIZE), poses=dancer / "truth/poses.npz")
    return sorted(out.glob("*.png"))


def exports(run: Path, folder: Path) -> list[Path]:
    """What a file without the body's rig holds, driven again and seen from all around."""
    alone = folder / "alone.npz"
    gva_mi("export", run, "--no-rig", "--out", alone)
    out = folder / "exports"
    app.render(alone, out, CameraPath("turntable", SHOWN, size=SIZE), poses=run / "poses.npz")
    return sorted(out.glob("*.png"))


def overview(avatar: Avatar, video: Video) -> np.ndarray:
    """Return the picture, 8-bit (H, W, 3), on white.

    Args:
        avatar: to show.
        video: opened with the poses that the avatar was trained under.
    """
    rows = [list(_made_of(avatar, video))]
    if (view := shown_views(avatar, video, load_body()).get("novel_pose")) is not None:
        rows.append(list(_new_poses(avatar, view)))
    return _stacked([np.concatenate([_scaled(part) for part in row], axis=1) for row in rows])


def _made_of(avatar: Avatar, video: Video) -> Iterator[np.ndarray]:
    frame = video.truly_cut(video[(video.splits.test or video.splits.train)[0]])
    yield cut_out(frame)
    if frame.normals is not None:
        inside = frame.mask[..., None] > 0.5
        yield in_8_bits(np.where(inside, normal_colors(frame.normals), 1))
    with torch.no_grad():
        whole = with_axes(avatar(frame.pose))
        thin = replace(whole, scales=whole.scales / 3)
        yield in_8_bits(render(thin, frame.camera, background=torch.ones(3)).color.numpy())
    yield from list(turntable(avatar, frame.pose, TURNED + 1, video.size))[1:]


def _new_poses(avatar: Avatar, view: SplitView) -> Iterator[np.ndarray]:
    """Show ground truth and render of two poses, and of the hand that is raised highest in any."""
    frames = {k: view.video.truly_cut(view.video[k]) for k in view.frames}
    boxes = [(k, person_box(frames[k].mask)) for k in spread(view.frames, 4)[1:3]]
    if view.details is not None:
        found = [(k, box) for k in frames for what, box in view.details.boxes(k) if what == "hands"]
        boxes += sorted(found, key=lambda hand: hand[1].top)[:1]
    for k, box in boxes:
        yield box.cut(cut_out(frames[k]))
        camera = box.cut_camera(frames[k].camera).resized(TIMES * box.width, TIMES * box.height)
        yield render_frame(avatar, frames[k].pose, camera)


def _scaled(part: np.ndarray) -> np.ndarray:
    """Cut a picture to what is not white, and scale it to the height of a row."""
    from PIL import Image

    cut = person_box(part.min(-1) < 250).cut(part)
    width = max(1, round(cut.shape[1] * ROW_HEIGHT / cut.shape[0]))
    resized = Image.fromarray(cut).resize((width, ROW_HEIGHT), Image.Resampling.LANCZOS)
    return np.asarray(resized)


def _stacked(rows: list[np.ndarray]) -> np.ndarray:
    """Stack rows of different widths, each in the middle of the picture."""
    width = max(row.shape[1] for row in rows)
    picture = np.full((len(rows) * ROW_HEIGHT, width, 3), 255, np.uint8)
    for k, row in enumerate(rows):
        left = (width - row.shape[1]) // 2
        picture[k * ROW_HEIGHT : (k + 1) * ROW_HEIGHT, left : left + row.shape[1]] = row
    return picture


if __name__ == "__main__":
    demo, out = map(Path, sys.argv[1:])
    trained = run_folder.under_trained_poses(load_video(demo / "subject"), demo / "run")
    avatar = run_folder.load_avatar(demo / "run")
    Image.fromarray(overview(avatar, trained)).save(out / "overview.png")  # normals: all colours
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        app.check(demo / "subject", sheet=folder / "check.png")
        save(read_image(folder / "check.png", 3), out / "check.png")
        save(in_a_row(motions(demo / "run", folder)), out / "motions.png")
        save(in_a_row(exports(demo / "run", folder)), out / "exports.png")
