"""Variants of the avatar study: the whole method, and the method without one part in turn.

``docs/studies.md`` says what differs in each. :data:`LADDER` goes from the method as printed to the
whole one, change by change (``docs/paper.md``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from gva_mi.core.errors import InputError
from gva_mi.fit import paper
from gva_mi.fit.losses import LossOptions
from gva_mi.fit.options import FitOptions

FREE_RESIDUAL = LossOptions(residual=0.02)  # with the paper's 0.5 it does nothing
GART_LOSS = LossOptions(perceptual=0.01, residual=0.0, alpha=0.1, ssim=0.01)


@dataclass(frozen=True)
class AvatarVariant:
    """One way to make an avatar of a video."""

    name: str
    poses: Literal["refined", "printed", "stage 1", "true"] = "refined"
    trained: bool = True  # poses are trained along with the avatar
    naked: bool = False  # seeded on the naked body instead of the displaced surface
    hands: bool = True
    residual: bool = False
    stretched: bool = True  # Gaussians stretch and shear with the skin
    reinitialised: bool = True
    rigid: bool = False  # one rigid body
    one_range: bool = False  # of test frames
    loss: LossOptions | None = None  # None: that of the options
    changes: int | None = None  # of the options as printed, :data:`CHANGES`; None: not of those

    def of(self, options: FitOptions) -> FitOptions:
        """Return the options of this variant's fit."""
        if self.changes is not None:
            return _changed(options, self.changes)
        avatar, schedule = options.avatar, options.schedule
        avatar = replace(
            avatar,
            hands=avatar.hands and self.hands,
            stretch=avatar.stretch and self.stretched,
            residual=replace(avatar.residual, enabled=avatar.residual.enabled or self.residual),
        )
        return replace(
            options,
            avatar=avatar,
            loss=self.loss or options.loss,
            naked=options.naked or self.naked,
            poses=options.poses if self.trained else replace(options.poses, trained=False),
            schedule=schedule if self.reinitialised else replace(schedule, reinit_at=()),
        )


FULL = AvatarVariant("full")
TRUE_POSES = AvatarVariant("true poses", poses="true", trained=False)
NO_REFINEMENT = AvatarVariant("without either", poses="stage 1", trained=False)
NO_HANDS = AvatarVariant("without hand skeleton", hands=False)
NO_REINIT_NAKED = AvatarVariant("without re-initialisation, naked", reinitialised=False, naked=True)
VARIANTS = (
    FULL,
    AvatarVariant("without refinement", poses="stage 1"),
    AvatarVariant("without trained poses", trained=False),
    NO_REFINEMENT,
    NO_HANDS,
    AvatarVariant("without re-initialisation", reinitialised=False),
    NO_REINIT_NAKED,
    AvatarVariant("seeded on the naked body", naked=True),
    AvatarVariant("without stretching", stretched=False),
    AvatarVariant("with residual", residual=True, loss=FREE_RESIDUAL),
    AvatarVariant(
        "GART-like", poses="stage 1", naked=True, hands=False,
        reinitialised=False, stretched=False, loss=GART_LOSS,
    ),
    AvatarVariant("static 3DGS", trained=False, hands=False, reinitialised=False, rigid=True),
    TRUE_POSES,
    AvatarVariant("one held-out range", one_range=True),
)  # fmt: skip


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


def _changed(options: FitOptions, count: int) -> FitOptions:
    """Return the fit as printed with the first changes set as in the options."""
    same = ("steps", "seed", "checkpoint_every", "vgg16")
    found = replace(paper.FIT, **{name: getattr(options, name) for name in same})
    for _, names in CHANGES[: count + 1]:
        for name in names:
            part, _, field = name.rpartition(".")
            if part:
                own, new = getattr(found, part), getattr(options, part)
                own = replace(own, **{field: getattr(new, field)})
                found = replace(found, **{part: own})
            else:
                found = replace(found, **{field: getattr(options, field)})
    return found


def variants_named(names: tuple[str, ...]) -> list[AvatarVariant]:
    """Return the variants of some names, in the order of the study.

    Without names: all that change one part. The name "ladder" is all of :data:`LADDER`.

    Raises:
        InputError: there is no variant of a name.
    """
    if not names:
        return list(VARIANTS)
    known = {variant.name: variant for variant in (*LADDER, *VARIANTS)}
    asked = {*names, *(row.name for row in LADDER if "ladder" in names)} - {"ladder"}
    for name in asked:
        if name not in known:
            there = ", ".join([*known, "ladder"])
            raise InputError(f"study: --rows has no '{name}'; there are: {there}")
    return [variant for name, variant in known.items() if name in asked]
