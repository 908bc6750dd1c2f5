"""The first picture of a run: what an avatar is made of, and what it looks like in new poses.

Above: a frame that training left out, its normals, the Gaussians drawn small, and the avatar from
other sides. Below, for synthetic subjects: the ground truth beside the render in two poses that are
not in the video, and a raised hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch

from gva_mi.data.normals import normal_colors
from gva_mi.data.pictures import in_8_bits
from gva_mi.data.splits import spread
from gva_mi.data.video import Video
from gva_mi.fit.renders import cut_out, render_frame
from gva_mi.splat import render
from gva_mi.splat.axes import with_axes
from gva_mi.study.evaluate import SplitView
from gva_mi.study.pictures import ShownAvatar, turntable
from gva_mi.study.regions import person_box

HEIGHT = 440  # pixels of a row
TURNED = 3  # other sides of the avatar
TIMES = 2  # renders in new poses are so much larger than the pictures beside them


def overview(shown: ShownAvatar, video: Video) -> np.ndarray:
    """Return the picture, 8-bit (H, W, 3), on white.

    Args:
        shown: the avatar and its splits.
        video: opened with the poses that the avatar was trained under.
    """
    rows = [list(_made_of(shown, video))]
    if (view := shown.views.get("novel_pose")) is not None:
        rows.append(list(_new_poses(shown, view)))
    return _stacked([np.concatenate([_scaled(part) for part in row], axis=1) for row in rows])


def _made_of(shown: ShownAvatar, video: Video) -> Iterator[np.ndarray]:
    frame = video.truly_cut(video[(video.splits.test or video.splits.train)[0]])
    yield cut_out(frame)
    if frame.normals is not None:
        inside = frame.mask[..., None] > 0.5
        yield in_8_bits(np.where(inside, normal_colors(frame.normals), 1))
    with torch.no_grad():
        whole = with_axes(shown.avatar(frame.pose))
        thin = replace(whole, scales=whole.scales / 3)
        yield in_8_bits(render(thin, frame.camera, background=torch.ones(3)).color.numpy())
    yield from list(turntable(shown.avatar, frame.pose, TURNED + 1, video.size))[1:]


def _new_poses(shown: ShownAvatar, view: SplitView) -> Iterator[np.ndarray]:
    """Show ground truth and render of two poses, and of the hand that is raised highest in any."""
    frames = {k: view.video.truly_cut(view.video[k]) for k in view.frames}
    boxes = [(k, person_box(frames[k].mask)) for k in spread(view.frames, 4)[1:3]]
    if view.details is not None:
        found = [(k, box) for k in frames for what, box in view.details.boxes(k) if what == "hands"]
        boxes += sorted(found, key=lambda hand: hand[1].top)[:1]
    for k, box in boxes:
        yield box.cut(cut_out(frames[k]))
        camera = box.cut_camera(frames[k].camera).resized(TIMES * box.width, TIMES * box.height)
        yield render_frame(shown.avatar, frames[k].pose, camera)


def _scaled(part: np.ndarray) -> np.ndarray:
    """Cut a picture to what is not white, and scale it to the height of a row."""
    from PIL import Image

    cut = person_box(part.min(-1) < 250).cut(part)
    width = max(1, round(cut.shape[1] * HEIGHT / cut.shape[0]))
    resized = Image.fromarray(cut).resize((width, HEIGHT), Image.Resampling.LANCZOS)
    return np.asarray(resized)


def _stacked(rows: list[np.ndarray]) -> np.ndarray:
    """Stack rows of different widths, each in the middle of the picture."""
    width = max(row.shape[1] for row in rows)
    margins = [divmod(width - row.shape[1], 2) for row in rows]
    sides = [(left, left + odd) for left, odd in margins]
    pad = lambda row, side: np.pad(row, ((0, 0), side, (0, 0)), constant_values=255)
    return np.concatenate([pad(row, side) for row, side in zip(rows, sides, strict=True)])
