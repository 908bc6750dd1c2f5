"""The training loop: a video becomes an avatar by gradient descent on Eq. 9.

Each step uses one training frame of the video:

1. lower the learning rate of the means
2. avatar(pose) → Gaussians, MLP(θ)                      Eq. 5, 6, :mod:`gva_mi.fit.lambert`
3. render them on a background of a random colour, and on the picture's own
   along the outline                                   Eq. 1-3, :mod:`gva_mi.fit.samples`
4. compare with the person on the same background                            Eq. 9
5. one step of Adam, and sometimes one of the poses (:mod:`gva_mi.fit.poses`);
   decay what colours owe to the light; clamp the scales to the resolution of the pictures
6. by the schedule: clone, split, prune; put the Gaussians back on the surface      Sec. 4.3;
   bind them to the outer skin again; hold Gaussians of fingers and armpits

With ``complete``, unseen surfaces take colours of others in the end (:mod:`gva_mi.fit.completion`).

Adam has one group of parameters for each kind. With the gradient g of a parameter x, and means m
and v over steps,

7. m <- β1 m + (1 - β1) g,   v <- β2 v + (1 - β2) g²
8. x <- x - rate m̂ / (√v̂ + ε),   m̂ = m / (1 - β1^k),   v̂ = v / (1 - β2^k)   in step k

Gaussians that no frame shows, as in an armpit or on the back of a person who never turns, have a
hundredth of the gradient of others, all noise. With 3DGS's ε of 1e-15 they move as far as others:
they burst out of the surface once an arm is raised, and their colours wander. So ε is about a tenth
of the gradient of a Gaussian in plain view.

A move along the line of sight hardly changes a picture. If all pictures are from one side, that is
one axis in all of them, and noise along it moves Gaussians as far as pictures move them aside. So
for such people (``one_sided``) the coordinates of a place, or of a rotation, share one v, as in
the optimiser of poses (:mod:`gva_mi.refine.optimize`):

9. v <- β2 v + (1 - β2) |g|²
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import count
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gva_mi.avatar.avatar import AVATAR_SPLATTING, Avatar, seed_avatar
from gva_mi.avatar.densify import ScreenGradients, densify, replace_gaussians
from gva_mi.avatar.held import Held
from gva_mi.avatar.reinit import reinitialise
from gva_mi.body.pose import load_poses, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress, say
from gva_mi.core.cpu import one_torch_thread, sqrt
from gva_mi.core.files import write_arrays
from gva_mi.fit import run_folder
from gva_mi.fit.completion import complete_colors
from gva_mi.fit.first_surface import bare_skin, clothes_beside_contacts, seen_colors
from gva_mi.fit.lambert import Lambert
from gva_mi.fit.losses import Distance, render_losses
from gva_mi.fit.options import FitOptions, Rates
from gva_mi.fit.perceptual import rand_vgg_loss, vgg16_loss
from gva_mi.fit.photometric import shrunk_to_tall
from gva_mi.fit.poses import TrainedPoses
from gva_mi.fit.samples import FrameSampler, RandomStream, smallest_pixel, torch_state
from gva_mi.fit.training_landmarks import TrainingLandmarks
from gva_mi.splat import Screen, render
from gva_mi.subject.video import Video

# Steps between two checks that Gaussians of fingers and armpits, and of the rest, have not left;
# chosen: steps in which fingers merge, and a check of the whole body takes longer than a step.
HOLD_EVERY, HOLD_BODY_EVERY = 10, 100


def fit(
    video: Video,
    body: BodyModel,
    options: FitOptions,
    out: Path,
    *,
    offsets: Tensor | None = None,
    sources: Mapping[str, str | None] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    samples: FrameSampler | None = None,
) -> Avatar:
    """Fit an avatar to the training frames of a video.

    The same seed gives the same avatar to the bit, also after a kill and a ``resume``.

    Args:
        video: opened with the poses to train under, preferably refined. Test frames are not used.
        body: the body model that gives the avatar its skeleton and surface.
        options: of the fit.
        out: folder of the run, see :mod:`gva_mi.fit.run_folder`.
        offsets: (V, 3) displacement of the rest surface found by the refinement, metres; unused
            with ``options.naked``.
        sources: files of poses and body, for the run's record: :func:`run_folder.sources_of`.
        resume: continue from the last checkpoint in ``out``, if there is one.
        progress: called after each step with its loss and the number of Gaussians.
        samples: training frames of such a fit, where they were read before; None: they are read.

    Returns:
        The avatar, which is also written to ``out/avatar.npz``.

    Raises:
        InputError: ``out`` holds another run, or unreadable files.
    """
    distance = vgg16_loss(options.vgg16) if options.vgg16 else rand_vgg_loss()
    run_folder.prepare(out, options.plain(), video, resume, sources)
    if (out / run_folder.AVATAR).exists():
        run_folder.drop_state(out)
        return Avatar.load(out / run_folder.AVATAR)
    state = run_folder.load_state(out)
    if options.first_steps:
        first, steps = out / run_folder.FIRST_FIT, options.first_steps
        report = part_of_progress(progress, 0, steps, options.all_steps)
        first_options = replace(options, steps=steps, first_steps=0, complete=False)
        small = shrunk_to_tall(video)  # poses need no more
        samples = frame_sampler(video, options, out) if small is video else None
        fit(
            small, body, first_options, first, offsets=offsets, resume=True, progress=report,
            samples=samples,
        )  # fmt: skip
        trained = load_poses(first / run_folder.TRAINED_POSES)[0]
        video = replace(video, pose=trained, stage=2)
        progress = part_of_progress(progress, steps, options.steps, options.all_steps)
    if samples is None:
        samples = frame_sampler(video, options, out)
    offsets = None if options.naked else offsets
    with one_torch_thread():
        run = Run(video, body, options, offsets, state)
        while run.step < options.steps:
            figures = run.follow(samples, distance, out)
            if progress:
                shown = {name: figures[name] for name in ("loss", "gaussians")}
                progress(run.step, options.steps, **shown)
            if run.step % options.checkpoint_every == 0 and run.step < options.steps:
                run_folder.save_state(out, run.state())
        run.finish(samples)
    write_arrays(out / run_folder.HISTORY, **run.history)
    if run.poses.trained:
        save_poses(out / run_folder.TRAINED_POSES, run.poses.all(), video.shape, stage=2)
    run.avatar.save(out / run_folder.AVATAR)
    run_folder.drop_state(out)
    return run.avatar


def frame_sampler(video: Video, options: FitOptions, out: Path) -> FrameSampler:
    """Read the training frames of a fit; ``out`` holds those for which memory has no room."""
    return FrameSampler(
        video, video.splits.train, options.seed, options.window, options.mask_error,
        options.still_camera, out,
    )  # fmt: skip


class Run:
    """State of a run: all that changes from step to step."""

    def __init__(
        self,
        video: Video,
        body: BodyModel,
        options: FitOptions,
        offsets: Tensor | None,
        state: dict[str, Any] | None,
    ) -> None:
        self.options = options
        self.told = None  # how well pictures tell the clothes of each vertex, if parts may touch
        if state is None:
            generator = torch_state(options.seed, RandomStream.SEED)
            colors = seen_colors(video, body, offsets)
            if options.touching and offsets is not None:
                offsets = offsets * (1 - bare_skin(colors, video, body, offsets)[:, None])
                offsets, self.told = clothes_beside_contacts(video, body, offsets)
            self.avatar = seed_avatar(body, video.shape, offsets, options.avatar, generator, colors)
            self.step, self.history = 0, {}
        else:
            self.told = state["told"]
            self.avatar = Avatar.from_record(state["avatar"])
            self.step = state["step"]
            self.history = {name: list(values) for name, values in state["history"].items()}
        rig = self.avatar.rig
        self.poses = TrainedPoses(
            video.pose, video.cameras, rig, options.poses, options.steps,
            as_given=video.stage != 1,
            seen=TrainingLandmarks.of(video, body) if options.poses.trained else None,
            derived=self.avatar.posed_skeleton,
        )  # fmt: skip
        self.lambert = Lambert(self.avatar) if options.avatar.color == "light" else None
        # An alpha shape, as printed, joins the fingers, and arms and trunk.
        self.held = Held(rig, self.told) if options.reinit.surface == "offset" else None
        self.optimizer = make_adam(self.avatar, self.lambert, options.rates, options.complete)
        self._pixel = smallest_pixel(video, rig)
        self.gradients = ScreenGradients(len(self.avatar.canonical))
        if state is not None:
            self.poses.load_state(state["poses"])
            self.optimizer.load_state_dict(state["optimizer"])
            if self.lambert is not None:
                self.lambert.load_state(state["lambert"])
            self.gradients.total, self.gradients.views = state["gradients"]

    def follow(self, samples: FrameSampler, distance: Distance, out: Path) -> dict[str, float]:
        """Take one step with its upkeep by the schedule; return its line of the history."""
        begin = time.perf_counter()
        figures = self.descend(samples, distance)
        self.add_and_remove_gaussians(out)
        figures["milliseconds"] = 1e3 * (time.perf_counter() - begin)
        for name, value in figures.items():
            self.history.setdefault(name, []).append(value)
        return figures

    def descend(self, samples: FrameSampler, distance: Distance) -> dict[str, float]:
        """Take one step of descent on one frame; return its losses."""
        options, sample = self.options, samples[self.step]
        self.poses.expect(samples.frame(k) for k in count(self.step))
        done = self.step / max(1, options.steps - 1)
        lower_rate_of_means(self.optimizer, options.rates, done)
        animated = self.avatar.skin_to(self.poses(sample.frame), self.colors())
        target, screen = sample.target(animated.gaussians), Screen()
        image = render(animated.gaussians, target.camera, AVATAR_SPLATTING, screen=screen)
        weights = options.loss
        if self.step % options.perceptual_every:  # most steps omit it, and others weight it more
            weights = replace(weights, perceptual=0.0)
        losses = render_losses(image, target, animated.residual, weights, distance)
        total = losses.total(weights, options.perceptual_every)
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        self.optimizer.step()
        self.avatar.canonical.decay_slopes(options.rates.sh_decay)
        self.clamp_scales()
        self.gradients.add(screen, sample.area)
        self.step += 1
        self.poses.step(self.step)
        figures = {"step": self.step, "loss": float(total.detach())}
        figures |= {f.name: float(getattr(losses, f.name).detach()) for f in fields(losses)}
        if options.loss.perceptual and not weights.perceptual:  # its last value
            figures["perceptual"] = self.history.get("perceptual", [0.0])[-1]
        figures["gaussians"] = len(self.avatar.canonical)
        return figures

    def add_and_remove_gaussians(self, out: Path) -> None:
        """Run what is due: density control, re-initialisation, binding, and hold what must stay."""
        options, schedule, before = self.options, self.options.schedule, self.avatar.canonical
        if schedule.densifies(self.step, options.steps):
            generator = torch_state(options.seed, RandomStream.DENSIFY, self.step)
            densify(self.avatar, self.optimizer, self.gradients, options.densify, generator)
            self.gradients = ScreenGradients(len(self.avatar.canonical))
        if schedule.reinitialises(self.step, options.steps):
            self._reinitialise(out)
        elif schedule.rebinds_weights(self.step):
            self.avatar.rebind_weights()
        moved = self.avatar.canonical is not before or schedule.rebinds_weights(self.step)
        if self.lambert is not None and moved:
            self.lambert.follow(self.avatar)
        if self.held is not None and self.step % HOLD_EVERY == 0:
            self.held.hold(self.avatar, body=self.step % HOLD_BODY_EVERY == 0)

    def _reinitialise(self, out: Path) -> None:
        """Put the Gaussians back on the surface, where enough of them are opaque to show one."""
        generator = torch_state(self.options.seed, RandomStream.REINIT, self.step)
        before = self.avatar.canonical
        new = reinitialise(self.avatar, self.options.reinit, generator)
        if new is None:
            say(f"{out}: step {self.step}: too few opaque Gaussians, no re-initialisation")
            return
        run_folder.save_snapshot(out, self.step, before, new.canonical, new.surface)
        replace_gaussians(self.avatar, self.optimizer, new.canonical)
        self.avatar.set_skin_weights(new.skin)
        self.gradients = ScreenGradients(len(self.avatar.canonical))

    def colors(self) -> Tensor:
        """Return the colours of the Gaussians: theirs, or Lambert's law and theirs beyond it."""
        sh = self.avatar.canonical.sh
        return sh if self.lambert is None else self.lambert(sh)

    @torch.no_grad()
    def finish(self, samples: FrameSampler) -> None:
        """Give the avatar its colours, and clamp the scales that the last step split."""
        if self.options.complete:
            complete_colors(self.avatar, samples, self.poses.all())
        self.avatar.canonical.sh.copy_(self.colors())
        self.clamp_scales()

    def clamp_scales(self) -> None:
        """Clamp the scales of the Gaussians to the resolution of the pictures."""
        self.avatar.canonical.clamp_scales(self.options.min_scale * self._pixel)

    def state(self) -> dict[str, Any]:
        """Return the whole state of the run for its checkpoint."""
        return {
            "step": self.step,
            "told": self.told,
            "avatar": self.avatar.record(),
            "lambert": None if self.lambert is None else self.lambert.state(),
            "poses": self.poses.state(),
            "optimizer": self.optimizer.state_dict(),
            "gradients": [self.gradients.total, self.gradients.views],
            "history": self.history,
        }


# ε; chosen: about a tenth of the gradient of a Gaussian in plain view.
ADAM_EPSILON = {"means": 1e-5, "sh": 3e-7}
VECTOR_PARAMETERS = ("means", "quats")  # whose coordinates share a v, of one-sided people


def make_adam(
    avatar: Avatar, lambert: Lambert | None, rates: Rates, one_sided: bool = False
) -> torch.optim.Adam:
    """Make Adam with one named group, and one learning rate, for each kind of parameter.

    ``one_sided``: the pictures may show the person from one side only.
    """
    epsilon = 1e-15  # of 3DGS
    groups = [
        {"name": k, "params": [x], "lr": getattr(rates, k), "eps": ADAM_EPSILON.get(k, epsilon)}
        for k, x in avatar.canonical.named_parameters()
    ]
    if avatar.options.residual.enabled:
        params = list(avatar.residual.parameters())
        groups.append({"name": "residual", "params": params, "lr": rates.residual})
    groups.append({"name": "light", "params": [avatar.light], "lr": rates.light})
    if lambert is not None:
        groups.append({"name": "strength", "params": [lambert.strength], "lr": rates.strength})
    adam = AdamOfVectors if one_sided else torch.optim.Adam
    return adam(groups, lr=0.0, eps=epsilon, fused=True)


class AdamOfVectors(torch.optim.Adam):
    """Adam with eq. 9 for the groups named in VECTOR_PARAMETERS, of one parameter (..., D) each."""

    @torch.no_grad()
    def step(self) -> None:
        """Take one step."""
        groups = [group for group in self.param_groups if group["name"] in VECTOR_PARAMETERS]
        gradients = [group["params"][0].grad for group in groups]
        for group in groups:
            group["params"][0].grad = None  # torch's step leaves such parameters alone
        super().step()
        for group, g in zip(groups, gradients, strict=True):
            (x,) = group["params"]
            x.grad = g
            if g is not None:
                self._descend(x, g, group)

    def _descend(self, x: Tensor, g: Tensor, group: dict) -> None:
        """Take a step of eq. 8 and 9."""
        state = self.state[x]
        if not state:
            state["step"] = torch.zeros(())
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(x), torch.zeros_like(x)
        state["step"] += 1
        m, v, k = state["exp_avg"], state["exp_avg_sq"], int(state["step"])
        b1, b2 = group["betas"]
        m.lerp_(g, 1 - b1)
        v.lerp_(g.square().sum(-1, keepdim=True).expand_as(v), 1 - b2)
        away = sqrt(v / (1 - b2**k)).add_(group["eps"])
        x.addcdiv_(m, away, value=-group["lr"] / (1 - b1**k))


def lower_rate_of_means(adam: torch.optim.Adam, rates: Rates, done: float) -> None:
    """Set the learning rate of the means, which falls exponentially; ``done`` from 0 to 1."""
    for group in adam.param_groups:
        if group["name"] == "means":
            group["lr"] = rates.means ** (1 - done) * rates.means_end**done
