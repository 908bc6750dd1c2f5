"""Variants of the avatar study: the ways to make an avatar that are compared.

They are the whole method, and the method without one part in turn; ``docs/studies.md`` says what
differs in each. :data:`LADDER` goes from the method as printed to the whole one, change by change
(``docs/paper.md``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, Literal, TypeVar

from gva_mi.core.errors import InputError
from gva_mi.fit import paper
from gva_mi.fit.losses import LossOptions
from gva_mi.fit.options import FitOptions

T = TypeVar("T")


@dataclass(frozen=True)
class AvatarVariant:
    """One way to make an avatar of a video."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)  # of the fit, by dotted names
    poses: Literal["refined", "printed", "stage 1", "true"] = "refined"
    rigid: bool = False  # one rigid body
    one_range: bool = False  # of test frames
    changes: int | None = None  # of the options as printed, :data:`CHANGES`; None: not of those

    def of(self, options: FitOptions) -> FitOptions:
        """Return the options of this variant's fit."""
        if self.changes is not None:
            kept = [name for _, names in CHANGES[: self.changes + 1] for name in names]
            kept += ["steps", "seed", "checkpoint_every", "vgg16"]
            options = changed(paper.FIT, {name: attrgetter(name)(options) for name in kept})
        return changed(options, self.options)


def changed(options: T, values: Mapping[str, Any]) -> T:
    """Return a dataclass with other values, by dotted names such as ``avatar.hands``."""
    for name, value in values.items():
        first, _, rest = name.partition(".")
        inner = changed(getattr(options, first), {rest: value}) if rest else value
        options = replace(options, **{first: inner})
    return options


UNTRAINED = {"first_steps": 0, "poses.trained": False}  # poses stay as they are given
HANDLESS = {"avatar.hands": False}
UNSTRETCHED = {"avatar.stretch": False}  # Gaussians do not stretch and shear with the skin
NAKED = {"naked": True}  # seeded on the naked body instead of the displaced surface
NO_REINIT = {"schedule.reinit_at": ()}
# A residual whose weight lets it do something, as the paper's 0.5 does not.
RESIDUAL = {"avatar.residual.enabled": True, "loss": LossOptions(residual=0.02)}
GART_LOSS = {"loss": LossOptions(perceptual=0.01, residual=0.0, alpha=0.1, ssim=0.01)}
GART = NAKED | HANDLESS | NO_REINIT | UNSTRETCHED | GART_LOSS

FULL = AvatarVariant("full")
NO_HANDS = AvatarVariant("without hand skeleton", HANDLESS)
VARIANTS = (
    FULL,
    AvatarVariant("without refinement", poses="stage 1"),
    AvatarVariant("without trained poses", UNTRAINED),
    AvatarVariant("without either", UNTRAINED, poses="stage 1"),
    NO_HANDS,
    AvatarVariant("without re-initialisation", NO_REINIT),
    AvatarVariant("without re-initialisation, naked", NO_REINIT | NAKED),
    AvatarVariant("seeded on the naked body", NAKED),
    AvatarVariant("without stretching", UNSTRETCHED),
    AvatarVariant("with residual", RESIDUAL),
    AvatarVariant("GART-like", GART, poses="stage 1"),
    AvatarVariant("static 3DGS", UNTRAINED | HANDLESS | NO_REINIT, rigid=True),
    AvatarVariant("true poses", UNTRAINED, poses="true"),
    AvatarVariant("one held-out range", one_range=True),
)

CHANGES: tuple[tuple[str, tuple[str, ...]], ...] = (  # name, and the options that it sets
    ("as printed", ()),
    ("+ refined over all frames", ()),
    ("+ poses trained", ("poses",)),
    ("+ seeded on the clothes", ("naked",)),
    ("+ offset surface", ("reinit",)),
    ("+ smooth weights", ("avatar.skinning",)),
    ("+ stretching", ("avatar.stretch",)),
    ("+ colour by light", ("avatar.color",)),
    ("+ our rates", ("rates", "min_scale")),
)  # and without the residual, it is "full"
LADDER = tuple(
    AvatarVariant(name, poses="refined" if k else "printed", changes=k)
    for k, (name, _) in enumerate(CHANGES)
)

# The method as printed, by the α of its alpha shape: without one, it is the smallest at which the
# surface closes around trunk and limbs.
ALPHAS_MM = (25, 40, 150)
BY_ALPHA = tuple(
    AvatarVariant(f"as printed, α {mm} mm", {"reinit.alpha": mm / 1000}, "printed", changes=0)
    for mm in ALPHAS_MM
)


def variants_named(names: Sequence[str]) -> list[AvatarVariant]:
    """Return the named variants, in the order of the study.

    Without names: all that change one part. The name "ladder" is all of :data:`LADDER`, "alphas"
    all of :data:`BY_ALPHA`.

    Raises:
        InputError: there is no variant of a name.
    """
    if not names:
        return list(VARIANTS)
    known = {variant.name: variant for variant in (*LADDER, *BY_ALPHA, *VARIANTS)}
    groups = {"ladder": LADDER, "alphas": BY_ALPHA}
    asked = {row.name for name in names for row in groups.get(name, ())}
    asked |= {name for name in names if name not in groups}
    for name in asked:
        if name not in known:
            there = ", ".join([*known, *groups])
            raise InputError(f"study: --rows has no '{name}'; there are: {there}")
    return [variant for name, variant in known.items() if name in asked]
