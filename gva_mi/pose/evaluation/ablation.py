"""What each term of the refinement is worth: the same video refined without it."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from gva_mi.console import Progress
from gva_mi.pose.evaluation.figures import PoseFigures
from gva_mi.pose.evaluation.measure import Evaluation, measure
from gva_mi.pose.job import RefineOptions
from gva_mi.pose.refine import refine_all


@dataclass(frozen=True)
class Variant:
    """The refinement with something changed."""

    name: str
    options: RefineOptions
    normals: bool = True  # without them the silhouettes are all there is


def variants(options: RefineOptions, others: Mapping[str, RefineOptions]) -> list[Variant]:
    """A refinement with each of its terms left out in turn, and other refinements beside it.

    Args:
        options: of the refinement.
        others: options that are compared with it, by name.
    """
    terms = options.variants() | dict(others)
    return [
        Variant("normals only", replace(options, silhouette=0.0)),
        Variant("silhouettes only", options, normals=False),
        *(Variant(name, changed) for name, changed in terms.items()),
    ]


def ablate(
    evaluation: Evaluation,
    others: Mapping[str, RefineOptions],
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> dict[str, PoseFigures]:
    """Refine a video in all variants.

    Args:
        evaluation: of the refinement that is varied.
        others: options that are compared with it, by name, such as those of the other way.
        progress: called as ``progress(done, total, **figures)``.
        executor: who does it; None: this process.

    Returns:
        For each variant's name, how well its poses fit.
    """
    video, body, truth = evaluation.video, evaluation.body, evaluation.truth
    varied = variants(evaluation.options, others)
    tasks = [(video if v.normals else replace(video, normals=None), v.options) for v in varied]
    found = refine_all(tasks, body, progress, executor)
    return {
        variant.name: measure(video, body, refined, truth, evaluation.measured).means
        for variant, refined in zip(varied, found, strict=True)
    }
