"""Cases of the studies: which subjects are measured, and under which errors.

A case is a synthetic subject under one draw of an error model. Refinement and avatars are tuned on
some cases and judged on others.

Choices (weights, rates, what is inferred and how) may use :data:`TUNING`. They are judged on
held-out cases, once, after the last choice: other subjects, and other draws of the error models.
Some of the error models, and half a turn, do not occur in TUNING at all. The draws of TUNING are
below 100, the draws of held-out sets from 1000.

Once you tune on these results they are no longer held out. So HELD_OUT is only set 1:
:func:`held_out` draws other subjects and errors for each further set, with the same motions,
bodies, clothes and error models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec

from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.synthetic import SynthOptions
from gva_mi.synthetic.errors.models import NO_ERRORS

NO_NORMALS = "no normals"  # counts as an error model of its own
TOUCH = "touch"  # so do videos in which arms or hands stay on the trunk


@dataclass(frozen=True)
class Take:
    """A video of one synthetic subject, rendered once and degraded by several error models."""

    subject: str | None = None  # one of the four named subjects; None: drawn from the seed
    seed: int = 0
    motion: str = "turn"
    figure: str = "own"  # or a body outside the model's shape space
    outfit: str = "own"  # or clothes that nothing was tuned on
    bare: bool = False  # without clothes and hair
    scene: str = "white"  # or a room, filmed by a phone
    camera: str = "stands"  # or held by hand
    frames: int | None = None  # of the video; None: as many as the study says
    size: int | None = None  # width and height of the pictures, pixels; None: as the study says
    shutter: float = 0.0  # share of the time between frames that the shutter is open

    @property
    def person(self) -> str:
        """The subject's name or seed, as ``--subjects`` takes it."""
        return self.subject or str(self.seed)

    @property
    def name(self) -> str:
        """A title such as ``seed 31, figure stretched``: all in which it differs from others."""
        usual, others = vars(Take()), []
        for name, value in vars(self).items():
            if name not in ("subject", "seed") and value != usual[name]:
                others.append(name if value is True else f"{name} {value}")
        return ", ".join([self.subject or f"seed {self.seed}", *others])

    def synth(self, frames: int, size: int, novel: int = 0) -> SynthOptions:
        """Return the options that make it, with so many novel poses and views."""
        made = SynthOptions(
            seed=self.seed, subject=self.subject, motion=self.motion, figure=self.figure,
            outfit=self.outfit, frames=self.frames or frames, size=self.size or size,
            bare=self.bare, novel_poses=novel, novel_views=novel,
            scene=self.scene, shutter=self.shutter,
        )  # fmt: skip
        held = self.camera != "stands"  # for which no errors are invented
        return replace(made, camera=self.camera, error_model=NO_ERRORS) if held else made


@dataclass(frozen=True)
class StudyCase:
    """A take under one draw of an error model."""

    take: Take
    noise: str  # the error model; files of results hold it under this name
    draw: int  # its seed
    normals: bool = True  # False: the refinement uses silhouettes only

    @property
    def kind_of_errors(self) -> str:
        """The error model, :data:`NO_NORMALS` or :data:`TOUCH`, as ``--error-models`` takes it."""
        if self.take.motion == TOUCH:
            return TOUCH
        return self.noise if self.normals else NO_NORMALS

    @property
    def name(self) -> str:
        """A title such as ``bruno: white 1000``."""
        without = "" if self.normals else f", {NO_NORMALS}"
        return f"{self.take.name}: {self.noise} {self.draw}{without}"

    @property
    def row(self) -> str:
        """The row of the refinement's table it counts to."""
        return self.take.name if self in LIMITS else self.kind_of_errors

    @property
    def purpose(self) -> str:
        """What it is for: tuning, limits or held out."""
        return "tuning" if self in TUNING else "limits" if self in LIMITS else "held out"

    @property
    def lacks(self) -> str | None:
        """The package that must be installed first; None if nothing is missing."""
        return "anny" if self.take.figure == "anny" and find_spec("anny") is None else None


def _cases(takes: dict[str, Take], first: int, table: tuple[tuple, ...]) -> tuple[StudyCase, ...]:
    """Return a case for each take, error model and (else True) normals; draws count from first."""
    return tuple(
        StudyCase(takes[key], noise, first + k, *normals)
        for k, (key, noise, *normals) in enumerate(table)
    )


_TUNED = {
    "amira": Take("amira"),
    "dalia": Take("dalia"),
    "0": Take(seed=0),
    "2": Take(seed=2),
    "bare": Take(seed=3, bare=True),
    "stretched": Take(seed=21, figure="stretched"),
    "outfit": Take(seed=22, outfit="foreign"),
    "still": Take(seed=23, motion="still"),
    "dance": Take(seed=24, motion="dance"),
    "walk": Take(seed=25, motion="walk"),
    "everyday": Take(seed=26, motion="everyday"),
    "filmed": Take(seed=27, scene="room"),
    "filmed everyday": Take(seed=28, motion="everyday", outfit="foreign", scene="room"),
    "filmed half": Take(seed=29, motion="half", scene="room"),
    "dress": Take(seed=51, motion=TOUCH, outfit="dress", scene="room"),
    "coat": Take(seed=52, motion=TOUCH, outfit="coat", scene="room"),
    "touch": Take(seed=53, motion=TOUCH, scene="room"),
}
TUNING = _cases(_TUNED, 1, (
    ("amira", "bursts"), ("bare", "bursts"), ("dalia", "white"), ("0", "white"), ("2", "lean"),
    ("stretched", "lean"), ("amira", "slow"), ("outfit", "slow"), ("0", "bursts", False),
    ("still", "lean"), ("dance", "bursts"), ("outfit", "masks"), ("dalia", "masks"),
    ("2", "mixed"), ("stretched", "outliers"), ("dance", "anything"), ("outfit", "anything"),
    ("walk", "outliers"), ("everyday", "outliers"),
    ("filmed", VIDEO_KIND), ("filmed everyday", VIDEO_KIND), ("filmed half", VIDEO_KIND),
    ("dress", VIDEO_KIND), ("coat", VIDEO_KIND), ("touch", VIDEO_KIND),
))  # fmt: skip

_JUDGED = {
    "bruno": Take("bruno"),
    "edgar": Take("edgar"),
    "11": Take(seed=11),
    "12": Take(seed=12),
    "13": Take(seed=13),
    "bare": Take(seed=16, bare=True),
    "everyday": Take(seed=17, motion="everyday"),
    "stretched": Take(seed=31, figure="stretched"),
    "outfit": Take(seed=32, outfit="foreign"),
    "anny": Take(seed=33, figure="anny"),
    "half": Take(seed=34, motion="half"),
    "walk": Take(seed=35, motion="walk"),
    "filmed": Take(seed=36, scene="room"),
    "filmed everyday": Take(seed=37, motion="everyday", outfit="foreign", scene="room"),
    "filmed half": Take(seed=38, motion="half", figure="stretched", scene="room"),
    "dress": Take(seed=39, motion=TOUCH, outfit="dress", scene="room"),
    "coat": Take(seed=40, motion=TOUCH, outfit="coat", scene="room"),
    "touch": Take(seed=41, motion=TOUCH, scene="room"),
}
HELD_OUT = _cases(_JUDGED, 1000, (
    ("bruno", "bursts"), ("everyday", "bursts"), ("11", "white"), ("half", "white"),
    ("12", "slow"), ("stretched", "slow"), ("edgar", "mixed"), ("anny", "mixed"), ("13", "lean"),
    ("bare", "lean"), ("bruno", "shape"), ("walk", "outliers"), ("11", "focal"),
    ("outfit", "masks"), ("12", "normals"), ("13", "anything"), ("outfit", "anything"),
    ("edgar", "bursts", False),
    ("filmed", VIDEO_KIND), ("filmed everyday", VIDEO_KIND), ("filmed half", VIDEO_KIND),
    ("dress", VIDEO_KIND), ("coat", VIDEO_KIND), ("touch", VIDEO_KIND),
))  # fmt: skip

_USUAL = Take(seed=140, scene="room")
# One subject, filmed as usual, and with one thing changed at a time: how a video should be taken.
LIMITS = tuple(
    StudyCase(replace(_USUAL, **changed), VIDEO_KIND, draw)
    for draw, changed in {
        60: {}, 61: {"motion": "half"}, 62: {"motion": "still"}, 63: {"motion": "everyday"},
        64: {"frames": 30}, 65: {"frames": 120}, 67: {"size": 256},
        68: {"size": 1024}, 69: {"outfit": "foreign"}, 70: {"camera": "held"},
        72: {"shutter": 0.5},
    }.items()
)  # fmt: skip


def held_out(number: int = 1) -> tuple[StudyCase, ...]:
    """Return held-out set ``number``.

    Set 1 is :data:`HELD_OUT`. Set n has subjects of seeds from 100 n and draws from 1000 n, so no
    two sets share a subject or an error.
    """
    if number == 1:
        return HELD_OUT
    takes = enumerate(dict.fromkeys(case.take for case in HELD_OUT))
    others = {take: replace(take, subject=None, seed=100 * number + k) for k, take in takes}
    return tuple(
        replace(case, take=others[case.take], draw=case.draw + 1000 * (number - 1))
        for case in HELD_OUT
    )
