"""``fit``: a video becomes an avatar, by gradient descent on Eq. 13."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from gva_mi.avatar.avatar import Avatar, AvatarOptions, seed_avatar
from gva_mi.avatar.densify import DensifyOptions, ScreenGradients, densify, replace_gaussians
from gva_mi.avatar.reinit import ReinitOptions, reinitialise
from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.errors import InputError
from gva_mi.fit import checkpoint
from gva_mi.fit.colors import seen_colors
from gva_mi.fit.losses import Distance, LossOptions, render_losses
from gva_mi.fit.perceptual import rand_vgg_loss, vgg16_loss
from gva_mi.fit.targets import Draw, Target, Targets, torch_state
from gva_mi.splat import SplatOptions
from gva_mi.splat.torch_op import Screen, render

Progress = Callable[..., None]


@dataclass(frozen=True)
class Rates:
    """Learning rates of Adam, the field's (Kerbl et al. 2023, and avatars after it)."""

    means: float = 5e-4  # metres; falls exponentially to
    means_end: float = 5e-6  # this at the last step
    quats: float = 1e-3
    log_scales: float = 5e-3
    logit_opacities: float = 5e-2
    sh: float = 2.5e-3
    residual: float = 1e-3  # of the pose-conditioned MLP's weights
    pose: float = 0.0  # radians and metres; 0: the training poses stay as they are


@dataclass(frozen=True)
class Schedule:
    """When Gaussians are added, removed, and put back on the surface."""

    densify_every: int = 200  # steps; 0: never
    densify_from: float = 0.05  # share of all steps, the first round comes after it
    densify_until: float = 0.6  # share of all steps, the last round comes before it
    reinit_at: tuple[float, ...] = (0.25, 0.5)  # shares of all steps; empty: never

    def __post_init__(self) -> None:
        if self.densify_every < 0 or not 0 <= self.densify_from <= self.densify_until <= 1:
            raise InputError("fit: densify_every must be 0 or more, 0 <= from <= until <= 1")
        if not all(0 < share < 1 for share in self.reinit_at):
            raise InputError(f"fit: reinit_at must lie between 0 and 1, got {self.reinit_at}")

    def densifies(self, step: int, steps: int) -> bool:
        """Whether a round of density control follows a step, the first being 1."""
        within = self.densify_from * steps <= step <= self.densify_until * steps
        return self.densify_every > 0 and within and step % self.densify_every == 0

    def reinitialises(self, step: int, steps: int) -> bool:
        """Whether a re-initialisation follows a step."""
        return step in {max(1, round(share * steps)) for share in self.reinit_at}


@dataclass(frozen=True)
class FitOptions:
    """How an avatar is fitted."""

    steps: int = 3000  # one frame each
    seed: int = 0  # of all chance in the run
    random_background: bool = True  # another colour each step, so that alpha is learned; else white
    window: int = 128  # pixels, side of the random part seen by the perceptual and SSIM terms
    vgg16: Path | None = None  # the user's VGG16 weights for the perceptual term; none: rand_vgg
    checkpoint_every: int = 500  # steps
    avatar: AvatarOptions = AvatarOptions()
    rates: Rates = Rates()
    schedule: Schedule = Schedule()
    densify: DensifyOptions = DensifyOptions()
    reinit: ReinitOptions = ReinitOptions()
    loss: LossOptions = LossOptions()
    splat: SplatOptions = SplatOptions()

    def __post_init__(self) -> None:
        for name, least in (("steps", 1), ("window", 11), ("checkpoint_every", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"fit: {name} must be {least} or more, got {getattr(self, name)}")


def fit(
    video: Video,
    body: BodyModel,
    options: FitOptions,
    out: Path,
    *,
    offsets: Tensor | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Avatar:
    """Fit an avatar to the training frames of a video.

    The same seed gives the same avatar to the bit, also over a kill and a ``resume``.

    Args:
        video: opened with the poses to train under, best the refined ones. Test frames are not
            looked at.
        body: whose skeleton and surface the avatar takes over.
        options: see there.
        out: folder of the run, in the form of :mod:`gva_mi.fit.checkpoint`.
        offsets: (V, 3) displacement of the rest surface found by the refinement, metres.
        resume: go on from the last checkpoint in ``out``, or start where there is none.
        progress: told each step's loss and number of Gaussians.

    Returns:
        The avatar, which is also written to ``out/avatar.npz``.

    Raises:
        InputError: ``out`` holds a run already, or one of other options; or unreadable files.
    """
    distance = vgg16_loss(options.vgg16) if options.vgg16 else rand_vgg_loss()
    checkpoint.claim(out, _plain(options), resume)
    if (out / checkpoint.AVATAR).exists():
        return Avatar.load(out / checkpoint.AVATAR)
    run = _Run(video, body, options, offsets, checkpoint.load_state(out))
    targets = Targets(
        video, video.splits.train, options.seed, options.random_background, options.window
    )
    with _one_torch_thread():
        while run.step < options.steps:
            figures = run.advance(targets[run.step], distance)
            run.tend(out)
            if progress:
                shown = {name: figures[name] for name in ("loss", "gaussians")}
                progress(run.step, options.steps, **shown)
            if run.step % options.checkpoint_every == 0 and run.step < options.steps:
                checkpoint.save_state(out, run.state())
    checkpoint.save_arrays(out / checkpoint.HISTORY, **run.history)
    if len(run.poses.frames):
        save_poses(out / checkpoint.POSES, run.poses.all(), video.shape, stage=2)
    run.avatar.save(out / checkpoint.AVATAR)
    (out / checkpoint.CHECKPOINT).unlink(missing_ok=True)
    return run.avatar


class _Run:
    """What changes from step to step."""

    def __init__(
        self,
        video: Video,
        body: BodyModel,
        options: FitOptions,
        offsets: Tensor | None,
        state: dict[str, Any] | None,
    ) -> None:
        self.options = options
        if state is None:
            generator = torch_state(options.seed, Draw.SEED)
            colors = seen_colors(video, body, offsets)
            self.avatar = seed_avatar(body, video.shape, offsets, options.avatar, generator, colors)
            self.step, self.history = 0, {}
        else:
            self.avatar = Avatar.from_record(state["avatar"])
            self.step = state["step"]
            self.history = {name: list(values) for name, values in state["history"].items()}
        self.poses = TrainedPoses(video.pose, options.rates.pose > 0)
        self.optimizer = _optimizer(self.avatar, self.poses, options.rates)
        self.gradients = ScreenGradients(len(self.avatar.canonical))
        if state is not None:
            self.poses.load_state_dict(state["poses"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.gradients.total, self.gradients.views = state["gradients"]

    def advance(self, target: Target, distance: Distance) -> dict[str, float]:
        """One step of descent on one frame; returns its line of the history."""
        start, options = time.perf_counter(), self.options
        self._cool_down()
        animated = self.avatar.animate(self.poses(target.frame))
        screen = Screen()
        image = render(animated.gaussians, target.camera, options.splat, target.background, screen)
        losses = render_losses(
            image,
            target.color,
            target.mask,
            animated.residual,
            options.loss,
            distance,
            target.window,
        )
        total = losses.total(options.loss)
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        self.optimizer.step()
        self.gradients.add(screen, target.camera)
        self.step += 1
        figures = {"step": self.step, "loss": float(total.detach())}
        figures |= {f.name: float(getattr(losses, f.name).detach()) for f in fields(losses)}
        figures["gaussians"] = len(self.avatar.canonical)
        figures["milliseconds"] = 1e3 * (time.perf_counter() - start)
        for name, value in figures.items():
            self.history.setdefault(name, []).append(value)
        return figures

    def tend(self, out: Path) -> None:
        """What follows a step by the schedule: density control, re-initialisation."""
        options, schedule = self.options, self.options.schedule
        if schedule.densifies(self.step, options.steps):
            generator = torch_state(options.seed, Draw.DENSIFY, self.step)
            densify(self.avatar, self.optimizer, self.gradients, options.densify, generator)
            self.gradients = ScreenGradients(len(self.avatar.canonical))
        if schedule.reinitialises(self.step, options.steps):
            generator = torch_state(options.seed, Draw.REINIT, self.step)
            before, new = (
                self.avatar.canonical,
                reinitialise(self.avatar, options.reinit, generator),
            )
            checkpoint.save_snapshot(out, self.step, before, new.canonical, new.surface)
            replace_gaussians(self.avatar, self.optimizer, new.canonical)
            self.gradients = ScreenGradients(len(self.avatar.canonical))

    def state(self) -> dict[str, Any]:
        """All of it, for a checkpoint."""
        return {
            "step": self.step,
            "avatar": self.avatar.record(),
            "poses": self.poses.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "gradients": [self.gradients.total, self.gradients.views],
            "history": self.history,
        }

    def _cool_down(self) -> None:
        """Let the learning rate of the means fall exponentially over the run."""
        rates = self.options.rates
        done = self.step / max(1, self.options.steps - 1)
        for group in self.optimizer.param_groups:
            if group["name"] == "means":
                group["lr"] = rates.means ** (1 - done) * rates.means_end**done


class TrainedPoses(nn.Module):
    """The poses of the frames; where they are trained, rotations and translation of each frame.

    A parameter per frame: Adam leaves alone, momentum included, what has no gradient in a step.
    """

    def __init__(self, pose: Pose, trained: bool) -> None:
        super().__init__()
        self.given = pose
        self.frames = nn.ParameterList(_packed(pose).unbind() if trained else [])

    def forward(self, frame: int) -> Pose:
        """The pose of one frame."""
        given = self.given[frame]
        if not len(self.frames):
            return given
        return _unpacked(self.frames[frame][None], given.expression)

    def all(self) -> Pose:
        """The poses of all frames, as they are now."""
        if not len(self.frames):
            return self.given
        return _unpacked(torch.stack(list(self.frames)).detach(), self.given.expression)


def _packed(pose: Pose) -> Tensor:
    return torch.cat([pose.rotations.flatten(1), pose.transl], dim=1)  # (T, 168)


def _unpacked(rows: Tensor, expression: Tensor) -> Pose:
    rotations, transl = rows.split([165, 3], dim=1)
    return Pose.from_rotations(rotations.unflatten(1, (55, 3)), transl, expression)


def _optimizer(avatar: Avatar, poses: TrainedPoses, rates: Rates) -> torch.optim.Adam:
    """Adam with one named group, and one learning rate, per kind of parameter."""
    groups = [
        {"name": name, "params": [parameter], "lr": getattr(rates, name)}
        for name, parameter in avatar.canonical.named_parameters()
    ]
    if avatar.options.residual.enabled:
        groups.append(
            {"name": "residual", "params": list(avatar.residual.parameters()), "lr": rates.residual}
        )
    if len(poses.frames):
        groups.append({"name": "pose", "params": list(poses.parameters()), "lr": rates.pose})
    # With 3DGS's tiny epsilon a Gaussian that is seldom seen moves as far as any other.
    return torch.optim.Adam(groups, lr=0.0, eps=1e-15, fused=True)


@contextmanager
def _one_torch_thread() -> Iterator[None]:
    """Leave the cores to Dr.Jit: after each operation torch's OpenMP threads would spin on them.

    One thread is 1.3 to 20 times faster on two cores, the more the busier they are, and makes every
    sum independent of the number of cores.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _plain(options: FitOptions) -> dict[str, Any]:
    return asdict(replace(options, vgg16=None)) | {"vgg16": options.vgg16 and str(options.vgg16)}
