"""The command ``gva-mi score``: score any method's renders by every usual protocol."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from gva_mi.body.smplx import load_body
from gva_mi.cli.parse import Switch
from gva_mi.core.console import aligned, bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room, write_json
from gva_mi.evaluate.figures import pivot, table, to_json
from gva_mi.evaluate.scores import Scorer, pairs_of_pictures, pairs_of_subject, score_pictures
from gva_mi.fit.perceptual import find_weights
from gva_mi.subject.folder import CAMERAS
from gva_mi.subject.opened import body_of
from gva_mi.subject.pictures import read_background
from gva_mi.subject.video import load_video


def score(
    renders: Positional[Path],
    truth: Positional[Path],
    *,
    masks: Path | None = None,
    background: str = "white",
    out: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Score renders of any method: whole picture, box, mask, hands, face.

    Pictures are paired by the last number in their file names, frames of videos by their order.

    Args:
        renders: a video or a folder of pictures; pictures with alpha are put on the background.
        truth: a video or a folder of pictures, or a subject's folder, whose masks and poses give
            box, mask, hands and face.
        masks: masks of the person in the pictures of truth: a video, a folder, or a .npy (T, H, W).
        background: the colour behind the renders, on which masked pictures are put; none: pictures
            stay as they are.
        out: also write the table to this .json file.
        overwrite: replace that file.
    """
    if out is not None:
        require_room(out, overwrite)
    color = None if background == "none" else read_background(background, 1, 1).reshape(-1)[:3]
    if not (truth / CAMERAS).is_file():  # not a subject's folder
        pairs = pairs_of_pictures(renders, truth, masks, color)
    elif masks is None:
        pairs = pairs_of_subject(renders, load_video(truth), load_body(body_of(truth)), color)
    else:
        raise InputError(f"{truth}: has its own masks; give it without --masks")
    scorer = Scorer(find_weights())
    with bar("score") as progress:
        figures = score_pictures(pairs, scorer, progress)
    found = table(pivot(figures, ("region",)))
    for line in aligned([found.head, *found.rows]):
        say(line)
    if out is not None:
        record = {"background": background, "figures": to_json(figures)}
        write_json(out, record | {"networks": scorer.networks()})
        say(f"figures: {out}")
