"""Options of a fit: learning rates, schedule, and the options of its parts."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

from gva_mi.avatar.avatar import AvatarOptions
from gva_mi.avatar.densify import DensifyOptions
from gva_mi.avatar.reinit import ReinitOptions
from gva_mi.core.errors import InputError
from gva_mi.core.options import InnerShare, PythonOnly, Rate, Seed, Share, Within, options_of
from gva_mi.fit.losses import LossOptions
from gva_mi.fit.poses import PoseOptions

# Defaults of the parts in a fit, where they differ from the parts' own.
REINIT = ReinitOptions(floater_sigmas=3.0)  # chosen: 2 tears holes into a skirt

# For phone videos: the weight of the alpha term. Chosen: where a mask may be wrong, the picture
# outvotes it only if person and background differ by more, in the mean over channels in [0, 1].
VIDEO_ALPHA = 0.05
# Share of the person's size; chosen: masks that follow the pictures are off by a pixel, others by
# several.
VIDEO_MASK_ERROR = 0.003
# Share a step; chosen: errors of poses look like changes of the light, and slopes would learn them.
VIDEO_SH_DECAY = 0.01
# Metres in a first step of poses. Chosen on rendered videos: twice as much costs novel poses.
VIDEO_POSE_STEP = 0.006

FallingRate = Annotated[float, Within(0, 1, "low")]
Every = Annotated[int, Within(0, 1_000_000)]  # steps
FromOne = Annotated[int, Within(1, 1_000_000)]


@options_of("fit")
class Rates:
    """Learning rates of Adam, from 3DGS (Kerbl et al. 2023) except for means and colours.

    3DGS uses 1.6e-4 for means and 2.5e-3 for colours, enough for tens of thousands of steps. In the
    two or three thousand that a CPU has time for, means would never reach hair and skirts, and
    colours not the contrast of a pattern.
    """

    # Metres, at the first step; falls exponentially to means_end.
    means: PythonOnly[FallingRate] = 4e-3
    means_end: PythonOnly[FallingRate] = 1e-5  # metres, at the last step
    quats: PythonOnly[Rate] = 1e-3
    log_scales: PythonOnly[Rate] = 5e-3
    logit_opacities: PythonOnly[Rate] = 5e-2
    # Colours; slopes learn more slowly, see gva_mi.avatar.skin_gaussians.
    sh: PythonOnly[Rate] = 5e-3
    # Share of the slopes' difference from Lambert's law that each step takes away (decoupled weight
    # decay): the law alone holds where a person never shows the back in the light of the front.
    sh_decay: PythonOnly[Share] = 0.0
    light: PythonOnly[Rate] = 2e-3  # direction of the light
    strength: PythonOnly[Rate] = 5e-3  # of the light, see gva_mi.fit.lambert
    residual: PythonOnly[Rate] = 1e-3  # weights of the pose-conditioned MLP


@options_of("fit")
class Schedule:
    """Schedule of density control, re-initialisation and binding of weights."""

    densify_every: PythonOnly[Every] = 200  # steps; 0: never
    densify_from: PythonOnly[Share] = 0.05  # share of all steps before the first round
    # Share of all steps after which there is no round, as in 3DGS.
    densify_until: PythonOnly[Share] = 0.5
    reinit_at: PythonOnly[tuple[InnerShare, ...]] = (0.25, 0.5)  # shares of all steps; empty: never
    rebind_every: PythonOnly[Every] = 100  # steps between bindings to the outer skin; 0: never

    def __post_init__(self) -> None:
        if self.densify_from > self.densify_until:
            found = f"{self.densify_from}, {self.densify_until}"
            raise InputError(f"fit: densify_from <= densify_until is needed, got {found}")

    def densifies(self, step: int, steps: int) -> bool:
        """Return whether density control follows a step; the first step is 1.

        It does not before a re-initialisation, which replaces all Gaussians and keeps their number.
        """
        within = self.densify_from * steps <= step <= self.densify_until * steps
        due = self.densify_every > 0 and within and step % self.densify_every == 0
        return due and not self.reinitialises(step, steps)

    def reinitialises(self, step: int, steps: int) -> bool:
        """Return whether a re-initialisation follows a step."""
        return step in {max(1, round(share * steps)) for share in self.reinit_at}

    def rebinds_weights(self, step: int) -> bool:
        """Return whether Gaussians are bound to the outer skin again after a step."""
        return self.rebind_every > 0 and step % self.rebind_every == 0


@options_of("fit")
class FitOptions:
    """Options of the fit of an avatar."""

    steps: FromOne = 3000  # steps of one frame each
    # Steps of a fit before this one, which starts anew with the poses that were trained there.
    first_steps: PythonOnly[Every] = 0
    seed: Seed = 0  # seed of all random numbers in the run
    # Seed on the naked body, as in the paper, instead of the displaced surface of a refinement.
    naked: PythonOnly[bool] = False
    # Smallest standard deviation of a Gaussian, in pixels of the training frames.
    min_scale: PythonOnly[Annotated[float, Within(0, 100)]] = 0.6
    # Side of the random window of the perceptual and SSIM terms, pixels.
    window: PythonOnly[Annotated[int, Within(11, 4096)]] = 96
    # Possible error of mask outlines as a share of the person's size; there the picture is used.
    mask_error: Annotated[float, Within(0, 0.2)] = 0.01
    # Other frames show what is behind the person there, unless they contradict this frame.
    still_camera: PythonOnly[bool] = False
    # Steps between perceptual terms, which take longer than the render.
    perceptual_every: PythonOnly[FromOne] = 4
    vgg16: Path | None = None  # the user's VGG16 weights for the perceptual term; None: rand_vgg
    # For a person who may never turn around: Gaussians do not wander along the line of sight, and
    # unseen surfaces take their colours from neighbours and from the body's other side.
    complete: PythonOnly[bool] = False
    # For arms that may touch the trunk: bare skin has no clothes, and what looks like clothes at a
    # contact counts less, see gva_mi.fit.first_surface.
    touching: PythonOnly[bool] = False
    checkpoint_every: FromOne = 500  # steps
    avatar: AvatarOptions = AvatarOptions()
    rates: Rates = Rates()
    schedule: Schedule = Schedule()
    densify: DensifyOptions = DensifyOptions()
    reinit: ReinitOptions = REINIT
    loss: LossOptions = LossOptions()
    poses: PoseOptions = PoseOptions()

    def __post_init__(self) -> None:
        if self.first_steps and not self.poses.trained:
            raise InputError("fit: --preset video trains poses first; got --poses.no-trained")

    def of_video(self) -> FitOptions:
        """Return the options for a video, whose masks are finer and poses worse than others'.

        A first fit, of smaller pictures, improves the poses, if poses are trained. In the band
        where masks are uncertain, a Gaussian in the colours of the background before it costs
        nothing (:mod:`gva_mi.fit.samples`); the alpha term removes it there unless the picture
        wants it.
        Beyond Lambert's law, colours depend on the light only as far as all frames agree on it.
        Hands keep their turn at the wrist, because training makes it worse than the refinement.
        Other joints take larger steps, and keep corrections that are the same in all frames.
        Many people do not turn all the way around, so unseen colours are completed.
        Options that differ from the usual ones stay.
        """
        chosen = self.mask_error != FitOptions.mask_error
        step_chosen = self.poses.step != PoseOptions.step
        step = self.poses.step if step_chosen else VIDEO_POSE_STEP
        return replace(
            self,
            first_steps=self.first_steps or self.steps // 2 * self.poses.trained,
            mask_error=self.mask_error if chosen else VIDEO_MASK_ERROR,
            still_camera=True,
            complete=True,
            touching=True,
            poses=replace(self.poses, wrists=False, constant=True, step=step),
            rates=replace(self.rates, sh_decay=self.rates.sh_decay or VIDEO_SH_DECAY),
            loss=replace(self.loss, alpha=self.loss.alpha or VIDEO_ALPHA),
        )

    @property
    def all_steps(self) -> int:
        """Steps of both fits."""
        return self.first_steps + self.steps

    def plain(self) -> dict[str, Any]:
        """Return the options as numbers, strings and dictionaries, for a file."""
        return asdict(self) | {"vgg16": self.vgg16 and str(self.vgg16)}
