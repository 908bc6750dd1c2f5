"""Numbers of the poses: radians and metres, of a person."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.check.problems import Problem, doubt, error

# Axis-angle needs no more than half a turn, and no unwrapping makes a limb's more than a whole one.
# In degrees an ordinary bend is ten times as much. The root may have been unwrapped: it turns on.
LARGEST_TURN = 2 * np.pi
FAR, ABSURD = 5.0, 10.0  # standard deviations; one person in three million has a beta above 5
SHORT, TALL = 0.5, 2.75  # m; no adult on record was shorter or taller
JUMP = 1.0  # of the person's height from one frame to the next; at 10 frames a second nobody can


def check_poses(pose: Pose, shape: Shape, body: BodyModel) -> Iterator[Problem]:
    """Yield problems of the numbers alone."""
    largest = float(shape.betas.abs().max()) if len(shape.betas) else 0.0
    if largest > FAR:
        yield (error if largest > ABSURD else doubt)(
            "betas", f"up to {largest:.1f} standard deviations",
            "of another body, fitted to a wrong distance, or no betas at all",
            "give the --body they belong to, or zero betas",
        )  # fmt: skip
    height = float(np.ptp(body.rest(shape).vertices[:, 1].numpy()))
    if not SHORT < height < TALL and largest <= ABSURD:
        yield error("height", f"{height:.2f} m at rest", "betas of another body or order",
                    "give the --body that the betas belong to, or zero betas")  # fmt: skip
    turns = pose.rotations[:, 1:].norm(dim=-1).numpy()
    wide = (turns > LARGEST_TURN).any(1)
    if wide.any():
        frame, joint = np.unravel_index(turns.argmax(), turns.shape)
        figure = f"{JOINTS[joint + 1]} turns by {turns.max():.3g} in frame {frame}"
        yield error("rotations", figure, "degrees, or another form than axis-angle",
                    "axis-angle in radians", np.flatnonzero(wide))  # fmt: skip
    steps = pose.transl.diff(dim=0).norm(dim=-1).numpy() / np.clip(height, SHORT, TALL)
    wide = steps > JUMP
    if wide.any():
        yield doubt("jumps", f"up to {steps[wide].max():.3g} times the person's height",
                    "the track changes to somebody else, frames are missing, or no metres",
                    "choose the person again, or cut the video here",
                    np.flatnonzero(wide) + 1)  # fmt: skip
