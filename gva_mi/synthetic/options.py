"""Options of a synthetic subject, and the random number streams it is made with."""

from __future__ import annotations

from dataclasses import asdict, replace
from enum import IntEnum
from typing import Annotated, Literal, get_args, get_origin, get_type_hints

import numpy as np
from numpy.random import Generator

from gva_mi.body.anny import anny_body
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.core.errors import InputError
from gva_mi.core.options import PictureSide, PythonOnly, Seed, Share, Within, Workers, options_of
from gva_mi.synthetic.errors.models import ERROR_MODELS, NO_ERRORS
from gva_mi.synthetic.person.bodies import BodyStretch, stretched
from gva_mi.synthetic.person.identity import NAMED, ONE_PIECE, SyntheticPerson, foreign_outfit
from gva_mi.synthetic.person.surface import PersonSurface, draw_surface


class SubjectStream(IntEnum):
    """Streams of random numbers of a subject, one per purpose."""

    MOTION = 1
    POSE_ERRORS = 2
    NOVEL_POSE = 3
    NOVEL_VIEW = 4
    RENDER = 5
    SEGMENTATION_ERRORS = 7  # feet and bags, in masks
    MISSING_NORMALS = 8  # frames without normals
    FIGURE = 11  # the stretched body
    OUTFIT = 12
    CAMERA = 13
    ROOM = 14
    PHONE_VIDEO = 15  # noise of its sensor


EXPOSURE_MOMENTS = 4  # while the shutter is open, which share the samples; chosen: fewer show steps
VIDEO_PIXELS = 1 << 31  # limit of a whole video; chosen: it is held in memory
VideoFrames = Annotated[int, Within(2, 10_000)]
NovelPictures = Annotated[int, Within(0, 1000)]
Samples = Annotated[int, Within(1, 4096)]


@options_of("synth")
class SynthOptions:
    """A synthetic subject, its motion, its pictures, and the errors of its stage-1 data."""

    seed: Seed = 0  # seed of the person, its motion and its errors
    subject: str | None = None  # one of the four named subjects; seed varies the rest
    motion: Literal["turn", "touch", "everyday", "still", "half", "walk", "dance"] = "turn"
    frames: VideoFrames = 80  # frames of the video; a turn fills all of them
    size: PictureSide = 512  # pixels, width and height of the pictures
    # Lamps besides the sky; all but the first two are for ground truth of a relit avatar.
    light: Literal["usual", "side", "turned", "right", "left", "above", "sky"] = "usual"
    # A phone held by hand, in a room, or one that circles once around the person on white: with
    # error model none.
    camera: Literal["stands", "held", "circles"] = "stands"
    # What is behind the person; a room also has phone.mp4.
    scene: Literal["white", "room"] = "white"
    error_model: str = "bursts"  # error model of poses, masks and normals; none: exact
    error_seed: PythonOnly[Seed | None] = None  # seed of the errors; without it, seed
    figure: PythonOnly[Literal["own", "stretched", "anny"]] = "own"  # body of the person
    # Foreign: thick soles, wide trousers. Dress: without sleeves. Coat: to the knees, wide sleeves.
    outfit: PythonOnly[Literal["own", "foreign", "dress", "coat"]] = "own"
    bare: PythonOnly[bool] = False  # bald, with a swimsuit that is painted on the skin
    samples: PythonOnly[Samples] = 16  # rays per pixel, a square number
    # Share of the time between frames that the shutter is open: motion blur.
    shutter: PythonOnly[Share] = 0.0
    novel_poses: PythonOnly[NovelPictures] = 8  # held-out pictures of other poses
    novel_views: PythonOnly[NovelPictures] = 8  # held-out pictures of frames from other sides
    workers: PythonOnly[Workers] = 1  # processes that render; any number gives the same bits

    def __post_init__(self) -> None:
        if self.frames * self.size**2 > VIDEO_PIXELS:
            got = f"{self.frames} of {self.size}x{self.size}"
            raise InputError(f"synth: a video must have at most {VIDEO_PIXELS:,} pixels, got {got}")
        choices = {"subject": (None, *NAMED), "error_model": (NO_ERRORS, *ERROR_MODELS)} | {
            name: get_args(hint)
            for name, hint in get_type_hints(SynthOptions).items()
            if get_origin(hint) is Literal
        }
        for name, known in choices.items():
            if getattr(self, name) not in known:
                names = ", ".join(str(k) for k in known if k)
                wrong = f"no {name.replace('_', ' ')} '{getattr(self, name)}'"
                raise InputError(f"synth: {wrong}; there are: {names}")
        if self.camera != "stands" and self.error_model != NO_ERRORS:
            raise InputError(
                f"synth: errors need a fixed camera; --camera {self.camera} needs "
                f"--error-model {NO_ERRORS}"
            )
        needed = {"held": "room", "circles": "white"}.get(self.camera, self.scene)
        if self.scene != needed:
            raise InputError(f"synth: --camera {self.camera} needs --scene {needed}")
        moments = EXPOSURE_MOMENTS if self.shutter > 0 else 1
        if round((self.samples / moments) ** 0.5) ** 2 * moments != self.samples:
            times = f"{moments} times a square number with a shutter"
            number = times if self.shutter > 0 else "a square number"
            raise InputError(f"synth: samples must be {number}, got {self.samples}")

    def drawn_on(self, body: BodyModel) -> BodyModel:
        """Return the body that the subject is drawn on, given the fitted ``body``."""
        if self.figure == "anny":
            return load_body(anny_body())
        if self.figure == "stretched":
            return stretched(body, BodyStretch.draw(self.random(SubjectStream.FIGURE)))
        return body

    def person(self, body: BodyModel) -> SyntheticPerson:
        """Return the person for a body."""
        named = self.subject is not None
        person = NAMED[self.subject] if named else SyntheticPerson.draw(self.seed, body.num_betas)
        outfit = person.outfit
        if self.outfit == "foreign":
            outfit = foreign_outfit(outfit, self.random(SubjectStream.OUTFIT))
        elif self.outfit in ONE_PIECE:
            outfit = replace(outfit, **ONE_PIECE[self.outfit])
            person = replace(person, bottom=person.top)
        if self.figure == "anny" and outfit.bottom == "skirt":  # its legs would come through
            outfit = replace(outfit, bottom="trousers", length=1.9, flare=0.015)
        return person if outfit is person.outfit else replace(person, outfit=outfit)

    def subject_on(self, drawn_on: BodyModel) -> PersonSurface:
        """Return the person's surface on the body of :meth:`drawn_on`."""
        return draw_surface(drawn_on, self.person(drawn_on), self.bare)

    def recorded(self) -> dict[str, object]:
        """Return the recorded options: all but ``workers``, which does not change the result."""
        return {k: v for k, v in asdict(self).items() if k != "workers"}

    @property
    def seed_of_errors(self) -> int:
        """Seed of the errors."""
        return self.seed if self.error_seed is None else self.error_seed

    def entropy(self, stream: int, errors: bool = False) -> tuple[int, ...]:
        """Return the seed of a stream, different for all subjects of the study.

        With ``errors``, it depends on the seed of the errors instead.
        """
        named = () if self.subject is None else (NAMED[self.subject].seed,)
        return (self.seed_of_errors if errors else self.seed, stream, *named)

    def random(self, stream: int, errors: bool = False) -> Generator:
        """Return the generator of a stream, see :meth:`entropy`."""
        return np.random.default_rng(self.entropy(stream, errors))
