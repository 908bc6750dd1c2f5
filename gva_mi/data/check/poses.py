"""Numbers of the poses: there, finite, in radians and metres, of a person."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, SMPLX_FIELDS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.check.contents import Contents
from gva_mi.data.check.findings import Finding

# Axis-angle needs no more than half a turn, and no unwrapping makes a limb's more than a whole one.
# In degrees an ordinary bend is ten times as much. The root may have been unwrapped: it turns on.
LARGEST_TURN = 2 * np.pi
FAR, ABSURD = 5.0, 10.0  # standard deviations; one person in three million has a beta above 5
SHORT, TALL = 0.5, 2.75  # m; no adult on record was shorter or taller
JUMP = 1.0  # of the person's height from one frame to the next; at 10 frames a second nobody can


@dataclass(frozen=True)
class Poses:
    """The poses of a file, where all frames have a number."""

    pose: Pose  # T frames; those that are not finite are at rest
    shape: Shape
    good: np.ndarray  # (T,) frames whose numbers are all finite


def check_poses(contents: Contents, body: BodyModel) -> tuple[Poses | None, list[Finding]]:
    """The poses as far as they can be used, and findings about their numbers alone."""
    found: list[Finding] = []
    if contents.poses is None:
        return None, found
    named = dict(_fields(contents.poses, found))
    if named.keys() != {*SMPLX_FIELDS, "transl", "expression"}:  # some are of another form
        return None, found
    good = np.all([np.isfinite(x).all(1) for x in named.values()], axis=0)
    if not good.all():
        found.append(
            Finding(
                "error", "poses are not finite", f"{(~good).sum()} of {len(good)} frames",
                "frames in which the estimator saw nobody",
                "fill them from their neighbours, or leave out these frames' masks",
                tuple(map(int, np.flatnonzero(~good))),
            )
        )  # fmt: skip
    if not good.any():
        return None, found
    shape = _shape(contents.poses, body, found)
    zeroed = {k: torch.from_numpy(np.where(good[:, None], x, 0)) for k, x in named.items()}
    pose = Pose.from_smplx(zeroed)
    found += _rotations(pose, good)
    height = float(np.ptp(body.rest(shape).vertices[:, 1].numpy()))
    if not SHORT < height < TALL:
        found.append(
            Finding(
                "error", "height", f"{height:.2f} m at rest", "betas of another body or order",
                "give the --body that the betas belong to, or zero betas",
            )
        )  # fmt: skip
    found += _jumps(pose, good, height)
    return Poses(pose, shape, good), found


def _fields(
    arrays: dict[str, np.ndarray], found: list[Finding]
) -> Iterator[tuple[str, np.ndarray]]:
    """Each of SMPL-X's fields, (T, width) float32, zero where it may be missing."""
    widths = {name: 3 * (part.stop - part.start) for name, part in SMPLX_FIELDS.items()}
    widths |= {"transl": 3, "expression": None}
    frames = len(arrays["transl"]) if np.ndim(arrays.get("transl")) == 2 else 0
    for name, width in widths.items():
        array = arrays.get(name)
        if array is None and name not in ("global_orient", "body_pose", "transl"):
            yield name, np.zeros((frames, width or 10), np.float32)
            continue
        wanted = f"floating point ({frames or 'T'}, {width or 'E'})"
        if array is None:
            what = f"'{name}' is missing; there are: {', '.join(sorted(arrays))}"
        elif array.dtype.kind != "f" or array.ndim != 2 or not len(array):
            what = f"'{name}' is {array.dtype} {array.shape}"
        elif len(array) != frames or width not in (None, array.shape[1]):
            what = f"'{name}' is {array.shape}"
        else:
            yield name, array.astype(np.float32)
            continue
        found.append(
            Finding(
                "error", "poses of another form", what, "SMPL's names, matrices, or a list a frame",
                f"{wanted} axis-angle; gva-mi prepare brings estimators' files into this form",
            )
        )  # fmt: skip


def _shape(arrays: dict[str, np.ndarray], body: BodyModel, found: list[Finding]) -> Shape:
    """The person's betas; zero where they cannot be used."""
    betas = np.asarray(arrays.get("betas", np.zeros(0)))
    if betas.ndim == 2 and len(betas) and (betas == betas[:1]).all():
        betas = betas[0]
    say = lambda severity, figure, cause, remedy: found.append(
        Finding(severity, "betas", figure, cause, remedy)
    )
    nothing = Shape(torch.zeros(0))
    if "betas" not in arrays or betas.ndim != 1 or betas.dtype.kind != "f":
        figure = f"{betas.dtype} {betas.shape}" if "betas" in arrays else "missing"
        say("error", figure, "one for each frame, or none", "(B,), one person for all frames")
        return nothing
    if not np.isfinite(betas).all():
        say("error", "not finite", "an estimate that failed", "zero betas, the mean person")
        return nothing
    if np.abs(betas[body.num_betas :]).max(initial=0) > 0:
        say(
            "error", f"{len(betas)}, the body has {body.num_betas}", "they belong to another body",
            "give the --body that they belong to",
        )  # fmt: skip
        return nothing
    largest = float(np.abs(betas).max(initial=0))
    if largest > FAR:
        severity = "error" if largest > ABSURD else "doubtful"
        say(
            severity, f"up to {largest:.1f} standard deviations",
            "of another body, fitted to a wrong distance, or no betas at all",
            "give the --body they belong to, or zero betas",
        )  # fmt: skip
    return nothing if largest > ABSURD else Shape(torch.from_numpy(betas.astype(np.float32)))


def _rotations(pose: Pose, good: np.ndarray) -> Iterator[Finding]:
    turns = pose.rotations[:, 1:].norm(dim=-1).numpy()
    wide = (turns > LARGEST_TURN).any(1) & good
    if wide.any():
        frame, joint = np.unravel_index(turns.argmax(), turns.shape)
        name = JOINTS[joint + 1]
        yield Finding(
            "error", "rotations", f"{name} turns by {turns.max():.3g} in frame {frame}",
            "degrees, or another form than axis-angle", "axis-angle in radians",
            tuple(map(int, np.flatnonzero(wide))),
        )  # fmt: skip


def _jumps(pose: Pose, good: np.ndarray, height: float) -> Iterator[Finding]:
    steps = pose.transl.diff(dim=0).norm(dim=-1).numpy() / max(height, SHORT)
    wide = (steps > JUMP) & good[1:] & good[:-1]
    if wide.any():
        yield Finding(
            "doubtful", "jumps", f"up to {steps[wide].max():.3g} times the person's height",
            "the track changes to somebody else, frames are missing, or no metres",
            "choose the person again, or cut the video here",
            tuple(int(k) + 1 for k in np.flatnonzero(wide)),
        )  # fmt: skip
