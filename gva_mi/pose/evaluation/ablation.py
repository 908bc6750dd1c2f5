"""What each term of the refinement is worth: the same video refined without it.

Also the paper's Eq. 9 as printed, frame by frame on the bare body, which is no part left out but
another way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.pose.evaluation.measure import Measured, PoseErrors, measure_frames
from gva_mi.pose.refine import RefineOptions, refine_all


@dataclass(frozen=True)
class Variant:
    """The refinement with something left out."""

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)  # of the options
    normals: bool = True  # without them the silhouettes serve alone


VARIANTS = (
    Variant("normals only", {"silhouette": 0.0}),
    Variant("silhouettes only", normals=False),
    Variant("no prior", {"prior": 0.0}),
    Variant("no neighbours in time", {"smooth": 0.0, "smooth_move": 0.0, "reach": 0.0}),
    Variant("no displacement for clothes", {"cloth_lr": 0.0}),
    Variant("shape of stage 1", {"betas_lr": 0.0}),
    Variant("Eq. 9 as printed", {"loss": "paper"}),
)


def ablate(
    video: Video,
    body: BodyModel,
    options: RefineOptions,
    measured: Measured,
    truth: tuple[Pose, Shape] | None = None,
    progress: Callable[..., None] | None = None,
    executor: Executor | None = None,
) -> dict[str, PoseErrors]:
    """Refine a video in all variants.

    Args:
        video: the one that ``options`` were used on.
        body: the body.
        options: of the refinement that is varied.
        measured: the refinement that is varied.
        truth: of a synthetic subject; without it only the IoU is told.
        progress: called as ``progress(done, total, **figures)``.
        executor: who does it; None: this process.

    Returns:
        For each variant's name, how well its poses fit.
    """
    tasks = [
        (video if v.normals else replace(video, normals=None), replace(options, **v.changes))
        for v in VARIANTS
    ]
    found = refine_all(tasks, body, progress, executor)
    return {
        variant.name: measure_frames(video, body, refined, truth, measured).means
        for variant, refined in zip(VARIANTS, found, strict=True)
    }
