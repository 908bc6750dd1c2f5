"""A pose estimator's output, or a data set, as a folder that every step reads.

The world is the camera turned upright, half a turn about x, so that y is up and the camera looks
along −z. A body turns about its own pelvis p at rest: the root R of the source becomes W R, and its
translation t becomes

    t' = W (p + t) − p',

where p' is the pelvis of the body that the folder is for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import LEFT_HAND, Pose, Shape, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress
from gva_mi.data.fingerprint import PREPARED, fingerprint
from gva_mi.data.importers.by_networks import write_masks, write_normals
from gva_mi.data.importers.datasets import DATASETS, dataset_of, read_dataset
from gva_mi.data.importers.estimators import read_estimator
from gva_mi.data.importers.footage import masks, pictures, uneven_rate
from gva_mi.data.importers.in_masks import joints_in_masks
from gva_mi.data.importers.lenses import pinhole
from gva_mi.data.importers.mask_values import MaskValues
from gva_mi.data.importers.normal_maps import maps_of, write_maps
from gva_mi.data.importers.other_views import known_names, write_views
from gva_mi.data.importers.prompts import prompts_of
from gva_mi.data.importers.readings import PELVIS, View, through_lens
from gva_mi.data.importers.recorded_lens import RECORDED, asked_for, recorded
from gva_mi.data.importers.recordings import Pictures, Recording, Wanted, read_ranges
from gva_mi.data.importers.target import Target
from gva_mi.data.importers.tracks import Track, choose, every_frame, one_shape
from gva_mi.data.importers.world import upright
from gva_mi.data.networks.normals import Expected, NormalNetwork
from gva_mi.data.networks.segment_anything import SegmentAnything
from gva_mi.data.pictures import write_image
from gva_mi.data.video import POSES, save_cameras
from gva_mi.errors import InputError
from gva_mi.files import versions, write_json
from gva_mi.splat import Camera

MARKER = PREPARED  # every folder that was prepared here holds it
NEARLY = 0.1  # of a focal length's logarithm: nothing is said about less
_T_CAMERA_WORLD = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Source:
    """Where everything comes from."""

    kind: str  # of the estimator or the data set, or "auto"
    estimate: Path  # its file or folder
    frames: Path | None = None  # a film, or a folder of pictures; without it, the data set's own
    masks: Path | None = None  # a film, a folder of pictures, a .npy or a .hdf5; as above
    sam: Path | None = None  # weights of Segment Anything, which makes the masks instead
    normals: Path | None = None  # a folder of maps, or a network that makes the normals
    expected: Expected | None = None  # what these mean, and that network is given
    person: str | None = None  # the estimator's name of them; without it, who is in the masks
    first: int = 0  # the number that the estimator gave the first frame
    focal: float | None = None  # pixels, where the estimate says none
    lens: str | None = None  # that it was filmed with, where the estimator assumed another
    camera: str | None = None  # the name of a data set's camera; without it, the first
    views: Sequence[str] = ()  # names of a data set's other cameras to hold out, or "all"
    view_frames: int = 8  # of each of them, at most
    ranges: Path | None = None  # a file of a protocol's train and test frames


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
    networks = _Networks.of(source)
    kind, recording, size = _recorded(source, body.components)
    tracks, views = recording.tracks, known_names(where, recording, source.views)
    rest = body.model.rest(Shape(torch.zeros(0))).joints.double().numpy()
    there = [np.array(PELVIS[track.form]) for track in tracks]
    votes = lambda: joints_in_masks(tracks, _masks(recording), source.first, rest, there)
    track, notes = choose(where, tracks, source.person, votes if recording.masks else None)
    others = [replace(t, frames=t.frames - source.first) for t in tracks if t is not track]
    track, of_lens = _through_its_lens(track, kind, source, recording, size)
    last = int(track.frames.max()) - source.first + 1
    lens = track.K[0]
    count = _write_pictures(out, recording, lens, size, progress, last)
    track = replace(track, frames=track.frames - source.first)
    if recording.loose and (track.frames >= count).any():
        notes.append(f"{len(track.frames)} poses, but {count} pictures with masks")
        track = track.where(track.frames < count)
    splits = read_ranges(source.ranges, count) if source.ranges else recording.splits
    if splits is not None:
        write_json(out / "splits.json", vars(splits))
    track, inside, more = every_frame(where, track, count)
    for k in np.flatnonzero(~inside):  # without a mask, a frame belongs to no split
        (out / "masks" / f"{k:06d}.png").unlink(missing_ok=True)
    if networks.masks:
        prompts = prompts_of(track, others, rest, size)
        seen = [prompt if inside[k] else None for k, prompt in enumerate(prompts)]
        more += write_masks(out, networks.masks, seen, progress)
    cameras = [Camera.from_matrices(K, _T_CAMERA_WORLD, *size) for K in track.K]
    save_cameras(out / "cameras.npz", cameras)
    if networks.normals:
        more += write_normals(out, networks.normals, count, progress)
    elif source.normals:
        maps = maps_of(source.normals, recording.frames, count, recording.loose)
        straight = _straight(recording, lens, size)
        more += write_maps(out, maps, source.expected.convention, cameras, straight)
    if views:
        asked = (views, np.flatnonzero(inside).tolist(), source.view_frames)
        more += write_views(out, where, recording, *asked, _T_CAMERA_WORLD)
    betas, varied = one_shape(track)
    about = f"{kind}, {track.form}, {count} frames of {size[0]}x{size[1]}"
    notes = [about, *notes, *of_lens, *more, *varied]
    notes += [note for note in (recording.note, uneven_rate(recording.frames)) if note]
    if not body.keeps_betas(track.form):
        betas = np.zeros(10)
        notes.append(f"betas of {track.form} do not carry over to this body; they are zero")
    elif len(betas) > body.model.num_betas:
        betas = betas[: body.model.num_betas]
        notes.append(f"the first {len(betas)} betas are kept, which this body's file has")
    if track.from_mean_hand:
        track.rotations[:, LEFT_HAND.start :] += body.mean_hands
    if not track.has_hands:
        notes.append("the source has no hands; they are flat")
    shape = Shape(torch.from_numpy(betas.astype(np.float32)))
    save_poses(out / POSES, _pose(track, body.model, shape), shape, stage=1)
    notes.append(body.takes_over(track.form))
    record = {"kind": kind, "person": track.person, "form": track.form, "notes": notes}
    record["body"] = {"name": body.name} | fingerprint(body.model)
    write_json(out / MARKER, record | {"source": vars(source), "versions": versions()})
    return notes


@dataclass(frozen=True)
class _Networks:
    """Those that were brought."""

    masks: SegmentAnything | None
    normals: NormalNetwork | None

    @staticmethod
    def of(source: Source) -> _Networks:
        """Read their files, before any work is done."""
        masks = SegmentAnything.load(source.sam) if source.sam else None
        network = source.normals is not None and not source.normals.is_dir()
        normals = NormalNetwork(source.normals, source.expected) if network else None
        return _Networks(masks, normals)


def _through_its_lens(
    track: Track, kind: str, source: Source, recording: Recording, size: tuple[int, int]
) -> tuple[Track, list[str]]:
    """A person through the lens that the video was filmed with, and what to say about it."""
    if kind in DATASETS:  # which know their lenses
        if source.lens is not None:
            raise InputError(
                f"prepare: --lens is for a pose estimator's output; {kind} has its own"
            )
        return track, []
    known = recorded(recording.frames, size)
    assumed = float(np.median(np.sqrt(track.K[:, 0, 0] * track.K[:, 1, 1])))
    if source.lens is None:
        if known is None or abs(np.log(known / assumed)) < NEARLY:
            return track, []
        return track, [
            f"the poses are for a focal length of {assumed:.0f} pixels; the recording says "
            f"{known:.0f}, or up to a fifth more if it was stabilised: --lens {RECORDED} takes it"
        ]
    focal = asked_for(source.lens, known, size)
    moved = f"people stand {focal / assumed:.3g} times as far away"
    return through_lens(track, focal), [
        f"the focal length is {focal:.0f} pixels, where the estimator took {assumed:.0f}: {moved}"
    ]


def _pose(track: Track, body: BodyModel, shape: Shape) -> Pose:
    """Poses of ``body`` in the world, its pelvis where the source's is."""
    pelvis = body.rest(shape).joints[0].double().numpy()
    there = np.array(PELVIS[track.form])
    rotations, transl = upright(track.rotations, track.transl, "-y", there)
    tensor = lambda x: torch.from_numpy(np.ascontiguousarray(x, np.float32))
    expression = torch.zeros(len(rotations), 10)
    return Pose(tensor(rotations), tensor(transl + there - pelvis), expression)


def _recorded(
    source: Source, components: np.ndarray | None
) -> tuple[str, Recording, tuple[int, int]]:
    """The kind of a source, what it holds, and the size of its pictures."""
    path, kind = source.estimate, source.kind
    found = dataset_of(path) if kind == "auto" and path.is_dir() else None
    kind = found or kind
    recording = Recording([], source.frames, source.masks)
    if kind in DATASETS and source.lens is not None:
        raise InputError(f"prepare: --lens is for pose estimators; {kind} knows its cameras")
    if kind in DATASETS:
        recording = read_dataset(kind, path, Wanted(source.camera, components))
        frames, cut_outs = source.frames or recording.frames, source.masks or recording.masks
        recording = replace(recording, frames=frames, masks=None if source.sam else cut_outs)
    for name, given in (("frames", recording.frames), ("masks", recording.masks or source.sam)):
        if given is None:
            raise InputError(f"{path}: brings no {name} of its own; give --{name}")
    image = next(pictures(recording.frames, 3), None)
    if image is None:
        raise InputError(f"{path}: no picture of it is there")
    size = image.shape[1::-1]
    if kind not in DATASETS:
        kind, tracks = read_estimator(kind, path, View(size, source.focal, components))
        recording = replace(recording, tracks=tracks)
    return kind, recording, size


def _write_pictures(
    out: Path,
    recording: Recording,
    K: np.ndarray,
    size: tuple[int, int],
    progress: Progress | None,
    expected: int,
) -> int:
    """Write frames and masks, side by side; returns how many there are."""
    count, values = 0, MaskValues()
    straight = _straight(recording, K, size) or (lambda image: image)
    for image, mask in _pairs(recording):
        for what, found in (("picture", image), ("mask", mask)):
            if found is not None and found.shape[1::-1] != size:
                path = _name(recording.frames if what == "picture" else recording.masks)
                raise InputError(
                    f"{path}: {what} {count} is {found.shape[1]}x{found.shape[0]}, expected "
                    f"{size[0]}x{size[1]}"
                )
        write_image(out / "frames" / f"{count:06d}.png", straight(image))
        if mask is not None:
            values.see(mask)
            write_image(out / "masks" / f"{count:06d}.png", straight(mask))
        count += 1
        if progress:
            progress(count, max(count, expected))
    if recording.masks is not None:
        values.require_person(str(_name(recording.masks)))
    return count


def _straight(
    recording: Recording, K: np.ndarray, size: tuple[int, int]
) -> Callable[[np.ndarray], np.ndarray] | None:
    """What takes the lens's distortion out of a picture; None: there is none."""
    if recording.distortion is None or not np.any(recording.distortion):
        return None
    return pinhole(_name(recording.frames), K, recording.distortion, size)


def _pairs(recording: Recording) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
    """Each picture with its mask; None where the recording has no masks."""
    if recording.masks is None:
        yield from ((image, None) for image in pictures(recording.frames, 3))
        return
    images, cut_outs = pictures(recording.frames, 3), _masks(recording)
    where = _name(recording.masks)
    for count, image in enumerate(images):
        mask = next(cut_outs, None)
        if mask is None and recording.loose:
            return
        if mask is None:
            raise InputError(f"{where}: holds {count} masks, but there are more pictures")
        yield image, mask
    if next(cut_outs, None) is not None and not recording.loose:
        raise InputError(f"{where}: holds more masks than there are pictures")


def _masks(recording: Recording) -> Iterator[np.ndarray]:
    """The masks, 255 inside the person, whatever the data set means by its numbers."""
    for mask in masks(recording.masks):
        mask = (mask > 0) * np.uint8(255) if recording.labels else mask
        yield 255 - mask if recording.around else mask


def _name(source: Pictures) -> Path:
    """A source of pictures, for an error."""
    return source[0].parent if isinstance(source, tuple) else source
