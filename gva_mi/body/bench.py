"""How fast the body model is: stage by stage, for one frame and for a batch of them.

The body is random and as large as the licensed files are: 10,000 vertices, pose directions without
a zero. Times are wall clock, the least and the median of repeated calls, with gradients of all
vertices to poses, expression, translation and betas; on a shared machine trust ratios of one run.

One frame must read the directions once each way, and nothing else is as large: ``directions`` is
the rate at which it does so, to be held against what the machine's memory can give.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.blend_shapes import add_directions
from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import PARENTS, Pose, Shape
from gva_mi.body.skinning import skin_points
from gva_mi.body.smplx import BodyModel

VERTICES = 10_000
FRAMES = (1, 100)
_WARM_UP = 3  # calls before the first that counts


@dataclass(frozen=True)
class StageTimes:
    """How long one stage of the model takes, or the whole."""

    name: str
    forward: tuple[float, float]  # ms, least and median
    both: tuple[float, float]  # ms, forward and backward


@dataclass(frozen=True)
class Batch:
    """All stages for one number of frames."""

    frames: int
    stages: tuple[StageTimes, ...]  # the last is the whole
    directions: float  # 1e9 bytes of directions per second, forward and backward, at the least time


@dataclass(frozen=True)
class BodyBench:
    """All figures of one run."""

    vertices: int
    threads: int  # of torch
    batches: tuple[Batch, ...]

    def to_dict(self) -> dict:
        """For JSON."""
        return asdict(self)

    def table(self) -> str:
        """For a person to read."""
        ms = lambda t: f"{t[0]:9.2f} {t[1]:9.2f}"
        lines = [f"{self.vertices:,} vertices, dense pose directions, {self.threads} threads"]
        for batch in self.batches:
            frames = "1 frame" if batch.frames == 1 else f"{batch.frames} frames"
            lines += ["", f"{frames:22}{'forward, ms':>19}  {'and backward, ms':>19}"]
            lines.append(f"{'':22}{'least':>9} {'median':>9}  {'least':>9} {'median':>9}")
            lines += [f"{s.name:22}{ms(s.forward)}  {ms(s.both)}" for s in batch.stages]
            if batch.frames == 1:
                lines.append(f"directions read at {batch.directions:.1f} GB/s")
        return "\n".join(lines)


def bench_body(repeats: int, seed: int, vertices: int = VERTICES) -> BodyBench:
    """Measure the model.

    Args:
        repeats: calls per figure.
        seed: of the body and its poses.
        vertices: how many.
    """
    body = random_body(vertices, np.random.default_rng(seed))
    generator = torch.Generator().manual_seed(seed)
    batches = tuple(_batch(body, frames, repeats, generator) for frames in FRAMES)
    return BodyBench(vertices, torch.get_num_threads(), batches)


def random_body(vertices: int, rng: np.random.Generator) -> BodyModel:
    """A body of random numbers, in the shapes of a licensed file."""
    normal = lambda *size: rng.standard_normal(size, dtype=np.float32)
    weights = rng.random((vertices, 55), dtype=np.float32) ** 12
    regressor = np.zeros((55, vertices), np.float32)
    regressor[np.arange(55), rng.integers(0, vertices, 55)] = 1
    return BodyModel({
        "v_template": normal(vertices, 3),
        "f": rng.integers(0, vertices, (2 * vertices, 3)),
        "shapedirs": 0.01 * normal(vertices, 3, 20),
        "posedirs": 0.001 * normal(vertices, 3, 486),
        "J_regressor": regressor,
        "weights": weights / weights.sum(1, keepdims=True),
    })  # fmt: skip


def _batch(body: BodyModel, frames: int, repeats: int, generator: torch.Generator) -> Batch:
    """Each stage apart, and the whole, for one number of frames."""
    normal = lambda *size: torch.randn(*size, generator=generator)
    leaf = lambda *size: (0.3 * normal(*size)).requires_grad_()
    rotations, transl, expression = leaf(frames, 55, 3), leaf(frames, 3), leaf(frames, 10)
    betas, joints = leaf(10), leaf(frames, 55, 3)
    vertices, directions = len(body.v_template), body.frame_directions
    surface, moves = leaf(1, 3 * vertices), leaf(frames, len(directions))
    points, T_world_rest = leaf(frames, vertices, 3), leaf(frames, 55, 4, 4)
    pose = lambda: Pose(rotations, transl, expression)
    stages = {
        "joints": (
            lambda: turn_joints(rotations, joints, PARENTS, transl)[1],
            (rotations, joints, transl),
        ),
        "blend shapes": (lambda: add_directions(surface, moves, directions), (surface, moves)),
        "skinning": (lambda: skin_points(points, body.weights, T_world_rest), (T_world_rest,)),
        "body": (
            lambda: body(pose(), Shape(betas)).vertices,
            (rotations, transl, expression, betas),
        ),
    }
    measured = tuple(_stage(name, *stage, repeats) for name, stage in stages.items())
    shapes = next(s for s in measured if s.name == "blend shapes")
    moved = 2 * directions.numel() * directions.element_size()
    return Batch(frames, measured, moved / shapes.both[0] / 1e6)


def _stage(
    name: str, forward: Callable[[], Tensor], leaves: tuple[Tensor, ...], repeats: int
) -> StageTimes:
    grad = torch.ones_like(forward())
    both = lambda: torch.autograd.grad(forward(), leaves, grad)
    return StageTimes(name, _timed(forward, repeats), _timed(both, repeats))


def _timed(call: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Milliseconds, least and median."""
    times = []
    for k in range(_WARM_UP + repeats):
        start = time.perf_counter()
        call()
        if k >= _WARM_UP:
            times.append(1e3 * (time.perf_counter() - start))
    return min(times), statistics.median(times)
