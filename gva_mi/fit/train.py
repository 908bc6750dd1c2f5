"""``fit``: a video becomes an avatar, by gradient descent on Eq. 13."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from gva_mi.avatar.avatar import Avatar, AvatarOptions, seed_avatar
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.errors import InputError
from gva_mi.fit import checkpoint
from gva_mi.fit.losses import Distance, LossOptions, render_losses
from gva_mi.fit.perceptual import rand_vgg_loss, vgg16_loss
from gva_mi.fit.targets import Draw, Target, Targets, torch_state
from gva_mi.splat import SplatOptions
from gva_mi.splat.torch_op import render

Progress = Callable[..., None]


@dataclass(frozen=True)
class Rates:
    """Learning rates of Adam, the field's (Kerbl et al. 2023, and avatars after it)."""

    means: float = 1.6e-4  # metres; falls exponentially to
    means_end: float = 1.6e-6  # this at the last step
    quats: float = 1e-3
    log_scales: float = 5e-3
    logit_opacities: float = 5e-2
    sh: float = 2.5e-3
    residual: float = 1e-3  # of the pose-conditioned MLP's weights
    pose: float = 0.0  # radians and metres; 0: the training poses stay as they are


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
        video: opened with the poses to train under, best the refined ones. Test frames are not looked at.
        body: whose skeleton and surface the avatar takes over.
        options: see there.
        out: folder of the run, in the form of :mod:`gva_mi.fit.checkpoint`.
        offsets: (V, 3) displacement of the rest surface found by the refinement, metres.
        resume: go on from the last checkpoint in ``out``, or start where there is none.
        progress: told each step's loss and number of Gaussians.

    Returns:
        The avatar, which is also written to ``out/avatar.npz``.

    Raises:
        InputError: ``out`` holds a run already, or one of other options; or files that cannot be read.
    """
    distance = vgg16_loss(options.vgg16) if options.vgg16 else rand_vgg_loss()
    checkpoint.claim(out, _plain(options), resume)
    if (out / checkpoint.AVATAR).exists():
        return Avatar.load(out / checkpoint.AVATAR)
    run = _Run(video, body, options, offsets, checkpoint.load_state(out))
    targets = Targets(
        video, video.splits.train, options.seed, options.random_background, options.window
    )
    while run.step < options.steps:
        figures = run.advance(targets[run.step], distance)
        if progress:
            shown = {name: figures[name] for name in ("loss", "gaussians")}
            progress(run.step, options.steps, **shown)
        if run.step % options.checkpoint_every == 0 and run.step < options.steps:
            checkpoint.save_state(out, run.state())
    run.avatar.save(out / checkpoint.AVATAR)
    checkpoint.save_arrays(out / checkpoint.HISTORY, **run.history)
    (out / checkpoint.CHECKPOINT).unlink(missing_ok=True)
    return run.avatar


class _Run:
    """What changes from step to step: avatar, training poses, optimiser, history."""

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
            self.avatar = seed_avatar(body, video.shape, offsets, options.avatar, generator)
            self.step, self.history = 0, {}
        else:
            self.avatar = Avatar.from_record(state["avatar"])
            self.step = state["step"]
            self.history = {name: list(values) for name, values in state["history"].items()}
        self.poses = TrainedPoses(video.pose, options.rates.pose > 0)
        self.optimizer = _optimizer(self.avatar, self.poses, options.rates)
        if state is not None:
            self.poses.load_state_dict(state["poses"])
            self.optimizer.load_state_dict(state["optimizer"])

    def advance(self, target: Target, distance: Distance) -> dict[str, float]:
        """One step of descent on one frame; returns its line of the history."""
        start, options = time.perf_counter(), self.options
        self._cool_down()
        animated = self.avatar.animate(self.poses(target.frame))
        image = render(animated.gaussians, target.camera, options.splat, target.background)
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
        self.step += 1
        figures = {"loss": float(total.detach())}
        figures |= {f.name: float(getattr(losses, f.name).detach()) for f in fields(losses)}
        figures["gaussians"] = len(self.avatar.canonical)
        figures["milliseconds"] = 1e3 * (time.perf_counter() - start)
        for name, value in figures.items():
            self.history.setdefault(name, []).append(value)
        return figures

    def state(self) -> dict[str, Any]:
        """All of it, for a checkpoint."""
        return {
            "step": self.step,
            "avatar": self.avatar.record(),
            "poses": self.poses.state_dict(),
            "optimizer": self.optimizer.state_dict(),
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
    """The poses of the frames; where they are trained, each frame's rotations and translation by themselves.

    A parameter per frame: one without a gradient in a step is left alone by Adam, with its momentum.
    """

    def __init__(self, pose: Pose, trained: bool) -> None:
        super().__init__()
        self.given = pose
        rows = [torch.cat([pose.rotations[k].flatten(), pose.transl[k]]) for k in range(len(pose))]
        self.frames = nn.ParameterList(rows if trained else [])

    def forward(self, frame: int) -> Pose:
        """The pose of one frame."""
        given = self.given[frame]
        if not len(self.frames):
            return given
        rotations, transl = self.frames[frame].split([165, 3])
        return Pose.from_rotations(rotations.view(1, 55, 3), transl[None], given.expression)


def _optimizer(avatar: Avatar, poses: TrainedPoses, rates: Rates) -> torch.optim.Adam:
    """Adam with one named group per kind of parameter; densification looks them up by these names."""
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


def _plain(options: FitOptions) -> dict[str, Any]:
    return asdict(replace(options, vgg16=None)) | {"vgg16": options.vgg16 and str(options.vgg16)}
