"""Stage 1 of a video: make a subject's folder with pictures, masks, landmarks, poses and camera.

:func:`motion_of_video` finds the motion, and :func:`prepare_video` writes the folder. Beside the
files of every subject (:mod:`gva_mi.subject.video`) the folder holds

::

    landmarks.npz      what the networks saw: gva_mi.subject.landmarks
    prepare.json       kind "video", and the fields of Stage1Record under "video"
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from gva_mi.body.smplx import BUILT_IN_NAME, BodyModel, load_body
from gva_mi.core.console import Progress, listed, part_of_progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json
from gva_mi.core.options import Within, from_json, options_of
from gva_mi.core.spill_cache import SpillCache
from gva_mi.core.tasks import on_all_cores
from gva_mi.matting.masks import video_masks
from gva_mi.networks.segment_anything import Prompt
from gva_mi.networks.video_landmarks import WatchedVideo, watch_video
from gva_mi.observe.landmark_noise import misplaced_frames
from gva_mi.observe.swaps import fix_front_back
from gva_mi.prior.body_height import PERSON_HEIGHTS
from gva_mi.readers.keypoints import read_keypoints, with_keypoints
from gva_mi.readers.own_masks import MaskOptions, WithMasks, write_masks, write_own_masks
from gva_mi.readers.people import prompt_at
from gva_mi.stage1.face import with_face
from gva_mi.stage1.pictures import EvenPictures, even_pictures
from gva_mi.stage1.solver import KnownParameters, Stage1Solution, solve_stage1
from gva_mi.stage1.vertical_lines import find_vertical
from gva_mi.subject.fingerprint import VIDEO_KIND, fingerprint
from gva_mi.subject.folder import FRAMES, MASKS, PREPARED, StoredPictures, SubjectWriter
from gva_mi.subject.footage import mask_meaning
from gva_mi.subject.lens import asked_for, in_pixels
from gva_mi.subject.pictures import in_8_bits
from gva_mi.subject.silhouettes import doubt_in
from gva_mi.subject.splits import Splits

_MISPLACED = (
    "frames where the network misplaced the person, who seems to be larger or smaller than in the "
    "frames around; what it saw there is not used"
)
_UNKNOWN_FOCAL = (
    "the video does not record its focal length: a field of view is assumed and fitted, so "
    "distances and depth may be off by a fifth; --lens 26mm sets the value of the phone's data "
    "sheet"
)
_NO_VERTICAL_LINES = (
    "no vertical lines beside the person, such as the edges of a door or a shelf: how far the "
    "camera looks down is a guess, and the person may lean toward it by some degrees; "
    "--camera-height 0.9 sets the height of the lens above the floor, in metres"
)


@options_of("video")
class VideoSource:
    """What is known of a video, and which part of it is used."""

    # The person's height, metres. Without it an average height is assumed, so the height and all
    # distances are uncertain by 5 percent.
    height: Annotated[float, PERSON_HEIGHTS] | None = None
    # Height of the lens above the floor, metres: it shows how far the camera looks down.
    camera_height: Annotated[float, Within(0.05, 20, unit="metres")] | None = None
    # End of the part that is used, seconds, such as before a damaged picture.
    end: Annotated[float, Within(0, 86_400, "low", "seconds")] | None = None


@options_of("video")
class PrepareVideoOptions(VideoSource):
    """Options of the preparation of a video."""

    # The shorter side of the pictures, to which larger ones are scaled down.
    side: Annotated[int, Within(64, 4320, unit="pixels")] = 1080
    # Keypoints of OpenPose, MMPose or AlphaPose, a file or folder, of all frames of the video. They
    # replace the pixels of the network's landmarks.
    keypoints: Path | None = None
    # Frames a second that are used, about 30 without it: the nearest rate that every n-th frame
    # gives. For a folder of pictures, their rate.
    fps: Annotated[float, Within(1, 240)] | None = None


@dataclass(frozen=True)
class Stage1Record:
    """What later steps and the report know of a prepared video; part of ``prepare.json``."""

    frames: int
    fps: float
    height: float | None  # as given, metres
    focal_known: bool  # given by the user or recorded in the video
    tilt: float  # degrees that the camera looks down
    crowded: list[int]  # frames with several people
    notes: list[str]

    @staticmethod
    def load(subject: Path) -> Stage1Record:
        """Read the record of a prepared video.

        Raises:
            InputError: the subject was not prepared from a video.
        """
        path = subject / PREPARED
        expected = "what `gva-mi prepare video` writes"
        record = read_json(path, expected)
        with expecting(path, expected):
            return from_json(Stage1Record, record["video"])


@dataclass(frozen=True)
class SolvedMotion:
    """The motion of a person in a video, and the data it was solved from."""

    pictures: EvenPictures
    watched: WatchedVideo
    solved: Stage1Solution
    focal_known: bool
    tilt_known: bool  # whether lines or the camera's height say how far the camera looks down

    @property
    def notes(self) -> list[str]:
        """Sentences for the user on what was found and assumed."""
        notes = [*self.pictures.notes, *self.watched.notes]
        if not self.focal_known:
            notes.append(_UNKNOWN_FOCAL)
        if not self.tilt_known:
            notes.append(_NO_VERTICAL_LINES)
        return notes

    def prompts(self, body: BodyModel) -> list[Prompt | None]:
        """Return where the person is in each picture, for a mask network; None without them."""
        size = self.pictures.pictures[0].shape[1::-1]
        joints = body(self.solved.pose, self.solved.shape).joints.detach().double().numpy()
        seen = np.isfinite(self.watched.landmarks.pixels).any((1, 2))
        project = self.solved.camera.project
        return [
            prompt_at(project(x), (), size) if shown else None
            for x, shown in zip(joints, seen, strict=True)
        ]


def motion_of_video(
    video: Path,
    options: PrepareVideoOptions,
    body: BodyModel,
    *,
    person: int | None = None,
    lens: str | None = None,
    on_silhouette: Callable[[int, np.ndarray], None] | None = None,
    progress: Progress | None = None,
) -> SolvedMotion:
    """Find the motion of one person in a video: networks, then stage 1.

    Args:
        video: a video file, or a folder of its pictures.
        options: of the preparation.
        body: of the poses.
        person: the N-th from the left if there are several people; None: the largest.
        lens: a focal length as ``--lens`` takes it; None: as recorded in the video, else fitted.
        on_silhouette: see :func:`watch_video`; called again, with zeros, for pictures in which the
            network misplaced the person.
        progress: called as the work goes on.
    """
    pictures = even_pictures(video, options.fps, options.side, options.end)
    size = pictures.pictures[0].shape[1::-1]
    recorded = in_pixels(pictures.focal35, size) if pictures.focal35 else None
    focal = recorded if lens is None else asked_for(lens, recorded, size)
    if options.keypoints is not None:
        read_keypoints(options.keypoints)  # a bad file is refused before the networks work
    part = part_of_progress(progress, 0, 4, 5)
    watched = watch_video(pictures.pictures, on_silhouette, person, part)
    if options.keypoints is not None:
        landmarks, said = with_keypoints(
            watched.landmarks, options.keypoints, pictures.numbers, pictures.scale
        )
        watched = replace(watched, landmarks=landmarks, notes=(*watched.notes, *said))
    if misplaced := misplaced_frames(watched.landmarks):
        watched = replace(
            watched,
            landmarks=watched.landmarks.without(misplaced),
            notes=(*watched.notes, f"{_MISPLACED}: {listed(misplaced)}"),
        )
        for k in misplaced if on_silhouette else ():
            on_silhouette(k, np.zeros(size[::-1], np.float32))
    landmarks, backs = fix_front_back(watched.landmarks, pictures.fps)
    if backs:
        said = f"frames where the network took the back for the front: {listed(backs)}; corrected"
        watched = replace(watched, landmarks=landmarks, notes=(*watched.notes, said))
    known = KnownParameters(options.height, focal, camera_height=options.camera_height)
    lines = find_vertical(pictures.pictures, watched.landmarks, known.K(size))
    known = replace(known, lines=lines)
    solved = solve_stage1(
        watched.landmarks, body, size, pictures.fps, known, part_of_progress(progress, 4, 1, 5)
    )
    solved, of_face = with_face(solved, watched.landmarks, body, pictures.fps)
    watched = replace(watched, notes=[*watched.notes, *of_face])
    tilt_known = lines is not None or options.camera_height is not None
    return SolvedMotion(pictures, watched, solved, focal is not None, tilt_known)


def prepare_video(
    out: Path,
    video: Path,
    options: PrepareVideoOptions,
    body: Path | None = None,
    *,
    person: int | None = None,
    lens: str | None = None,
    own_masks: MaskOptions = MaskOptions(),  # noqa: B008 (frozen)
    progress: Progress | None = None,
) -> list[str]:
    """Write a subject's folder of a video; return notes on what was found and done.

    Args:
        out: an empty folder.
        video: a video file, or a folder of its pictures.
        options: of the preparation.
        body: file of the body that poses are for; None: the built-in body.
        person: the N-th from the left if there are several people; None: the largest.
        lens: a focal length as ``--lens`` takes it; None: as recorded in the video, else fitted.
        own_masks: masks of the user, or a network that helps to find them.
        progress: called as the work goes on.
    """
    model, network = load_body(body), own_masks.mask_network()
    given = own_masks.masks if network is None else None
    if given is not None:
        mask_meaning(given)  # an unreadable folder is refused before any work
    writer = SubjectWriter(out)
    with tempfile.TemporaryDirectory(dir=out, prefix=".") as folder:
        rough = SpillCache(out, 0)
        keep = lambda k, probability: rough.__setitem__(k, in_8_bits(probability))
        motion = motion_of_video(
            video, options, model, person=person, lens=lens, on_silhouette=keep,
            progress=part_of_progress(progress, 0, 6, 10),
        )  # fmt: skip
        pictures = motion.pictures.pictures
        write = lambda numbered: writer.frame(*numbered)
        count = len(list(on_all_cores(write, enumerate(pictures))))
        stored = StoredPictures(out / FRAMES, count)
        more = part_of_progress(progress, 6, 4, 10)
        if given is not None:
            used, size = motion.pictures, pictures[0].shape[1::-1]
            notes = write_own_masks(writer, given, used.numbers, used.total, size, rough, more)
        else:
            probabilities, notes = rough, []
            if network is not None:
                guesses = SubjectWriter(Path(folder))
                picture, prompts = stored.__getitem__, motion.prompts(model)
                notes = write_masks(guesses, network, picture, prompts)
                probabilities = WithMasks(rough, guesses.folder / MASKS)
            notes += video_masks(stored, probabilities, motion.watched.landmarks, writer, more)
    solved, shown = motion.solved, np.isfinite(motion.watched.landmarks.pixels).any((1, 2))
    cameras = [solved.camera] * len(pictures)
    doubt = doubt_in(out, np.flatnonzero(shown), solved.pose, cameras, solved.shape, model)
    record = Stage1Record(
        frames=len(pictures),
        fps=motion.pictures.fps,
        height=options.height,
        focal_known=motion.focal_known,
        tilt=float(solved.tilt),
        crowded=list(motion.watched.crowded),
        notes=[*motion.notes, *notes, *([doubt] if doubt else [])],
    )
    _write_subject(writer, motion, record, body, model)
    return record.notes


def _write_subject(
    writer: SubjectWriter,
    motion: SolvedMotion,
    record: Stage1Record,
    body: Path | None,
    model: BodyModel,
) -> None:
    """Write poses, cameras, landmarks, splits and the record."""
    solved = motion.solved
    writer.poses(solved.pose, solved.shape, stage=1)
    writer.cameras([solved.camera] * record.frames)
    writer.landmarks(motion.watched.landmarks)
    writer.splits(Splits.of_video(record.frames).to_json())
    file = None if body is None else str(body.resolve())
    name = BUILT_IN_NAME if body is None else body.stem
    about = {"kind": VIDEO_KIND, "video": asdict(record)}
    about["body"] = {"name": name, "file": file} | fingerprint(model)
    writer.record(PREPARED, about)
