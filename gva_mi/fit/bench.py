"""How fast a fit is: a step, stage by stage, a re-initialisation, and an avatar that is driven.

The person is the puppet in stripes, as tall as the picture but for a margin, and turns; the avatar
lies on it already, with so many Gaussians. Times are wall clock, the least and the median of
repeated steps; on a shared machine trust ratios of one run. One step in ``perceptual_every`` has
the perceptual term, so Eq. 9 is timed with and without it, and the mean step has its share.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch

from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.avatar.reinit import reinitialise
from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.data.pictures import write_image
from gva_mi.data.video import Video, load_video, save_cameras
from gva_mi.fit.losses import render_losses
from gva_mi.fit.options import FitOptions
from gva_mi.fit.perceptual import rand_vgg_loss
from gva_mi.fit.renders import DRAWN, render_frame
from gva_mi.fit.samples import Samples, Stream, torch_state
from gva_mi.fit.train import Run
from gva_mi.splat import Camera, Screen, look_at, render
from gva_mi.threads import one_torch_thread

FRAMES = 9  # of the turn; every eighth is a test frame
FILLED = 0.8  # of the picture's height by the person
DISTANCE = 3.0  # metres to the camera
_WARM_UP = 4  # steps before the first that counts
_REINITS = 5  # re-initialisations at most: one takes as long as dozens of steps


@dataclass(frozen=True)
class Stage:
    """How long one part of a step takes."""

    name: str
    least: float  # ms
    median: float  # ms

    @staticmethod
    def of(name: str, milliseconds: list[float]) -> Stage:
        """From its times in several steps."""
        return Stage(name, min(milliseconds), statistics.median(milliseconds))


@dataclass(frozen=True)
class FitBench:
    """All figures of one run."""

    gaussians: int
    size: int  # pixels, width and height of the pictures
    stages: tuple[Stage, ...]
    step: Stage  # the mean over steps with and without the perceptual term
    reinitialisation: Stage  # one; a fit has two
    driven: Stage  # skinning and splatting alone

    def to_dict(self) -> dict:
        """For JSON."""
        return asdict(self)

    def table(self) -> str:
        """For a person to read."""
        lines = [f"{self.gaussians:,} Gaussians, {self.size} x {self.size} pixels"]
        lines.append(f"{'ms':34}{'least':>9}{'median':>9}")
        for stage in (*self.stages, self.step, self.reinitialisation, self.driven):
            lines.append(f"{stage.name:34}{stage.least:9.2f}{stage.median:9.2f}")
        lines.append(f"driven at {1e3 / self.driven.median:.0f} frames a second")
        return "\n".join(lines)


def bench_fit(repeats: int, seed: int, gaussians: int = 20_000, size: int = 512) -> FitBench:
    """Measure a fit.

    Args:
        repeats: steps per figure.
        seed: of the run.
        gaussians: of the avatar.
        size: of the pictures, pixels.
    """
    body = load_body()
    seeds = SeedOptions(count=gaussians)
    options = FitOptions(steps=10**6, seed=seed, avatar=AvatarOptions(seed=seeds))
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        video = _turning(Path(folder), body, seeds, size)
        run = Run(video, body, options, None, None)
        samples = Samples(video, video.splits.train, seed, True, options.window, options.mask_error)
        stages = _stages(run, samples, repeats)
        step = _steps(run, samples, repeats)
        driven = _driven(run, video, repeats)
        reinitialisation = _reinitialisation(run, min(repeats, _REINITS))
    return FitBench(len(run.avatar.canonical), size, stages, step, reinitialisation, driven)


def _turning(folder: Path, body: BodyModel, seeds: SeedOptions, size: int) -> Video:
    """The puppet in stripes, turning once before the camera."""
    x = body.v_template
    stripes = 0.5 + 0.4 * torch.sin(torch.stack([19 * x[:, 0], 31 * x[:, 1], 17 * x.sum(1)], 1))
    shape, pose = Shape(torch.zeros(body.num_betas)), Pose.rest(FRAMES)
    pose.rotations[:, 0, 1] = 2 * torch.pi * torch.arange(FRAMES) / FRAMES
    avatar = seed_avatar(body, shape, None, AvatarOptions(seed=seeds), colors=stripes)
    low, high = x.amin(0), x.amax(0)
    center = ((low + high) / 2).numpy()
    focal = FILLED * size * DISTANCE / float(high[1] - low[1])
    view = look_at(center + (0, 0, DISTANCE), center)
    camera = Camera(focal, focal, size / 2, size / 2, view, size, size)
    for k in range(FRAMES):
        with torch.no_grad():
            alpha = render(avatar(pose[k]), camera, DRAWN).alpha
        write_image(folder / f"frames/{k:06d}.png", render_frame(avatar, pose[k], camera))
        write_image(folder / f"masks/{k:06d}.png", alpha.numpy())
    save_poses(folder / "poses.npz", pose, shape, stage=1)
    save_cameras(folder / "cameras.npz", [camera])
    return load_video(folder)


def _stages(run: Run, samples: Samples, repeats: int) -> tuple[Stage, ...]:
    """A step taken apart."""
    distance, clock = rand_vgg_loss(), _Clock()
    weights = {"Eq. 9 and back, with VGG": run.options.loss}
    weights["Eq. 9 and back, without"] = replace(run.options.loss, perceptual=0.0)
    for k in range(_WARM_UP + repeats):
        if k == _WARM_UP:
            clock = _Clock()
        sample = samples[k]
        with clock("pose"):
            pose = run.poses(sample.frame)
        with clock("avatar"):
            animated = run.avatar.animate(pose)
        g = animated.gaussians
        with clock("target"):
            target = sample.target(g)
        with clock("splatting"):
            image = render(g, target.camera, run.options.splat, screen=Screen())
        seen = image.color, image.alpha
        for name, loss in weights.items():
            with clock(name):
                losses = render_losses(
                    target.before_background(image), target.color, target.mask,
                    animated.residual, loss, distance, target.window, sample.area,
                )  # fmt: skip
                grad = torch.autograd.grad(losses.total(loss), seen)
        leaves = tuple(g.arrays().values())
        with clock("splatting, back"):
            grads = torch.autograd.grad(seen, leaves, grad)
        with clock("avatar and pose, back"):
            torch.autograd.backward(leaves, grads)
        with clock("Adam"):
            run.optimizer.step()
        run.optimizer.zero_grad(set_to_none=True)
    return tuple(Stage.of(name, found) for name, found in clock.times.items())


def _steps(run: Run, samples: Samples, repeats: int) -> Stage:
    """Whole steps as a fit takes them."""
    distance, every = rand_vgg_loss(), run.options.perceptual_every
    clock = _Clock()
    for k in range(every * (_WARM_UP + repeats)):
        if k == every * _WARM_UP:
            clock = _Clock()
        sample = samples[run.step]
        with clock(str(run.step % every)):
            run.descend(sample, distance)
    kinds = [Stage.of(name, found) for name, found in clock.times.items()]
    mean = lambda figure: sum(getattr(kind, figure) for kind in kinds) / every
    return Stage("a step, in the mean", mean("least"), mean("median"))


def _reinitialisation(run: Run, repeats: int) -> Stage:
    """A surface around the Gaussians, and as many laid on it; nothing is replaced."""
    clock, name = _Clock(), "a re-initialisation"
    for k in range(repeats):
        generator = torch_state(run.options.seed, Stream.REINIT, k)
        with clock(name):
            reinitialise(run.avatar, run.options.reinit, generator)
    return Stage.of(name, clock.times[name])


def _driven(run: Run, video: Video, repeats: int) -> Stage:
    """The avatar in the video's poses, without gradients."""
    clock = _Clock()
    for k in range(_WARM_UP + repeats):
        if k == _WARM_UP:
            clock = _Clock()
        frame = k % len(video)
        with clock("driven"), torch.no_grad():
            render(run.avatar(video.pose[frame]), video.cameras[frame], run.options.splat)
    return Stage.of("driven, without gradients", clock.times["driven"])


class _Clock:
    """Milliseconds of what is done within ``with clock(name)``, by name."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.times.setdefault(name, []).append(1e3 * (time.perf_counter() - start))
