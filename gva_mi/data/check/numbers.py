"""Check for readable but implausible numbers: lenses, pose angles, body sizes, speeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.check.problems import Problem, doubt, error
from gva_mi.data.importers.one_lens import ONE_LENS, seen_alike, usual_lens
from gva_mi.splat import Camera

# A lens's axis meets the middle of a picture to a few percent. K of a picture 1.25 times as large
# has it an eighth of the width away.
OFF_CENTRE = 0.12  # of width or height
ANAMORPHIC = 1.5  # fx over fy: the widest pixels of any video standard, 16:9 in PAL, are 1.46
EVENLY = 0.1  # by which the scales of width and height may differ: lenses are not quite centred
# Axis-angle needs no more than half a turn, and no unwrapping makes a limb's more than a whole one.
# In degrees an ordinary bend is ten times as much. The root may have been unwrapped: it turns on.
LARGEST_TURN = 2 * np.pi
FAR, ABSURD = 5.0, 10.0  # standard deviations; one person in three million has a beta above 5
SHORT, TALL = 0.5, 2.75  # m; no adult on record was shorter or taller
JUMP = 1.0  # of the person's height from one frame to the next; at 10 frames a second nobody can


def check_intrinsics(cameras: Sequence[Camera]) -> Iterator[Problem]:
    """Yield problems of focal lengths and principal points."""
    uneven = [c.fx / c.fy for c in cameras if max(c.fx / c.fy, c.fy / c.fx) > ANAMORPHIC]
    if uneven:
        yield doubt("focal length", f"fx / fy is {uneven[0]:.3g}", "normalised by width and "
                    "height, or scaled in one direction", "fx, fy in pixels")  # fmt: skip
    at = np.array([(c.cx / c.width, c.cy / c.height) for c in cameras])
    off = (np.abs(at - 0.5) > OFF_CENTRE).any(1)
    focal = np.array([c.fx for c in cameras])
    # Estimators that look at a person's box have another lens in each frame, with the box's axis.
    of_boxes = (np.abs(focal / np.median(focal) - 1) > ONE_LENS).mean() > 0.5
    if off.any() and not of_boxes:
        first = int(off.argmax())
        scaled = centred(cameras[first]) is not cameras[first]
        yield doubt(
            "principal point", "at {:.2f} of the width, {:.2f} of the height".format(*at[first]),
            f"K is of pictures {2 * at[first][0]:.3g} times as large" if scaled
            else "the pictures are crops, or K is of others",
            "scale K with the pictures, or subtract a crop's corner from cx, cy",
            np.flatnonzero(off) if not off.all() else (),
        )  # fmt: skip


def centred(camera: Camera) -> Camera:
    """Return the camera scaled so that its axis meets the picture's middle, if one scale does."""
    if not (camera.cx > 0 and camera.cy > 0):
        return camera
    half = camera.width / 2, camera.height / 2
    x, y = half[0] / camera.cx, half[1] / camera.cy
    if abs(x / y - 1) > EVENLY or abs(1 / x - 1) <= 2 * OFF_CENTRE:
        return camera
    return replace(camera, fx=camera.fx * x, fy=camera.fy * y, cx=half[0], cy=half[1])


def check_poses(
    pose: Pose, shape: Shape, body: BodyModel, cameras: Mapping[int, Camera]
) -> Iterator[Problem]:
    """Yield problems of the numbers alone; ``cameras`` are those of frames that have one."""
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
    places = pose.transl.double().numpy() + body.rest(shape).joints[0].double().numpy()
    if set(cameras) >= set(range(len(places))):
        places = _before_one_lens(places, [cameras[k] for k in range(len(places))])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.clip(height, SHORT, TALL)
    wide = steps > JUMP
    if wide.any():
        yield doubt("jumps", f"up to {steps[wide].max():.3g} times the person's height",
                    "the track changes to somebody else, frames are missing, or no metres",
                    "choose the person again, or cut the video here",
                    np.flatnonzero(wide) + 1)  # fmt: skip


def _before_one_lens(places: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
    """Return pelvises (T, 3), world, where one usual lens shows the same pictures.

    Most estimators assume a lens many times too long, or another one in each frame.
    """
    T = np.stack([c.T_camera_world for c in cameras])
    K = np.stack([c.K for c in cameras])
    seen = np.einsum("tij,tj->ti", T[:, :3, :3], places) + T[:, :3, 3]
    seen = seen_alike(seen, K, usual_lens(K))
    return np.einsum("tji,tj->ti", T[:, :3, :3], seen - T[:, :3, 3])
