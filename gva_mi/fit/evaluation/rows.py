"""The rows of the study: the whole method, and the same without one part in turn.

==============================  ====================================================================
row                             what is different
==============================  ====================================================================
full                            nothing: refined poses, trained along, all parts
without refinement              stage-1 poses, trained along; no displaced surface is known then
without trained poses           refined poses as they are
without either                  stage-1 poses as they are: the paper's "w/o Pose Refinement"
without hand skeleton           fingers stay as in the rest pose
without re-initialisation       seeded on the displaced surface, as in full
..., naked                      the same, seeded on the naked body as in the paper
seeded on the naked body        re-initialised as in full: what the paper calls full
without stretching              Gaussians turn and keep their size, as in Eq. 6
with residual                   the pose moves Gaussians besides, at a weight that lets it
GART-like                       GART's parts in this program (Lei et al. 2023): stage-1 poses
                                trained along, the naked body, no fingers, no re-initialisation, its
                                loss. Not GART: skinning weights are not learned, there are no
                                latent bones, and rates are those of all rows
static 3DGS                     one rigid body: root and place follow the poses, all other joints
                                stay as in the first training frame, which makes a person who turns
                                before a camera a still life that a camera goes round
true poses                      what is left where poses are right; not trained along
one held-out range              as full, but test frames are one range in the middle of the video
==============================  ====================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from gva_mi.errors import InputError
from gva_mi.fit.losses import LossOptions
from gva_mi.fit.options import FitOptions

FREE_RESIDUAL = LossOptions(residual=0.02)  # with the paper's 0.5 it does nothing
GART_LOSS = LossOptions(perceptual=0.01, residual=0.0, alpha=0.1, ssim=0.01)


@dataclass(frozen=True)
class Row:
    """One way to make an avatar of the same video."""

    name: str
    poses: Literal["refined", "stage 1", "true"] = "refined"
    trained: bool = True  # poses are trained along with the avatar
    naked: bool = False  # seeded on the naked body instead of the displaced surface
    hands: bool = True
    residual: bool = False
    stretched: bool = True  # Gaussians grow and shear with the skin
    reinitialised: bool = True
    rigid: bool = False  # one rigid body
    one_range: bool = False  # of test frames
    loss: LossOptions | None = None  # None: that of the options

    def of(self, options: FitOptions) -> FitOptions:
        """The options of this row's fit."""
        avatar = options.avatar
        avatar = replace(
            avatar,
            hands=avatar.hands and self.hands,
            stretch=avatar.stretch and self.stretched,
            residual=replace(avatar.residual, enabled=avatar.residual.enabled or self.residual),
        )
        options = replace(
            options,
            avatar=avatar,
            loss=self.loss or options.loss,
            naked=options.naked or self.naked,
        )
        if not self.trained:
            options = _with_poses_as_given(options)
        if not self.reinitialised:
            options = replace(options, schedule=replace(options.schedule, reinit_at=()))
        return options


def _with_poses_as_given(options: FitOptions) -> FitOptions:
    """The one place of this folder that knows how poses are kept from being trained."""
    return replace(options, poses=replace(options.poses, trained=False))


FULL, TRUE = Row("full"), Row("true poses", poses="true", trained=False)
NO_REFINEMENT = Row("without either", poses="stage 1", trained=False)
NO_HANDS = Row("without hand skeleton", hands=False)
NO_REINIT_NAKED = Row("without re-initialisation, naked", reinitialised=False, naked=True)
ROWS = (
    FULL,
    Row("without refinement", poses="stage 1"),
    Row("without trained poses", trained=False),
    NO_REFINEMENT,
    NO_HANDS,
    Row("without re-initialisation", reinitialised=False),
    NO_REINIT_NAKED,
    Row("seeded on the naked body", naked=True),
    Row("without stretching", stretched=False),
    Row("with residual", residual=True, loss=FREE_RESIDUAL),
    Row(
        "GART-like", poses="stage 1", naked=True, hands=False,
        reinitialised=False, stretched=False, loss=GART_LOSS,
    ),
    Row(
        "static 3DGS", trained=False, hands=False, reinitialised=False, rigid=True
    ),
    TRUE,
    Row("one held-out range", one_range=True),
)  # fmt: skip


def rows_named(names: tuple[str, ...]) -> list[Row]:
    """The rows of some names, in the order of the study; all where none is named.

    Raises:
        InputError: a name that no row has.
    """
    known = {row.name: row for row in ROWS}
    for name in names:
        if name not in known:
            raise InputError(f"study: --rows has no '{name}'; there are: {', '.join(known)}")
    return [row for row in ROWS if not names or row.name in names]
