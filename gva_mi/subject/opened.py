"""A subject opened for a step: video, body and poses that belong together.

Every step that starts from a subject's folder calls :func:`open_subject`. So all steps use the same
files, and report the same faults before they start to work.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.subject.fingerprint import prepared_body, require_same_body
from gva_mi.subject.folder import POSES, REFINED_POSES
from gva_mi.subject.silhouettes import sanity_check
from gva_mi.subject.video import Video, load_video


@dataclass(frozen=True)
class OpenedSubject:
    """A subject's folder, opened."""

    folder: Path
    video: Video  # with the poses below
    model: BodyModel  # that the poses are for
    poses: Path  # file of the poses
    body: Path | None  # file of the body; None: the built-in body


def open_subject(
    folder: Path,
    poses: Path | str | None = None,
    body: Path | str | None = None,
    normals: str | None = None,
) -> OpenedSubject:
    """Open a subject's folder; print a warning if the posed body does not overlap the masks.

    Args:
        folder: the folder.
        poses: a file of poses; None: the refined poses if they exist, otherwise stage 1's.
        body: a body file; None: the one that the subject was prepared for, or the built-in body.
        normals: how the normals were made (:mod:`gva_mi.subject.normals`); None: as recorded.

    Raises:
        InputError: a file is missing or wrong, or the poses belong to another body.
    """
    body, poses = body_of(folder, body), _poses_of(folder, poses)
    model = load_body(body)
    require_same_body(folder, model)
    video = load_video(folder, poses, normals=normals)
    if doubt := sanity_check(video, model):
        say(doubt)
    return OpenedSubject(folder, video, model, poses, body)


def body_of(folder: Path, given: Path | str | None = None) -> Path | None:
    """Return the given body's file, or that of the body that a subject was prepared for.

    The result is None for the built-in body.

    Raises:
        InputError: the file does not exist any more.
    """
    if given is not None:
        return Path(given)
    found = prepared_body(folder)
    if found is not None and not found.exists():
        raise InputError(
            f"{folder}: was prepared for the body {found}, which does not exist any more; pass "
            "its new path with --body"
        )
    return found


def _poses_of(folder: Path, given: Path | str | None) -> Path:
    """Return the given file of poses, or the refined poses, or stage 1's with a printed note."""
    if given is not None:
        return Path(given)
    if not (folder / REFINED_POSES).exists():
        say(f"{folder}: no {REFINED_POSES}, the stage-1 poses are used as they are")
        return folder / POSES
    return folder / REFINED_POSES
