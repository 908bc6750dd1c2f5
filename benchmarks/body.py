"""Time the body model stage by stage, for one frame and for a batch.

The body is random and as large as licensed files: 10,000 vertices, dense pose directions.
Gradients are of all vertices by poses, expression, translation and betas.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from benchmarks.timing import Table, timed
from gva_mi.body.blend_shapes import add_directions
from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import PARENTS, Pose, Shape
from gva_mi.body.skinning import skin_points
from gva_mi.body.smplx import BodyModel


def run(
    repeats: int, seed: int, vertices: int = 10_000, frames: tuple[int, ...] = (1, 100)
) -> Iterator[Table]:
    """Yield one table per number of frames."""
    body = random_body(vertices, np.random.default_rng(seed))
    generator = torch.Generator().manual_seed(seed)
    for count in frames:
        threads = torch.get_num_threads()
        title = f"body model, {vertices:,} vertices, {count} frame(s), {threads} threads"
        rows = []
        for name, (forward, leaves) in _stages(body, count, generator).items():
            both = _with_gradients(forward, leaves)
            there, back = timed(forward, repeats), timed(both, repeats)
            figures = {"forward min ms": there.minimum, "median ms": there.median}
            figures |= {"and backward min ms": back.minimum, "its median ms": back.median}
            rows.append({"": name} | figures)
        yield Table(title, rows)


def random_body(vertices: int, rng: np.random.Generator) -> BodyModel:
    """Make a body of random numbers with the array shapes of a licensed file."""
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


Stage = tuple[Callable[[], Tensor], tuple[Tensor, ...]]  # a call, and what it is differentiated by


def _stages(body: BodyModel, frames: int, generator: torch.Generator) -> dict[str, Stage]:
    leaf = lambda *size: (0.3 * torch.randn(*size, generator=generator)).requires_grad_()
    rotations, transl, expression = leaf(frames, 55, 3), leaf(frames, 3), leaf(frames, 10)
    betas, joints = leaf(10), leaf(frames, 55, 3)
    vertices, directions = len(body.v_template), body.frame_directions
    surface, moves = leaf(1, 3 * vertices), leaf(frames, len(directions))
    points, T_world_rest = leaf(frames, vertices, 3), leaf(frames, 55, 4, 4)
    whole = lambda: body(Pose(rotations, transl, expression), Shape(betas)).vertices
    return {
        "joints": (lambda: turn_joints(rotations, joints, PARENTS, transl)[1],
                   (rotations, joints, transl)),
        "blend shapes": (lambda: add_directions(surface, moves, directions), (surface, moves)),
        "skinning": (lambda: skin_points(points, body.weights, T_world_rest), (T_world_rest,)),
        "whole body": (whole, (rotations, transl, expression, betas)),
    }  # fmt: skip


def _with_gradients(
    forward: Callable[[], Tensor], leaves: tuple[Tensor, ...]
) -> Callable[[], object]:
    grad = torch.ones_like(forward())
    return lambda: torch.autograd.grad(forward(), leaves, grad)
