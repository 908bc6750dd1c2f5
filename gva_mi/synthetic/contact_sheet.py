"""A contact sheet of the study's subjects and of one subject's video."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import ROOT
from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_files
from gva_mi.data.video import Video, load_video
from gva_mi.mesh.overlay import overlay
from gva_mi.synthetic import motion
from gva_mi.synthetic.framing import camera_around
from gva_mi.synthetic.options import SynthOptions
from gva_mi.synthetic.people import STUDY
from gva_mi.synthetic.render import Renderer
from gva_mi.synthetic.subject import Subject, draw_subject
from gva_mi.synthetic.subject_folder import make_subject

CAPTION, GAP = 22, 6  # px, height of a line of text; space between pictures
COLUMNS = len(STUDY)
COLORS = 256  # of the file's palette
TALL = 1.25  # size of a picture of the whole person, over the width that is shown
HEAD, REACH = (-0.03, -0.03, -0.06), 0.17  # m, a portrait's centre from the left eye; half its size
AZIMUTHS = (2.6, 0.7, -0.9, -2.3, 0.5, 1.2, 2.2)  # rad, of the views of poses


def contact_sheet(
    path: Path,
    body: BodyModel,
    *,
    subject: str = "amira",
    size: int = 256,
    samples: int = 16,
    progress: Callable[..., None] | None = None,
) -> None:
    """Write the sheet as a PNG: portrait, front and a pose of all subjects, and a video.

    Args:
        path: the file.
        body: of the subjects.
        subject: whose video is shown.
        size: width of a picture, pixels.
        samples: rays per pixel, a square number.
        progress: called as ``progress(done, total)`` after each subject, and after the video.
    """
    rows: list[list[np.ndarray]] = [[], [], []]
    for k, person in enumerate(STUDY.values()):
        drawn = draw_subject(body, person)
        pictures = _portrait_front_pose(drawn, body, k, size, samples)
        for row, picture in zip(rows, pictures, strict=True):
            row.append(picture)
        if progress is not None:
            progress(k + 1, COLUMNS + 1)
    options = SynthOptions(
        subject=subject, motion="everyday", frames=COLUMNS, size=round(TALL * size),
        samples=samples, novel_poses=0, novel_views=0,
    )  # fmt: skip
    captions = [
        list(STUDY), [], [], [f"{subject}: frames of a video"], ["masks"], ["normals"],
        ["stage-1 poses over the frames"],
    ]  # fmt: skip
    # The video lies beside the sheet, where the next call removes what a killed process left.
    with atomic_files(path) as folder:
        make_subject(folder / subject, options, body)
        shown = _video_rows(load_video(folder / subject), body)
        _write(folder / path.name, _laid_out([*rows, *shown], captions, size))
    if progress is not None:
        progress(COLUMNS + 1, COLUMNS + 1)


def _write(path: Path, canvas: np.ndarray) -> None:
    """Write a picture in [0, 1] as a small PNG with a palette."""
    from PIL import Image

    image = Image.fromarray(np.round(255 * canvas).astype(np.uint8))
    image = image.quantize(COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    image.save(path, format="PNG", optimize=True)


def _portrait_front_pose(
    subject: Subject, body: BodyModel, k: int, size: int, samples: int
) -> list[np.ndarray]:
    """Render the head, the A-pose, and another pose of the k-th subject."""
    renderer, tall = Renderer(subject), round(TALL * size)
    rng = np.random.default_rng(k)
    standing = motion.turn(np.array([0.0]), body.num_expressions, rng)
    acting = motion.novel(COLUMNS, body.num_expressions, rng)[k]
    standing.rotations[:, ROOT] = 0
    still, pose = (subject.posed(body, p, folds=1.0)[0] for p in (standing, acting))
    head = np.abs(subject.vertices - subject.look.face.eyes[0] - HEAD).max(1) < REACH
    views = [
        (still, camera_around(still[head], size, 0.5, 0.05)),
        (still, camera_around(still, tall)),
        (pose, camera_around(pose, tall, AZIMUTHS[k % len(AZIMUTHS)], 0.12)),
    ]
    return [renderer(surface, camera, samples, k).color for surface, camera in views]


def _video_rows(video: Video, body: BodyModel) -> list[list[np.ndarray]]:
    """Return rows of frames, masks, normals and overlays of a video."""
    rows: list[list[np.ndarray]] = [[], [], [], []]
    for frame in video.frames():
        with torch.no_grad():
            vertices = body(frame.pose, video.shape).vertices[0]
        mask = np.repeat(frame.mask[..., None], 3, axis=2)
        normals = np.where(frame.mask[..., None] > 0.5, (frame.normals + 1) / 2, 1.0)
        overlaid = overlay(frame.image, frame.camera, vertices, body.faces)
        shown = (frame.image, 1 - mask, normals, overlaid)
        for row, picture in zip(rows, shown, strict=True):
            row.append(picture)
    return rows


def _laid_out(rows: list[list[np.ndarray]], captions: list[list[str]], size: int) -> np.ndarray:
    """Arrange rows of pictures below their captions on white, cropped to their content."""
    from PIL import Image, ImageDraw, ImageFont

    width = COLUMNS * (size + GAP) - GAP
    font = ImageFont.load_default(size=15)
    bands = []
    for row, texts in zip(rows, captions, strict=True):
        drawn = np.flatnonzero(np.any([(p < 0.995).any((1, 2)) for p in row], axis=0))
        top, bottom = drawn[0], drawn[-1] + 1
        if texts:
            line = Image.new("RGB", (width, CAPTION), "white")
            for k, text in enumerate(texts):
                ImageDraw.Draw(line).text((k * (size + GAP) + 4, 2), text, "black", font)
            bands.append(np.asarray(line, dtype=np.float32) / 255)
        band = np.ones((bottom - top + GAP, width, 3), dtype=np.float32)
        for k, picture in enumerate(row):
            left = max((picture.shape[1] - size) // 2, 0)
            shown = picture[top:bottom, left : left + size]
            band[: bottom - top, k * (size + GAP) : k * (size + GAP) + shown.shape[1]] = shown
        bands.append(band)
    return np.concatenate(bands)
