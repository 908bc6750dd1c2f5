"""The command ``gva-mi score``: score any method's renders by every usual protocol."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from tyro.conf import Positional

from gva_mi.app.steps import body_of
from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import Switch
from gva_mi.core.console import aligned, bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room, write_json
from gva_mi.data.folder import CAMERAS
from gva_mi.data.pictures import read_background
from gva_mi.data.video import load_video
from gva_mi.fit.perceptual import find_weights
from gva_mi.study.page import number
from gva_mi.study.picture_pairs import pairs_of_pictures, pairs_of_subject
from gva_mi.study.score_pictures import RegionScores, score_pictures
from gva_mi.study.scores import Scorer


def score(
    renders: Positional[Path],
    truth: Positional[Path],
    *,
    masks: Path | None = None,
    background: str = "white",
    body: Path | None = None,
    out: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Score renders of any method: whole picture, box, mask, hands, face; strict and shifted.

    Files are paired by the last number in their names, films in their order.

    Args:
        renders: a film or a folder of pictures; with alpha, they are put on the background.
        truth: a film or a folder of pictures, or a subject's folder, whose masks and poses give
            box, mask, hands and face.
        masks: of the person in the pictures of truth: a film, a folder, or a .npy (T, H, W).
        background: the colour behind the renders, on which masked pictures are put; none: pictures
            stay as they are.
        body: of the subject's poses, in SMPL-X's .npz format; without it the one that the subject
            was prepared for, else the built-in body.
        out: also write the table to this .json file.
        overwrite: replace that file.
    """
    if out is not None:
        require_room(out, overwrite)
    color = None if background == "none" else read_background(background, 1, 1).reshape(-1)[:3]
    if not (truth / CAMERAS).is_file():  # not a subject's folder
        pairs = pairs_of_pictures(renders, truth, masks, color)
    elif masks is None:
        pairs = pairs_of_subject(renders, load_video(truth), load_body(body_of(truth, body)), color)
    else:
        raise InputError(f"{truth}: has its own masks; give it without --masks")
    scorer = Scorer(find_weights())
    with bar("score") as progress:
        rows = score_pictures(pairs, scorer, progress)
    for line in aligned(_cells(rows), left=(0, 1)):
        say(line)
    if out is not None:
        table = [asdict(row) for row in rows]
        write_json(out, {"background": background, "rows": table, "networks": scorer.networks()})
        say(f"figures: {out}")


def _cells(rows: Sequence[RegionScores]) -> Iterator[Sequence[str]]:
    """Yield the head of the table, and a row for each region and protocol."""
    yield "", "", "PSNR, dB", "SSIM", "LPIPS", "rand_vgg", "pictures"
    for row in rows:
        known = (number(x, 4) for x in (row.ssim, row.lpips, row.rand_vgg))
        yield row.region, row.protocol, number(row.psnr, 2), *known, str(row.count)
