"""All that can be chosen about a synthetic subject, and the random numbers it is made with."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Annotated, Literal

import numpy as np

from gva_mi.body.anny import anny_body
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.data.synthetic import motion
from gva_mi.data.synthetic.noise.families import Levels, require_family
from gva_mi.data.synthetic.people import STUDY, Person, foreign_outfit
from gva_mi.data.synthetic.stretched import Stretch, stretched
from gva_mi.errors import InputError
from gva_mi.ranges import PictureSide, Seed, Within, Workers, require_ranges

# One stream of random numbers for each thing that is drawn.
MOTION, NOISE, NOVEL_POSE, NOVEL_VIEW, RENDER, BACKGROUND, MISTAKEN, MISSING = range(1, 9)
FIGURE, OUTFIT = 11, 12
FIGURES = ("own", "stretched", "anny")
MOST_PIXELS = 1 << 31  # of a whole video, which is in memory while it is made
VideoFrames = Annotated[int, Within(2, 10_000)]
NovelPictures = Annotated[int, Within(0, 1000)]
Level = Annotated[float, Within(0, 10)]


@dataclass(frozen=True)
class SynthOptions:
    """A synthetic subject: who, doing what, seen how, and how wrong its stage-1 data are."""

    seed: Seed = 0  # another seed is another person: shape, clothes, hair, colours, motion, noise
    subject: str | None = None  # one of the study's seven by name; the seed varies motion, noise
    figure: Literal["own", "stretched", "anny"] = "own"  # the body drawn, where not the fitted one
    outfit: Literal["own", "foreign"] = "own"  # foreign: thick soles, wide trousers, bag, hood
    motion: Literal["turn", "everyday", "still", "half", "walk", "sit", "dance"] = "turn"
    frames: VideoFrames = 80  # of the video, which is one full turn
    size: PictureSide = 512  # pixels, width and height of the pictures
    samples: Annotated[int, Within(1, 4096)] = 16  # rays per pixel, a square number
    clothes: bool = True  # clothes and shoes; without them a swimsuit is painted on the skin
    hair: bool = True  # without it the head is bald
    light: Literal["usual", "side", "ambient"] = "usual"  # besides the sky, see render.LIGHTS
    camera: Literal["stands", "circles"] = "stands"  # circles: once round the person; no noise then
    folds: Level = 1.0  # factor on creases where cloth bends and on ends that lag; 0: skinned only
    family: str = "bursts"  # of noise: what goes wrong; see gva_mi.data.synthetic.noise.families
    noise_seed: Seed | None = None  # which noise of the family; without it, the seed's
    noise: Level = 1.0  # factor on the three levels below; 0: exact poses, masks and normals
    pose_noise: Level = 1.0  # of the stage-1 poses; 1 is a vertex error of about 66 mm in bursts
    mask_noise: Level = 1.0  # of the masks; 1 is a boundary off by about 1 pixel at 512 in bursts
    normal_noise: Level = 1.0  # of the normals; 1 is a blur of 2 pixels at 512, 9 degrees in bursts
    novel_poses: NovelPictures = 8  # pictures of poses that the video does not hold
    novel_views: NovelPictures = 8  # pictures of video frames from other sides
    background: bool = False  # a room behind the person, in the frames of the video
    blur: Level = 0.0  # of these frames, pixels at 512
    sensor_noise: Level = 0.0  # of these frames; 1 is about 1.5 % of white
    workers: Workers = 1  # processes that take pictures; any number gives the same bits

    def __post_init__(self) -> None:
        require_ranges("synth", self)
        if self.frames * self.size**2 > MOST_PIXELS:
            found = f"{self.frames} of {self.size}x{self.size}"
            raise InputError(
                f"synth: a video must have at most {MOST_PIXELS:,} pixels, got {found}"
            )
        require_family(self.family)
        if round(self.samples**0.5) ** 2 != self.samples:
            raise InputError(f"synth: samples must be a square number, got {self.samples}")
        choices = {
            "subject": (None, *STUDY), "motion": motion.MOTIONS, "figure": FIGURES,
            "outfit": ("own", "foreign"), "light": ("usual", "side", "ambient"),
            "camera": ("stands", "circles"),
        }  # fmt: skip
        for name, known in choices.items():
            if getattr(self, name) not in known:
                names = ", ".join(str(k) for k in known if k)
                raise InputError(f"synth: no {name} '{getattr(self, name)}'; there are: {names}")
        if self.camera == "circles" and any(asdict(self.levels).values()):
            raise InputError("synth: noise hangs on a camera that stands; circles needs noise 0")

    def drawn_on(self, body: BodyModel) -> BodyModel:
        """The body that the subject is drawn on, where ``body`` is the one that is fitted."""
        if self.figure == "anny":
            return load_body(anny_body())
        if self.figure == "stretched":
            return stretched(body, Stretch.draw(self.random(FIGURE)))
        return body

    def person(self, body: BodyModel) -> Person:
        """Who the subject is."""
        named = self.subject is not None
        person = STUDY[self.subject] if named else Person.draw(self.seed, body.num_betas)
        outfit = person.outfit
        if self.outfit == "foreign":
            outfit = foreign_outfit(outfit, self.random(OUTFIT))
        if self.figure == "anny" and outfit.bottom == "skirt":  # its legs come through the cut
            outfit = replace(outfit, bottom="trousers", length=1.9, flare=0.015)
        return person if outfit is person.outfit else replace(person, outfit=outfit)

    def recorded(self) -> dict[str, object]:
        """What to write down: all but the number of workers, which changes no bit."""
        return {k: v for k, v in asdict(self).items() if k != "workers"}

    @property
    def levels(self) -> Levels:
        """How large each kind of noise is."""
        each = (self.pose_noise, self.mask_noise, self.normal_noise)
        return Levels(*(self.noise * level for level in each))

    @property
    def seed_of_noise(self) -> int:
        """Which noise of the family."""
        return self.seed if self.noise_seed is None else self.noise_seed

    def entropy(self, stream: int) -> tuple[int, ...]:
        """What seeds one of the streams above; no two of the study's subjects share it."""
        return (self.seed, stream, *self._named)

    def random(self, stream: int) -> np.random.Generator:
        """The random numbers of one of the streams above."""
        return np.random.default_rng(self.entropy(stream))

    def entropy_of_noise(self, stream: int) -> tuple[int, ...]:
        """The same for what another noise of the same recording changes."""
        return (self.seed_of_noise, stream, *self._named)

    def random_noise(self, stream: int) -> np.random.Generator:
        """The random numbers of one of the streams above, for this noise."""
        return np.random.default_rng(self.entropy_of_noise(stream))

    @property
    def _named(self) -> tuple[int, ...]:
        return () if self.subject is None else (STUDY[self.subject].seed,)
