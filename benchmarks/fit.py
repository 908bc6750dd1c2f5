"""Time a fit: a step by its stages, a re-initialisation, and a driven avatar; a refinement's step.

The subject is the built-in body in stripes, 0.8 of the picture's height, and turns; the avatar lies
on it already. One step in ``perceptual_every`` has the perceptual term: Eq. 9 is timed with and
without it, and the mean step includes its share.

A refinement renders ``mesh_normals`` of the built-in body (22,000 faces), which fills the height of
the picture. The body moves a little at each step, so that nothing can be reused.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import drjit as dr
import numpy as np
import torch

from benchmarks.timing import WARM_UP, Clock, Table, Timing
from gva_mi.avatar.avatar import AVATAR_SPLATTING, AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.avatar.reinit import reinitialise
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.core.cpu import one_torch_thread
from gva_mi.fit.losses import render_losses
from gva_mi.fit.options import FitOptions
from gva_mi.fit.perceptual import rand_vgg_loss
from gva_mi.fit.renders import render_frame
from gva_mi.fit.samples import FrameSampler, RandomStream, torch_state
from gva_mi.fit.train import Run
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera, Screen, look_at, render
from gva_mi.subject.folder import SubjectWriter
from gva_mi.subject.video import Video, load_video

FRAMES = 9  # of the turn; chosen: eight train frames, as every eighth is a test frame
HEIGHT_SHARE = 0.8  # of the picture's height, filled by the subject; chosen: as in a video
EYE_DISTANCE = 3.0  # metres from the subject to the camera; chosen: as in a video
VERTEX_STEP = 1e-3  # metres from one step to the next; chosen: as far as a refinement moves


def run(repeats: int, gaussians: int = 20_000, size: int = 512) -> Iterator[Table]:
    """Yield the stages of a step, whole steps, re-initialisations, driven frames; mesh_normals."""
    body, seeds = load_body(), SeedOptions(count=gaussians)
    options = FitOptions(steps=10**6, avatar=AvatarOptions(seed=seeds))
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        video = _turning(Path(folder), body, seeds, size)
        fit = Run(video, body, options, None, None)
        samples = FrameSampler(video, video.splits.train, 0, options.window, options.mask_error)
        title = f"fit, {gaussians:,} Gaussians, {size} x {size} pixels"
        clock = Clock()
        _stages(fit, samples, repeats, clock)
        yield clock.table(f"{title}: a step", WARM_UP)
        clock = Clock()
        step = _mean_step(fit, samples, repeats)
        for k in range(WARM_UP + repeats):
            frame = k % len(video)
            with clock("a frame of the driven avatar"), torch.no_grad():
                render(fit.avatar(video.pose[frame]), video.cameras[frame], AVATAR_SPLATTING)
        for k in range(WARM_UP + min(repeats, 5)):  # one takes as long as dozens of steps
            generator = torch_state(0, RandomStream.REINIT, k)
            with clock("a re-initialisation"):
                reinitialise(fit.avatar, options.reinit, generator)
        table = clock.table(f"{title}: as a whole", WARM_UP)
        table.rows.insert(0, {"": "a step, mean"} | step.columns)
        yield table
    yield from _mesh_normals(repeats, (size // 2, size))


def _mesh_normals(repeats: int, sizes: tuple[int, ...]) -> Iterator[Table]:
    """Yield one table per size of picture (pixels)."""
    body = load_body()
    scene, template = MeshScene(body.faces, body.v_template), body.v_template
    import mitsuba as mi  # its variant is chosen by MeshScene

    centre = template.mean(0).numpy()
    T_camera_world = look_at(centre + (0.2, 0.1, 2.6), centre)
    for size in sizes:
        camera = Camera(1.2 * size, 1.2 * size, size / 2, size / 2, T_camera_world, size, size)
        noise = np.random.default_rng(0).normal(size=(size, size, 4))
        grad, clock = mi.TensorXf(noise.astype(np.float32)), Clock()
        for k in range(WARM_UP + repeats):
            moved = template + VERTEX_STEP * (k + 1)
            with clock("whole step"):
                with clock("ray tracer's update"):
                    scene.show(moved)
                with clock("image"):
                    view = scene.view(moved, camera)
                    dr.eval(view.image())
                with clock("adjoint"):
                    dr.eval(view.adjoint(grad))
        title = f"mesh_normals, {len(body.faces):,} faces, {size} x {size} pixels, 1 ray a pixel"
        yield clock.table(title, WARM_UP)


def _turning(folder: Path, body: BodyModel, seeds: SeedOptions, size: int) -> Video:
    """Make a video of the built-in body in stripes, turning once before the camera."""
    x = body.v_template
    stripes = 0.5 + 0.4 * torch.sin(torch.stack([19 * x[:, 0], 31 * x[:, 1], 17 * x.sum(1)], 1))
    shape, pose = Shape(torch.zeros(body.num_betas)), Pose.rest(FRAMES)
    pose.rotations[:, 0, 1] = 2 * torch.pi * torch.arange(FRAMES) / FRAMES
    avatar = seed_avatar(body, shape, None, AvatarOptions(seed=seeds), colors=stripes)
    low, high = x.amin(0), x.amax(0)
    center = ((low + high) / 2).numpy()
    focal = HEIGHT_SHARE * size * EYE_DISTANCE / float(high[1] - low[1])
    view = look_at(center + (0, 0, EYE_DISTANCE), center)
    camera = Camera(focal, focal, size / 2, size / 2, view, size, size)
    writer = SubjectWriter(folder)
    for k in range(FRAMES):
        with torch.no_grad():
            alpha = render(avatar(pose[k]), camera, AVATAR_SPLATTING).alpha
        writer.frame(k, render_frame(avatar, pose[k], camera))
        writer.mask(k, alpha.numpy())
    writer.poses(pose, shape, stage=1)
    writer.cameras([camera])
    return load_video(folder)


def _stages(fit: Run, samples: FrameSampler, repeats: int, clock: Clock) -> None:
    """Time the stages of one step."""
    distance = rand_vgg_loss()
    weights = {"Eq. 9 and back, with VGG": fit.options.loss}
    weights["Eq. 9 and back, without"] = replace(fit.options.loss, perceptual=0.0)
    every = fit.options.poses.every
    for k in range(WARM_UP + repeats):
        sample, frames = samples[k], [samples.frame(k + j) for j in range(every)]
        with clock(f"{every} poses, one step in {every}"):
            fit.poses.expect(frames)
        skeleton = fit.poses(sample.frame)
        with clock("avatar, colours by Lambert's law"):
            animated = fit.avatar.skin_to(skeleton, fit.colors())
        g = animated.gaussians
        with clock("target"):
            target = sample.target(g)
        with clock("splatting"):
            screen = Screen()
            image = render(g, target.camera, AVATAR_SPLATTING, screen=screen)
        seen = image.color, image.alpha
        for name, loss in weights.items():
            with clock(name):
                losses = render_losses(image, target, animated.residual, loss, distance)
                grad = torch.autograd.grad(losses.total(loss), seen)
        leaves = tuple(g.arrays().values())
        with clock("splatting, back"):
            grads = torch.autograd.grad(seen, leaves, grad)
        with clock("avatar, back"):
            torch.autograd.backward(leaves, grads)
        with clock("Adam"):
            fit.optimizer.step()
        with clock("scales, slopes, gradients on the screen"):
            fit.avatar.canonical.decay_slopes(fit.options.rates.sh_decay)
            fit.clamp_scales()
            fit.gradients.add(screen, sample.area)
        for frame in frames[1:]:
            (0 * fit.poses(frame).T_world_rest).sum().backward()
        with clock(f"{every} poses, back, one step in {every}"):
            fit.poses.step((k + 1) * every)
        fit.optimizer.zero_grad(set_to_none=True)


def _mean_step(fit: Run, samples: FrameSampler, repeats: int) -> Timing:
    """Time whole steps of a fit: the mean over steps with and without the perceptual term."""
    distance, every, clock = rand_vgg_loss(), fit.options.perceptual_every, Clock()
    for _ in range(every * (WARM_UP + repeats)):
        with clock(str(fit.step % every)):
            fit.descend(samples, distance)
    kinds = [Timing.of(times[WARM_UP:]) for times in clock.times.values()]
    mean = lambda figures: sum(figures) / every
    return Timing(mean(kind.minimum for kind in kinds), mean(kind.median for kind in kinds))
