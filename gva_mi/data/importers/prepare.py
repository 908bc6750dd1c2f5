"""A pose estimator's output, with its pictures and masks, as a folder that every step reads.

The world is the camera turned upright, half a turn about x, so that y is up and the camera looks
along −z. A body turns about its own pelvis p at rest: the root R of the source becomes W R, and its
translation t becomes

    t' = W (p + t) − p',

where p' is the pelvis of the body that the folder is for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import LEFT_HAND, Pose, Shape, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress
from gva_mi.data.fingerprint import PREPARED, fingerprint
from gva_mi.data.importers.estimators import read_estimator
from gva_mi.data.importers.footage import masks, pictures
from gva_mi.data.importers.in_masks import joints_in_masks
from gva_mi.data.importers.target import Target
from gva_mi.data.importers.tracks import Track, choose, every_frame, one_shape
from gva_mi.data.importers.world import upright
from gva_mi.data.pictures import write_image
from gva_mi.data.video import POSES, save_cameras
from gva_mi.errors import InputError
from gva_mi.files import versions, write_json
from gva_mi.splat import Camera

MARKER = PREPARED  # every folder that was prepared here holds it
# The pelvis of the neutral mean person at rest, metres: what the public models regress.
PELVIS = {
    "SMPL": (-0.0018, -0.2233, 0.0282), "SMPL+H": (-0.0018, -0.2233, 0.0282),
    "SMPL-X": (0.0031, -0.3514, 0.0120),
}  # fmt: skip
_T_CAMERA_WORLD = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Source:
    """Where everything comes from."""

    kind: str  # of the estimator, or "auto"
    estimate: Path  # its file or folder
    frames: Path  # a film, or a folder of pictures
    masks: Path  # a film, a folder of pictures, or a .npy
    person: str | None = None  # the estimator's name of them; without it, who is in the masks
    first: int = 0  # the number that the estimator gave the first frame


def prepare_folder(
    out: Path,
    source: Source,
    body: Target,
    progress: Progress | None = None,
) -> list[str]:
    """Write a subject's folder.

    Args:
        out: an empty folder.
        source: what is read.
        body: whom the poses are for.
        progress: told how many pictures are written.

    Returns:
        What was found and done, for people.

    Raises:
        InputError: what does not fit together: counts, sizes, people.
    """
    where = str(source.estimate)
    size = next(pictures(source.frames, 3)).shape[1::-1]
    kind, tracks = read_estimator(source.kind, source.estimate, size)
    rest = body.model.rest(Shape(torch.zeros(0))).joints.double().numpy()
    there = [np.array(PELVIS[track.form]) for track in tracks]
    votes = lambda: joints_in_masks(tracks, masks(source.masks), source.first, rest, there)
    track, notes = choose(where, tracks, source.person, votes)
    last = int(track.frames.max()) - source.first + 1
    count = _write_pictures(out, source, size, progress, last)
    track = replace(track, frames=track.frames - source.first)
    track, inside, more = every_frame(where, track, count)
    for k in np.flatnonzero(~inside):  # without a mask, a frame belongs to no split
        (out / "masks" / f"{k:06d}.png").unlink(missing_ok=True)
    betas, varied = one_shape(track)
    notes = [f"{kind}, {track.form}, {count} frames of {size[0]}x{size[1]}", *notes, *more, *varied]
    if not body.keeps_betas(track.form):
        betas = np.zeros(10)
        notes.append(f"betas of {track.form} do not carry over to this body; they are zero")
    if track.from_mean_hand:
        track.rotations[:, LEFT_HAND.start :] += body.mean_hands
    if not track.has_hands:
        notes.append("the source has no hands; they are flat")
    shape = Shape(torch.from_numpy(betas.astype(np.float32)))
    save_poses(out / POSES, _pose(track, body.model, shape), shape, stage=1)
    cameras = [Camera.from_matrices(K, _T_CAMERA_WORLD, *size) for K in track.K]
    save_cameras(out / "cameras.npz", cameras)
    notes.append(body.takes_over(track.form))
    about = {"kind": kind, "person": track.person, "form": track.form, "notes": notes}
    about["body"] = {"name": body.name} | fingerprint(body.model)
    write_json(out / MARKER, about | {"source": vars(source), "versions": versions()})
    return notes


def _pose(track: Track, body: BodyModel, shape: Shape) -> Pose:
    """Poses of ``body`` in the world, its pelvis where the source's is."""
    pelvis = body.rest(shape).joints[0].double().numpy()
    there = np.array(PELVIS[track.form])
    rotations, transl = upright(track.rotations, track.transl, "-y", there)
    tensor = lambda x: torch.from_numpy(np.ascontiguousarray(x, np.float32))
    expression = torch.zeros(len(rotations), 10)
    return Pose(tensor(rotations), tensor(transl + there - pelvis), expression)


def _write_pictures(
    out: Path, source: Source, size: tuple[int, int], progress: Progress | None, expected: int
) -> int:
    """Write frames and masks, side by side; returns how many there are."""
    count = 0
    for image, mask in _pairs(source):
        for what, found in (("picture", image), ("mask", mask)):
            if found.shape[1::-1] != size:
                path = source.frames if what == "picture" else source.masks
                raise InputError(
                    f"{path}: {what} {count} is {found.shape[1]}x{found.shape[0]}, expected "
                    f"{size[0]}x{size[1]}"
                )
        write_image(out / "frames" / f"{count:06d}.png", image)
        write_image(out / "masks" / f"{count:06d}.png", mask)
        count += 1
        if progress:
            progress(count, max(count, expected))
    return count


def _pairs(source: Source) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Each picture with its mask."""
    images, cut_outs = pictures(source.frames, 3), masks(source.masks)
    for count, image in enumerate(images):
        mask = next(cut_outs, None)
        if mask is None:
            raise InputError(f"{source.masks}: holds {count} masks, but there are more pictures")
        yield image, mask
    if next(cut_outs, None) is not None:
        raise InputError(f"{source.masks}: holds more masks than there are pictures")
