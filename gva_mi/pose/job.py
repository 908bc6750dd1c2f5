"""The pieces into which a refinement is cut, and the interface of a way to refine.

A :class:`Job` holds all that its result depends on, so that it may be solved in this process, in
another one, or on another machine, with the same bits. Its options choose the way: all frames
together (:mod:`gva_mi.pose.sequence`), or each for itself (:mod:`gva_mi.pose.single_frame`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.close_ups import FinePicture
from gva_mi.pose.evidence import MaskAndNormals
from gva_mi.pose.ground import Footing
from gva_mi.pose.noise import Noise
from gva_mi.pose.stature import PEOPLE
from gva_mi.ranges import Weight, Within, require_ranges

FEWEST_FACES = 500  # a body of fewer has no hands left


@dataclass(frozen=True)
class Solution:
    """What a refinement looks for."""

    pose: Pose  # T frames
    shape: Shape
    offsets: Tensor  # (V, 3) displacement of the rest surface, metres
    noise: Mapping[str, Noise] = field(default_factory=dict)  # of stage 1, where it was inferred
    footing: Footing | None = None  # how the person stands, where it was inferred
    focal: float = 1.0  # s of gva_mi.pose.focal; the pose does not follow it yet


@dataclass(frozen=True)
class RefineOptions(ABC):
    """How poses are refined: what both ways have in common, and what each must know.

    The losses that the weights multiply are divided by the person's area
    (:mod:`gva_mi.pose.evidence`).
    """

    # Pixels of the person's longer side in the pictures that are compared.
    size: Annotated[int, Within(1, 4096)] = 208
    # Triangles of the body that is compared with them.
    faces: Annotated[int, Within(FEWEST_FACES, 1_000_000)] = 6000
    silhouette: Weight = 1.0  # λ1
    height: Annotated[float, PEOPLE] | None = None  # of the person, where somebody measured it
    hold_out_test: bool = False  # test frames are not looked at, their poses follow from the motion

    name: ClassVar[str]  # of the way, on the command line and in records

    def __post_init__(self) -> None:
        require_ranges("refine", self)

    @property
    def close_up_size(self) -> int:
        """Pixels of a hand in close-ups (:mod:`gva_mi.pose.close_ups`); 0: there are none."""
        return 0

    @property
    def swap_nat(self) -> float | None:
        """What a nat counts in :func:`gva_mi.pose.swaps.put_right`; None: no limb is exchanged."""
        return None

    @property
    @abstractmethod
    def description(self) -> str:
        """The way in a few words, for a report."""

    @abstractmethod
    def clips(self, frames: int) -> list[range]:
        """The pieces of a video of so many frames that are solved apart."""

    def first_round(self, frames: int, seen: Sequence[int]) -> Sequence[int]:
        """Frames that are solved before the clips, to find what all clips share; often none.

        Args:
            frames: of the video.
            seen: numbers of those that have evidence, ascending.
        """
        return ()

    @abstractmethod
    def steps_for(self, frames: int) -> int:
        """How much work so many frames are, for progress."""

    @abstractmethod
    def solve(self, job: Job, progress: Progress | None = None) -> Solution:
        """Refine the frames of a job, which has some evidence."""

    def variants(self) -> dict[str, RefineOptions]:
        """The same options with one term of the loss left out in turn, by a name for each."""
        return {}


@dataclass(frozen=True)
class Job:
    """Frames to be refined together."""

    evidence: Mapping[int, MaskAndNormals]  # by number within ``pose``; perhaps still on disk
    body: BodyModel
    pose: Pose  # stage 1; frames without evidence keep it
    shape: Shape
    options: RefineOptions
    known: Solution | None = None  # of the first round: what all frames share is taken from it
    fine: Mapping[int, FinePicture] = field(default_factory=dict)  # for close-ups, likewise
    following: Sequence[int] = ()  # frames without evidence whose poses follow from the motion

    @property
    def steps(self) -> int:
        """How much work it is, for progress."""
        return self.options.steps_for(len(self.evidence))

    def scene(self) -> MeshScene:
        """A scene in which the body can be rendered."""
        return MeshScene(self.body.faces, self.body.v_template)

    def solve(self, progress: Progress | None = None) -> Solution:
        """Do the work in this process."""
        if not self.evidence:
            return Solution(self.pose, self.shape, torch.zeros_like(self.body.v_template))
        here = replace(self, evidence=dict(self.evidence), fine=dict(self.fine))
        return self.options.solve(here, progress)
