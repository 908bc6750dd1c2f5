"""Whom refinement and avatar are judged by: people, motions, bodies, clothes, kinds of noise.

Choices (weights, rates, what is inferred and how) may look at :data:`TUNING`. They are judged by
:data:`HELD_OUT`, which is looked at once, after the last choice: other people, and other draws of
the noise. Some of its families, and half a turn, have no counterpart in TUNING at all.

=============  =========================================  ========================================
..             TUNING                                     HELD_OUT
=============  =========================================  ========================================
people         amira, dalia, seeds 0, 2, 3, 21-26         bruno, edgar, seeds 11-13, 16, 17, 31-35
motions        turn, still, dance, everyday, walk         turn, everyday, half, walk
bodies         own, stretched                             own, stretched, anny
families       all but shape, focal, normals              all there are; no normals
their draws    below 100                                  1000 to 1999
=============  =========================================  ========================================

Whoever has looked at HELD_OUT and chooses again has made a tuning set of it. So it is the first of
many editions: :func:`held_out` draws other people and other noises for each, in the same motions,
bodies, clothes and families.

Of the first edition, bruno and seed 11 were looked at while it was chosen how poses are trained
along with an avatar, and all of it has been looked at between changes of the refinement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec

from gva_mi.data.synthetic import SynthOptions

NO_NORMALS = "no normals"  # stands for a family where masks are all there is


@dataclass(frozen=True)
class Take:
    """One person, filmed once: rendered once, and seen through many noises."""

    subject: str | None = None  # of the study's seven; None: drawn from the seed
    seed: int = 0
    motion: str = "turn"
    figure: str = "own"  # or a body that the fitted one does not span
    outfit: str = "own"  # or clothes that nothing was tuned on
    bare: bool = False  # without clothes and hair

    @property
    def person(self) -> str:
        """Who it is, in a word: what ``--people`` takes."""
        return self.subject or str(self.seed)

    @property
    def name(self) -> str:
        """Such as ``seed 31, stretched``."""
        what = [
            self.motion if self.motion != "turn" else None,
            self.figure if self.figure != "own" else None,
            f"{self.outfit} clothes" if self.outfit != "own" else None,
            "bare" if self.bare else None,
        ]
        return ", ".join([self.subject or f"seed {self.seed}", *filter(None, what)])

    def synth(self, frames: int, size: int, novel: int = 0) -> SynthOptions:
        """How it is made, with so many novel poses and views, which no refinement looks at."""
        return SynthOptions(
            seed=self.seed, subject=self.subject, motion=self.motion, figure=self.figure,
            outfit=self.outfit, frames=frames, size=size, clothes=not self.bare,
            hair=not self.bare, novel_poses=novel, novel_views=novel,
        )  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A take under one draw of a family of noise."""

    take: Take
    noise: str  # the family
    draw: int  # which of the family's noises
    normals: bool = True  # without them the silhouettes are all there is

    @property
    def family(self) -> str:
        """The row of the table that it counts to: what ``--families`` takes."""
        return self.noise if self.normals else NO_NORMALS

    @property
    def name(self) -> str:
        """Such as ``bruno: white 1000``."""
        return f"{self.take.name}: {self.noise} {self.draw}" + (
            "" if self.normals else f", {NO_NORMALS}"
        )

    @property
    def lacks(self) -> str | None:
        """What has to be installed first; None where nothing is missing."""
        return "anny" if self.take.figure == "anny" and find_spec("anny") is None else None


_TUNED_ON = {
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
}
TUNING = (
    Case(_TUNED_ON["amira"], "bursts", 1),
    Case(_TUNED_ON["bare"], "bursts", 2),
    Case(_TUNED_ON["dalia"], "white", 3),
    Case(_TUNED_ON["0"], "white", 4),
    Case(_TUNED_ON["2"], "lean", 5),
    Case(_TUNED_ON["stretched"], "lean", 6),
    Case(_TUNED_ON["amira"], "slow", 7),
    Case(_TUNED_ON["outfit"], "slow", 8),
    Case(_TUNED_ON["0"], "bursts", 9, normals=False),
    Case(_TUNED_ON["still"], "lean", 10),
    Case(_TUNED_ON["dance"], "bursts", 11),
    Case(_TUNED_ON["outfit"], "masks", 12),
    Case(_TUNED_ON["dalia"], "masks", 13),
    Case(_TUNED_ON["2"], "mixed", 14),
    Case(_TUNED_ON["stretched"], "outliers", 15),
    Case(_TUNED_ON["dance"], "anything", 16),
    Case(_TUNED_ON["outfit"], "anything", 17),
    Case(_TUNED_ON["walk"], "outliers", 18),
    Case(_TUNED_ON["everyday"], "outliers", 19),
)

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
}
HELD_OUT = (
    Case(_JUDGED["bruno"], "bursts", 1000),
    Case(_JUDGED["everyday"], "bursts", 1001),
    Case(_JUDGED["11"], "white", 1002),
    Case(_JUDGED["half"], "white", 1003),
    Case(_JUDGED["12"], "slow", 1004),
    Case(_JUDGED["stretched"], "slow", 1005),
    Case(_JUDGED["edgar"], "mixed", 1006),
    Case(_JUDGED["anny"], "mixed", 1007),
    Case(_JUDGED["13"], "lean", 1008),
    Case(_JUDGED["bare"], "lean", 1009),
    Case(_JUDGED["bruno"], "shape", 1010),
    Case(_JUDGED["walk"], "outliers", 1011),
    Case(_JUDGED["11"], "focal", 1012),
    Case(_JUDGED["outfit"], "masks", 1013),
    Case(_JUDGED["12"], "normals", 1014),
    Case(_JUDGED["13"], "anything", 1015),
    Case(_JUDGED["outfit"], "anything", 1016),
    Case(_JUDGED["edgar"], "bursts", 1017, normals=False),
)


def held_out(edition: int = 1) -> tuple[Case, ...]:
    """The cases that judge, in one of their editions.

    Args:
        edition: 1 is :data:`HELD_OUT`. Of the n-th, people are drawn from seeds from 100 n, and
            noises are the draws from 1000 n, so that no two editions share a person or a noise.
    """
    if edition == 1:
        return HELD_OUT
    takes = dict.fromkeys(case.take for case in HELD_OUT)
    others = {
        take: replace(take, subject=None, seed=100 * edition + k) for k, take in enumerate(takes)
    }
    return tuple(
        replace(case, take=others[case.take], draw=case.draw + 1000 * (edition - 1))
        for case in HELD_OUT
    )
