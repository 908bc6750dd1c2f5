"""Make a subject's folder of a video and nothing else: pictures, masks, landmarks, poses, camera.

Beside the files of every subject (:mod:`gva_mi.subject.video`) it holds

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
from gva_mi.core.files import read_array, read_json
from gva_mi.core.options import PythonOnly, Within, from_json, options_of
from gva_mi.core.stamp import write_record
from gva_mi.core.tasks import on_all_cores
from gva_mi.matting.masks import video_masks
from gva_mi.networks.segment_anything import Prompt
from gva_mi.networks.watch import WatchedVideo, watch_video
from gva_mi.observe.swaps import with_backs
from gva_mi.prior.stature import PERSON_HEIGHTS
from gva_mi.readers.keypoints import with_keypoints
from gva_mi.readers.own_masks import MaskOptions, WithMasks, write_masks, write_own_masks
from gva_mi.readers.people import prompt_at
from gva_mi.stage1.face import with_face
from gva_mi.stage1.pictures import EvenPictures, even_pictures
from gva_mi.stage1.solver import KnownOfVideo, Stage1Solution, solve_stage1
from gva_mi.stage1.upright import vertical_of
from gva_mi.subject.fingerprint import VIDEO_KIND, fingerprint
from gva_mi.subject.folder import FRAMES, MASKS, PREPARED, StoredPictures, SubjectWriter
from gva_mi.subject.footage import mask_meaning
from gva_mi.subject.lens import asked_for, in_pixels
from gva_mi.subject.pictures import in_8_bits, read_image
from gva_mi.subject.splits import Splits

_LENS = (
    "the video does not say its focal length: a field of view is assumed and fitted, so distances "
    "and depth may be off by a fifth; --lens 26mm gives what the phone's data sheet says"
)
_LINES = (
    "no upright lines beside the person, such as those of a door or a shelf: how far the camera "
    "looks down is a guess, and the person may lean toward it by some degrees; --camera-height 0.9 "
    "says how high the lens stood, in metres"
)


@options_of("video")
class RecordingSource:
    """What is known of a video, and which part of it is used."""

    # The person's height, metres; without it, that of an average person, uncertain by 5 percent,
    # and so are all distances.
    height: Annotated[float, PERSON_HEIGHTS] | None = None
    # Height of the lens above the floor, metres: it shows how far the camera looks down.
    camera_height: Annotated[float, Within(0.05, 20, unit="metres")] | None = None
    # Where the used part of the video starts, and where it ends; None: with the video.
    start: PythonOnly[Annotated[float, Within(0, 86_400, unit="seconds")]] = 0.0
    end: PythonOnly[Annotated[float, Within(0, 86_400, "low", "seconds")] | None] = None
    # Folder of the networks' files; None: GVA_MI_WEIGHTS or the cache, which pip fills.
    weights: PythonOnly[Path | None] = None


@options_of("video")
class RecordingOptions(RecordingSource):
    """Options of a video."""

    # The shorter side of the pictures, to which larger ones are scaled down.
    side: Annotated[int, Within(64, 4320, unit="pixels")] = 1080
    # Keypoints of OpenPose, MMPose or AlphaPose, a file or folder, of all frames of the video. They
    # take the place of the network's landmarks in the pictures.
    keypoints: Path | None = None
    # Frames a second that are used, as near as every n-th one comes; about 30 without it. Of a
    # folder of pictures, their rate.
    fps: Annotated[float, Within(1, 240)] | None = None


@dataclass(frozen=True)
class Stage1Record:
    """What later steps and the report know of a video."""

    frames: int
    fps: float
    height: float | None  # as given, metres
    focal_known: bool  # by the user or the video
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


def prepare_video(
    out: Path,
    recording: Path,
    options: RecordingOptions,
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
        recording: a video file, or a folder of its pictures.
        options: of the video.
        body: file of the body that poses are for; None: the built-in body.
        person: the N-th from the left where there are several; None: the largest.
        lens: a focal length as ``--lens`` takes it; None: what the video records, else fitted.
        own_masks: the user's, or the network that helps to find them.
        progress: called as the work goes on.
    """
    model, network = load_body(body), own_masks.mask_network()
    given = own_masks.masks if network is None else None
    if given is not None:
        mask_meaning(given)  # what cannot be read is refused before any work
    writer = SubjectWriter(out)
    with tempfile.TemporaryDirectory(dir=out, prefix=".") as folder:
        rough = StoredPictures(Path(folder), ".npy", read_array)
        keep = lambda k, probability: np.save(rough.path(k), in_8_bits(probability))
        motion = motion_of_video(
            recording, options, model, person=person, lens=lens, on_silhouette=keep,
            progress=part_of_progress(progress, 0, 6, 10),
        )  # fmt: skip
        pictures = motion.pictures.pictures
        stored = StoredPictures(out / FRAMES, ".png", lambda path: read_image(path, 3))
        write = lambda numbered: writer.frame(*numbered)
        rough.count = stored.count = len(list(on_all_cores(write, enumerate(pictures))))
        more = part_of_progress(progress, 6, 4, 10)
        if given is not None:
            numbers, size = motion.pictures.numbers, pictures[0].shape[1::-1]
            notes = write_own_masks(writer, given, numbers, size, rough, more)
        else:
            probabilities, notes = rough, []
            if network is not None:
                guesses = SubjectWriter(Path(folder))
                picture, prompts = stored.__getitem__, motion.prompts(model)
                notes = write_masks(guesses, network, picture, prompts)
                probabilities = WithMasks(rough, guesses.folder / MASKS)
            notes += video_masks(stored, probabilities, writer, more)
    solved, watched = motion.solved, motion.watched
    writer.poses(solved.pose, solved.shape, stage=1)
    writer.cameras([solved.camera] * len(pictures))
    writer.landmarks(watched.landmarks)
    writer.splits(Splits.of_video(len(pictures)).to_json())
    record = Stage1Record(
        frames=len(pictures),
        fps=motion.pictures.fps,
        height=options.height,
        focal_known=motion.focal_known,
        tilt=float(solved.tilt),
        crowded=list(watched.crowded),
        notes=[*motion.notes, *notes],
    )
    file = None if body is None else str(body.resolve())
    name = BUILT_IN_NAME if body is None else body.stem
    about = {"kind": VIDEO_KIND, "video": asdict(record)}
    about["body"] = {"name": name, "file": file} | fingerprint(model)
    write_record(out / PREPARED, about)
    return record.notes


@dataclass(frozen=True)
class SolvedMotion:
    """The person's motion in a video, and what it was solved from."""

    pictures: EvenPictures
    watched: WatchedVideo
    solved: Stage1Solution
    focal_known: bool
    upright: bool  # whether lines or the camera's height say how far it looks down

    @property
    def notes(self) -> list[str]:
        """What a user should know."""
        notes = [*self.pictures.notes, *self.watched.notes]
        if not self.focal_known:
            notes.append(_LENS)
        if not self.upright:
            notes.append(_LINES)
        return notes

    def prompts(self, body: BodyModel) -> list[Prompt | None]:
        """Return where the person is in each picture, for a network of masks."""
        size = self.pictures.pictures[0].shape[1::-1]
        joints = body(self.solved.pose, self.solved.shape).joints.detach().double().numpy()
        seen = np.isfinite(self.watched.landmarks.pixels).any((1, 2))
        where = self.solved.camera.project
        return [
            prompt_at(where(x), (), size) if shown else None
            for x, shown in zip(joints, seen, strict=True)
        ]


def motion_of_video(
    recording: Path,
    options: RecordingOptions,
    body: BodyModel,
    *,
    person: int | None = None,
    lens: str | None = None,
    on_silhouette: Callable[[int, np.ndarray], None] | None = None,
    progress: Progress | None = None,
) -> SolvedMotion:
    """Find the motion of one person in a video: networks, then stage 1.

    Args:
        recording: a video file, or a folder of its pictures.
        options: of the video.
        body: of the poses.
        person: the N-th from the left where there are several; None: the largest.
        lens: a focal length as ``--lens`` takes it; None: what the video records, else fitted.
        on_silhouette: see :func:`watch_video`.
        progress: called as the work goes on.
    """
    pictures = even_pictures(recording, options.fps, options.side, options.start, options.end)
    size = pictures.pictures[0].shape[1::-1]
    recorded = in_pixels(pictures.focal35, size) if pictures.focal35 else None
    focal = recorded if lens is None else asked_for(lens, recorded, size)
    watched = watch_video(
        pictures.pictures,
        on_silhouette,
        person,
        options.weights,
        part_of_progress(progress, 0, 4, 5),
    )
    if options.keypoints is not None:
        landmarks, said = with_keypoints(
            watched.landmarks, options.keypoints, pictures.numbers, pictures.scale
        )
        watched = replace(watched, landmarks=landmarks, notes=(*watched.notes, *said))
    landmarks, backs = with_backs(watched.landmarks, pictures.fps)
    if backs:
        said = f"frames where the network took the back for the front: {listed(backs)}; corrected"
        watched = replace(watched, landmarks=landmarks, notes=(*watched.notes, said))
    known = KnownOfVideo(options.height, focal, camera_height=options.camera_height)
    lines = vertical_of(pictures.pictures, watched.landmarks, known.K(size))
    known = replace(known, lines=lines)
    solved = solve_stage1(
        watched.landmarks, body, size, pictures.fps, known, part_of_progress(progress, 4, 1, 5)
    )
    solved, of_face = with_face(solved, watched.landmarks, body, pictures.fps)
    watched = replace(watched, notes=[*watched.notes, *of_face])
    upright = lines is not None or options.camera_height is not None
    return SolvedMotion(pictures, watched, solved, focal is not None, upright)
