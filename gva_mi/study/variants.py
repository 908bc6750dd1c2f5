"""Variants of the avatar study: the whole method, and the method without one part in turn.

``docs/studies.md`` says what differs in each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from gva_mi.core.errors import InputError
from gva_mi.fit.losses import LossOptions
from gva_mi.fit.options import FitOptions

FREE_RESIDUAL = LossOptions(residual=0.02)  # with the paper's 0.5 it does nothing
GART_LOSS = LossOptions(perceptual=0.01, residual=0.0, alpha=0.1, ssim=0.01)


@dataclass(frozen=True)
class AvatarVariant:
    """One way to make an avatar of a video."""

    name: str
    poses: Literal["refined", "stage 1", "true"] = "refined"
    trained: bool = True  # poses are trained along with the avatar
    naked: bool = False  # seeded on the naked body instead of the displaced surface
    hands: bool = True
    residual: bool = False
    stretched: bool = True  # Gaussians stretch and shear with the skin
    reinitialised: bool = True
    rigid: bool = False  # one rigid body
    one_range: bool = False  # of test frames
    loss: LossOptions | None = None  # None: that of the options

    def of(self, options: FitOptions) -> FitOptions:
        """Return the options of this variant's fit."""
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


def variants_named(names: tuple[str, ...]) -> list[AvatarVariant]:
    """Return the variants of some names, in the order of the study; all if none is named.

    Raises:
        InputError: there is no variant of a name.
    """
    known = {variant.name: variant for variant in VARIANTS}
    for name in names:
        if name not in known:
            raise InputError(f"study: --rows has no '{name}'; there are: {', '.join(known)}")
    return [variant for variant in VARIANTS if not names or variant.name in names]
