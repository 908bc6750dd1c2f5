"""Records of a refinement: options of both methods, the input of one job, its solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.options import Weight, Within, options_of
from gva_mi.pose.evidence.close_ups import FinePicture
from gva_mi.pose.evidence.landmarks import SeenLandmarks
from gva_mi.pose.evidence.masks_normals import MaskAndNormals
from gva_mi.pose.prior.error_model import Stage1ErrorModel
from gva_mi.pose.prior.ground import ContactStats
from gva_mi.pose.stature import PERSON_HEIGHTS

FEWEST_FACES = 500  # a body with fewer has no hands left


@options_of("refine")
class RefineOptions:
    """Options that both methods have.

    The losses that the weights multiply are divided by the person's area in pixels
    (:mod:`gva_mi.pose.evidence.masks_normals`).
    """

    # Pixels of the person's longer side in the images that are compared.
    size: Annotated[int, Within(1, 4096)] = 208
    # Triangles of the body that is compared with them.
    faces: Annotated[int, Within(FEWEST_FACES, 1_000_000)] = 3500
    silhouette: Weight = 1.0  # λ1
    # Measured height of the person: sets body size and depth, which are then not fitted.
    height: Annotated[float, PERSON_HEIGHTS] | None = None
    hold_out_test: bool = False  # test frames are not used; the motion prior fills them in

    name: ClassVar[str]  # of the method, on the command line and in records


@dataclass(frozen=True)
class Solution:
    """Result of a refinement."""

    pose: Pose  # T frames
    shape: Shape
    offsets: Tensor  # (V, 3) displacement of the rest surface, metres
    # Stage 1's errors, if inferred.
    noise: Mapping[str, Stage1ErrorModel] = field(default_factory=dict)
    contact: ContactStats | None = None  # how the feet touch the ground, if inferred
    landmark_offsets: Tensor | None = None  # (P, 3) metres, of gva_mi.pose.evidence.landmarks


@dataclass(frozen=True)
class RefineJob:
    """Frames to be refined together, and all other input except the options."""

    evidence: Mapping[int, MaskAndNormals]  # by number within ``pose``; perhaps still on disk
    body: BodyModel
    pose: Pose  # stage 1; frames without evidence keep it
    shape: Shape
    known: Solution | None = None  # of the first round: the shared unknowns are taken from it
    fine: Mapping[int, FinePicture] = field(default_factory=dict)  # for close-ups, by number
    following: Sequence[int] = ()  # frames without evidence that the motion prior fills in
    landmarks: SeenLandmarks | None = None  # of all frames of ``pose``
    errors: Mapping[str, Stage1ErrorModel] | None = None  # of the estimator; None: inferred
