"""Make a subject's folder from a pose estimator's output, or from a data set.

The world is the camera turned upright, half a turn about x, so that y is up and the camera looks
along −z. A body turns about its own pelvis p at rest: the root R of the source becomes W R, and its
translation t becomes

    t' = W (p + t) − p',

where p' is the pelvis of the target body. Both pelvises are at rest and have the person's betas
(:meth:`gva_mi.readers.target_body.TargetBody.pelvises`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BUILT_IN_NAME
from gva_mi.core.console import Progress
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.options import options_of
from gva_mi.networks.normals import NormalNetwork, NormalsSpec
from gva_mi.readers.datasets import (
    DATASETS,
    Capture,
    dataset_of,
    known_names,
    read_dataset,
    write_views,
)
from gva_mi.readers.estimators import KINDS, VideoInfo, read_estimator
from gva_mi.readers.own_masks import MaskOptions, write_masks, write_normals
from gva_mi.readers.people import choose, joints_in_masks, prompts_of
from gva_mi.readers.target_body import TargetBody
from gva_mi.readers.track import Track, every_frame, filmed_with, median_betas
from gva_mi.readers.up_axis import upright
from gva_mi.splat import Camera
from gva_mi.subject import footage
from gva_mi.subject.fingerprint import fingerprint
from gva_mi.subject.folder import FRAMES, PREPARED, SubjectWriter, frame_name
from gva_mi.subject.footage import first_number
from gva_mi.subject.lens import asked_for, recorded, rescaled, undistort
from gva_mi.subject.masks import require_person
from gva_mi.subject.normals import Convention
from gva_mi.subject.pictures import read_image, require_sides
from gva_mi.subject.silhouettes import doubt_in

_T_CAMERA_WORLD = np.diag([1.0, -1.0, -1.0, 1.0])  # half a turn about x


@options_of("prepare")
class PrepareOptions(MaskOptions):
    """Options of ``prepare`` beside the source."""

    # The body of the poses and of all later steps, in SMPL-X's format; or the word built-in for the
    # built-in one, which keeps rotations and no shape, and is a video's default.
    body: Path | None = None
    frames: Path | None = None  # a video, or a folder of pictures; a data set has its own
    # The estimator's name of the person; without it, chosen by the masks. Of a phone video the
    # number from the left; without it, the largest.
    person: str | None = None
    # True focal length: in pixels; of 35 mm film, such as 26mm; or recorded, the value in the
    # video's file. If the estimator assumed another, the person moves so that the picture stays the
    # same.
    lens: str | None = None
    camera: str | None = None  # the name of a data set's camera; without it, the first
    # Names of a data set's other cameras, whose pictures are held out as novel views for evaluate;
    # or all.
    views: tuple[str, ...] = ()
    # A network, .onnx, that takes pictures (1, 3, h, w) and answers with normals.
    normals: Path | None = None
    # Axes and view of the network's output; icon: a square crop.
    normals_convention: Convention | None = None

    def __post_init__(self) -> None:
        if self.normals is not None and self.normals_convention is None:
            raise InputError(
                "prepare: --normals needs --normals-convention, what its normals mean: "
                f"{', '.join(get_args(Convention))}"
            )

    def normal_network(self) -> NormalNetwork | None:
        """Return the network that makes the normals, read before any work is done."""
        spec = NormalsSpec(self.normals_convention)
        return None if self.normals is None else NormalNetwork(self.normals, spec)


def prepare_folder(
    out: Path,
    kind: str,
    source: Path,
    options: PrepareOptions,
    body: TargetBody,
    progress: Progress | None = None,
) -> list[str]:
    """Write a subject's folder, and return notes on what was found and done.

    Args:
        out: an empty folder.
        kind: the estimator or the data set that wrote ``source``; "auto" recognises it.
        source: a file or a folder.
        options: of the command.
        body: the body that the poses are converted to.
        progress: called after each picture.
    """
    where = str(source)
    mask_network, normal_network = options.mask_network(), options.normal_network()
    body = body.for_source(source)
    kind, capture, size = _capture(kind, source, options, mask_network is not None, body)
    capture, of_numbers = _numbered(kind, capture)
    votes = lambda: joints_in_masks(capture.tracks, capture.read_masks(), body.joints)
    track, notes = choose(where, capture.tracks, options.person, votes if capture.masks else None)
    views, notes = known_names(where, capture, options.views), [*notes, *of_numbers]
    others = [t for t in capture.tracks if t is not track]
    of_lens = []
    if kind not in DATASETS:  # data sets know their lenses
        track, of_lens = filmed_with(track, options.lens, capture.frames, size)
    straight = undistort(footage.folder_of(capture.frames), track.K[0], capture.distortion, size)
    writer = SubjectWriter(out)
    count = _write_pictures(writer, capture, straight, size, progress, int(track.frames.max()) + 1)
    if capture.counts_may_differ and (track.frames >= count).any():
        notes.append(f"{len(track.frames)} poses, but {count} pictures with masks")
        track = track.where(track.frames < count)
    track, inside, more = every_frame(where, track, count)
    for k in np.flatnonzero(~inside):  # without a mask, a frame belongs to no split
        writer.remove_mask(k)
    if mask_network:
        prompts = prompts_of(track, others, body.joints, size)
        seen = [prompt if inside[k] else None for k, prompt in enumerate(prompts)]
        picture = lambda k: read_image(out / FRAMES / frame_name(k), 3)
        more += write_masks(writer, mask_network, picture, seen, progress)
    with expecting(where, "the K of a pinhole, without skew"):
        cameras = [Camera.from_matrices(K, _T_CAMERA_WORLD, *size) for K in track.K]
    writer.cameras(cameras)
    pose, shape, of_body = _poses(track, body)
    if normal_network:
        more += write_normals(writer, normal_network, count, progress)
    if views:
        seen = np.flatnonzero(inside).tolist()
        more += write_views(writer, where, capture, views, seen, _T_CAMERA_WORLD)
    about = f"{kind}, {track.form}, {count} frames of {size[0]}x{size[1]}"
    writer.poses(pose, shape, stage=1)
    notes = [about, *notes, *of_lens, *more, *of_body]
    notes += _doubts(out, np.flatnonzero(inside), pose, shape, cameras, body)
    notes += [*([capture.note] if capture.note else []), *footage.notes_of(capture.frames)]
    record = {"kind": kind, "person": track.person, "form": track.form, "notes": notes}
    file = None if body.name == BUILT_IN_NAME else str(options.body.resolve())
    record["body"] = {"name": body.name, "file": file} | fingerprint(body.model)
    record["source"] = {"kind": kind, "estimate": source} | vars(options)
    writer.record(PREPARED, record)
    return notes


def _capture(
    kind: str, source: Path, options: PrepareOptions, makes_masks: bool, body: TargetBody
) -> tuple[str, Capture, tuple[int, int]]:
    """Return the kind of a source, its people and pictures, and the pictures' size.

    ``makes_masks`` says that a network makes the masks.
    """
    if not source.exists():
        raise InputError(f"{source}: no such file or folder; expected poses or a data set")
    if kind == "auto" and source.is_dir():
        kind = dataset_of(source) or kind
    if kind in DATASETS and options.lens is not None:
        raise InputError(f"prepare: --lens is for pose estimators; {kind} knows its cameras")
    if kind in DATASETS:
        capture = read_dataset(kind, source, options.camera, body)
    else:
        capture = Capture([], options.frames, None)
    frames, masks = options.frames or capture.frames, options.masks or capture.masks
    for name, given in (("frames", frames), ("masks", masks)):
        if given is None:
            raise InputError(f"{source}: brings no {name} of its own; give --{name}")
    capture = replace(capture, frames=frames, masks=None if makes_masks else masks)
    image = next(footage.pictures(frames, 3), None)
    if image is None:
        raise InputError(f"{source}: holds no picture")
    size = image.shape[1::-1]
    if capture.size:
        fitted = lambda K: rescaled(str(source), K, capture.size, size)
        capture = replace(capture, tracks=[replace(t, K=fitted(t.K)) for t in capture.tracks])
    if kind not in DATASETS:
        lens = options.lens
        focal = None if lens is None else asked_for(lens, recorded(frames, size), size)
        kind, tracks = read_estimator(kind, source, VideoInfo(size, focal, body))
        capture = replace(capture, tracks=tracks)
    if capture.masks is not None and capture.meaning is None:  # decided once for all
        capture = replace(capture, meaning=footage.mask_meaning(capture.masks))
    return kind, capture, size


def _numbered(kind: str, capture: Capture) -> tuple[Capture, list[str]]:
    """Return the capture with its people's frames numbered from 0, and notes."""
    if kind in DATASETS or not capture.tracks:
        return capture, []
    names = footage.files_of(capture.frames)
    frames = np.concatenate([track.frames for track in capture.tracks])
    count = footage.count_of(capture.frames)
    first = first_number(frames, count, KINDS[kind].first_number, names)
    moved = [replace(track, frames=track.frames - first) for track in capture.tracks]
    return replace(capture, tracks=moved), [f"frames are numbered from {first}"] if first else []


def _write_pictures(
    writer: SubjectWriter,
    capture: Capture,
    straight: Callable[[np.ndarray], np.ndarray] | None,
    size: tuple[int, int],
    progress: Progress | None,
    expected: int,
) -> int:
    """Write frames and masks into their folders; return the number of frames."""
    count, values = 0, np.zeros(256, np.int64)
    straight = straight or (lambda image: image)
    for image, mask in _pairs(capture):
        for what, found in (("picture", image), ("mask", mask)):
            if found is not None:
                path = footage.folder_of(capture.frames if what == "picture" else capture.masks)
                require_sides(f"{path}: {what} {count}", found, *size)
        writer.frame(count, straight(image))
        if mask is not None:
            values += np.bincount(mask.ravel(), minlength=256)
            writer.mask(count, straight(mask))
        count += 1
        if progress:
            progress(count, max(count, expected))
    if capture.masks is not None:
        require_person(str(footage.folder_of(capture.masks)), values)
    return count


def _pairs(capture: Capture) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
    """Yield each picture with its mask; None without masks."""
    images = footage.pictures(capture.frames, 3)
    if capture.masks is None:
        yield from ((image, None) for image in images)
        return
    where, masks = footage.folder_of(capture.masks), capture.read_masks()
    for count, image in enumerate(images):
        mask = next(masks, None)
        if mask is None and capture.counts_may_differ:
            return
        if mask is None:
            raise InputError(f"{where}: holds {count} masks, but there are more pictures")
        yield image, mask
    if next(masks, None) is not None and not capture.counts_may_differ:
        raise InputError(f"{where}: holds more masks than there are pictures")


def _poses(track: Track, body: TargetBody) -> tuple[Pose, Shape, list[str]]:
    """Return poses in the world, with the pelvis where the source's is, shape, and notes."""
    betas, notes = median_betas(track.betas)
    notes = [*track.notes, *notes]
    count, own = len(track.rotations), body.keeps_betas(track.form)
    expression = np.zeros((count, 10))
    if not own:
        betas = np.zeros(10)
        if track.betas is not None:
            notes.append(f"betas of {track.form} do not carry over to this body; they are zero")
        if track.of_mean:
            notes.append(
                f"the pelvis is the mean person's, because the source's {track.form} body is not "
                "given: betas move it by up to some centimetres"
            )
    elif len(betas) > body.model.num_betas:
        betas = betas[: body.model.num_betas]
        notes.append(f"the first {len(betas)} betas are kept, which this body's file has")
    if track.expression is not None:
        expression, note = body.expression(track.form, track.expression)
        notes += note
    if not track.has_hands:
        notes.append("the source has no hands; they are flat")
    shape = Shape(torch.from_numpy(betas.astype(np.float32)))
    rotations = track.with_flat_hands(body.mean_hands).rotations
    rotations, places = upright(rotations, track.places, "-y")
    places = places - body.pelvises(body.form, betas)
    pose = Pose.of_arrays(rotations, places, expression)
    notes.append(
        f"for the body {body.name}: rotations, place and betas are the source's own" if own else
        f"retargeted to the body {body.name}: rotations and the pelvis's place are the source's; "
        "lengths of limbs and shape are this body's"
    )  # fmt: skip
    return pose, shape, notes


def _doubts(
    out: Path, frames: np.ndarray, pose: Pose, shape: Shape, cameras: list[Camera], body: TargetBody
) -> list[str]:
    """Return a warning if the person, in some of the frames, may not lie in the masks."""
    doubt = doubt_in(out, frames, pose, cameras, shape, body.model)
    if doubt is None:
        return []
    return [
        f"{doubt}: are the poses in world and not in camera axes, or of another person, or "
        "the masks of another video? gva-mi check of the subject's folder looks for the cause"
    ]
