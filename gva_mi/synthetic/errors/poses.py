"""Errors of stage-1 poses, like those of an estimator that sees single frames.

Rotation errors grow toward hands and feet and persist over some frames; depth has the largest
translation error. :class:`PoseErrors` holds the sizes of all errors.

Some are constant in camera axes over all frames:

* Limbs tilt toward the camera: with A the global rotation of a joint, A_p of its parent, and L
  a constant rotation about the camera's x axis, brought to world axes,

      A' = L A,    that is  R' = A_pᵀ L A_p R  for the rotation R relative to the parent.

* A person estimated s times as large is placed s times as far away. With the focal length estimated
  1 + f times too long, depth grows by this factor: with P the pelvis in camera axes,

      P' = s (P_x, P_y, (1 + f) P_z).

Gross errors occur in some frames only: a hand is lost, and replaced by its mean pose on a straight
wrist; left and right leg are swapped, with mirrored rotations; a frame is spoilt, with errors of
all joints several times as large; the whole person jumps to another place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from gva_mi.body.pose import HANDS, JOINTS, LEFT_HAND, PARENTS, RIGHT_HAND, SIDES, Pose, Shape
from gva_mi.body.rotations import to_matrices, to_rotvecs
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera

LEG = ("hip", "knee", "ankle", "foot")
# Gross errors, chosen: they last a few frames and are plain to see.
LOST_FRAMES, SWAPPED_FRAMES, JUMP_FRAMES = 5.0, 4.0, 4.0  # frames, mean length of a run
MEAN_FINGER_CURL = 0.3  # rad, of each joint in the mean hand
SPOILT_FACTOR = 5.0  # on the errors in a spoilt frame
JUMP_AXES = np.array([0.6, 0.6, 1.5])  # of a jump: right, down, deep; their mean square is near 1
# Root mean square rotation errors, rad, seen from the front; chosen: they grow along the limbs.
ROTATION_ERRORS: Mapping[str, float] = {
    "pelvis": 0.045, "spine1": 0.02, "spine2": 0.02, "spine3": 0.02, "neck": 0.05, "head": 0.07,
    "collar": 0.03, "shoulder": 0.055, "elbow": 0.095, "wrist": 0.16,
    "hip": 0.06, "knee": 0.085, "ankle": 0.15, "foot": 0.15,
}  # fmt: skip
FACE_ERROR, FINGER_ERROR = 0.02, 0.16  # rad: jaw and eyes; every joint of the fingers
JOINTS_OF_PART: Mapping[str, Sequence[str]] = {  # of JointFactors; all other joints are the head's
    "trunk": ("pelvis", "spine1", "spine2", "spine3"),
    "arms": ("collar", "shoulder", "elbow", "wrist"),
    "legs": LEG,
}
LIMBS: Sequence[Sequence[str]] = tuple(  # a burst affects one of them
    tuple(f"{side}_{name}" for name in JOINTS_OF_PART[part])
    for part in ("arms", "legs")
    for side in SIDES
)
BURST_EVERY, BURST_LENGTH = 25.0, 2.5  # frames between bursts on average; half length of one


@dataclass(frozen=True)
class CameraTilt:
    """Tilt of body parts toward the camera, radians; negative is away from it."""

    legs: float = 0.0
    trunk: float = 0.0
    arms: float = 0.0


@dataclass(frozen=True)
class Outliers:
    """Fractions of the frames with gross errors."""

    lost: float = 0.08  # in runs: a hand
    swapped: float = 0.0  # in runs: left and right leg
    whole: float = 0.0  # single frames: all joints
    jumps: float = 0.0  # in runs: the place of the person
    jump: float = 0.08  # m, root mean square distance of a jump


@dataclass(frozen=True)
class JointFactors:
    """Factors on the sizes of rotation errors."""

    trunk: float = 1.0
    head: float = 1.0  # with neck and face
    arms: float = 1.0  # from the collar to the wrist
    legs: float = 1.0
    fingers: float = 1.0


@dataclass(frozen=True)
class PoseErrors:
    """Sizes of the errors of a video's stage-1 poses."""

    sizes: JointFactors = JointFactors()
    memory: float = 5.0  # frames, persistence of the slow part of an error
    white: float = 0.0  # fraction of the variance that is independent from frame to frame
    calm: float = 0.66  # factor on errors of limbs between bursts
    burst: float = 3.1  # largest factor within a burst
    sideways: float = 1.0  # relative growth of errors seen from the side
    depth: float = 0.028  # m, translation along the line of sight
    aside: float = 0.008  # m, across it
    betas: float = 0.25  # standard deviations
    depth_follows: bool = False  # a person estimated larger is placed farther: the picture stays
    expression: float = 0.3  # standard deviations, of all nonzero coefficients
    lean: CameraTilt = CameraTilt()
    focal: float = 0.0  # relative error of the focal length; depth follows
    outliers: Outliers = Outliers()


def noisy_poses(
    body: BodyModel, pose: Pose, shape: Shape, camera: Camera, noise: PoseErrors, rng: Generator
) -> tuple[Pose, Shape]:
    """Draw stage-1 poses of a video from the ground truth.

    The true ``camera`` defines sideways and depth.
    """
    frames, outliers = len(pose), noise.outliers
    strength = (1 + noise.sideways * sideways(pose, camera) ** 2)[:, None]
    sizes = _sizes(noise, frames, rng)
    rotations = pose.rotations.double().numpy().copy()
    for joint, size in enumerate(sizes):
        error = curve(rng, frames, noise.memory, noise.white)
        rotations[:, joint] += strength * size[:, None] * error
    lose_hands(rotations, outliers.lost, rng)
    aside = curve(rng, frames, noise.memory, noise.white)
    aside = aside * np.array([noise.aside, noise.aside, noise.depth]) * np.sqrt(3)
    R_camera_world = camera.T_camera_world[:3, :3]
    transl = pose.transl.double().numpy() + (strength * aside) @ R_camera_world
    error = torch.from_numpy(rng.normal(size=len(shape.betas))).float()
    betas = shape.betas + noise.betas * error
    expression = pose.expression.double().numpy().copy()
    for k in np.flatnonzero(expression.any(0)):
        error = curve(rng, frames, noise.memory, noise.white)
        expression[:, k] += noise.expression * error[:, 0] * np.sqrt(3)

    swap_legs(rotations, outliers.swapped, rng)
    spoil_frames(rotations, sizes, outliers.whole, rng)
    transl += jumps(frames, outliers, rng) @ R_camera_world
    rotations = tilted(rotations, camera, noise.lean)
    grown = _growth(body, shape, Shape(betas)) if noise.depth_follows else 1.0
    joints = (body.rest(shape).joints[0], body.rest(Shape(betas)).joints[0])
    transl = placed(transl, camera, *joints, grown, noise.focal)
    tensor = lambda x: torch.from_numpy(x).to(pose.transl.dtype)
    return Pose(tensor(rotations), tensor(transl), tensor(expression)), Shape(betas)


def sideways(pose: Pose, camera: Camera) -> np.ndarray:
    """Return (T,): 0 if a person is seen from front or back, 1 from the side."""
    facing = to_matrices(pose.rotations[:, 0].numpy())[:, :, 2]
    return np.abs(facing @ camera.T_camera_world[0, :3])


def _sizes(noise: PoseErrors, frames: int, rng: Generator) -> np.ndarray:
    """Draw the root mean square error of each joint's rotation per frame, radians, (55, T)."""
    part = {name: part for part, names in JOINTS_OF_PART.items() for name in names}
    sizes = []
    for name in (joint.split("_")[-1] for joint in JOINTS):
        factor = getattr(noise.sizes, part.get(name, "head"))
        sizes.append(ROTATION_ERRORS.get(name, FACE_ERROR) * factor)
    sizes = np.array(sizes)
    sizes[LEFT_HAND] = sizes[RIGHT_HAND] = FINGER_ERROR * noise.sizes.fingers
    sizes = sizes[:, None] * np.full(frames, 1.0)
    for limb in LIMBS:
        burst = bumps(rng, frames, noise.calm, noise.burst, BURST_EVERY, BURST_LENGTH)
        for name in limb:
            sizes[JOINTS.index(name)] *= burst
    return sizes


def _growth(body: BodyModel, before: Shape, after: Shape) -> float:
    """Return the ratio of body sizes, by the distances of joints from the pelvis."""
    small, large = (body.rest(shape).joints[:22].double() for shape in (before, after))
    return float((large - large[0]).norm() / (small - small[0]).norm())


def estimated_camera(camera: Camera, noise: PoseErrors) -> Camera:
    """Return the camera with the focal length that the estimator assumes."""
    factor = 1 + noise.focal
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)


def tilted(rotations: np.ndarray, camera: Camera, lean: CameraTilt) -> np.ndarray:
    """Tilt rotations (T, 55, 3), axis-angle relative to the parent, toward the camera."""
    parts = {"hip": -lean.legs, "shoulder": -lean.arms, "spine1": lean.trunk}
    of = lambda name: parts.get(name.split("_")[-1], 0)
    angles = {k: of(name) for k, name in enumerate(JOINTS) if of(name) != 0}
    if not angles:
        return rotations
    R = to_matrices(rotations)
    C = camera.T_camera_world[:3, :3]
    rotations, A, turned = rotations.copy(), [], []  # A: global; turned: tilt in front of it
    for joint, parent in enumerate(PARENTS):
        above = np.broadcast_to(np.eye(3), R[:, 0].shape) if parent < 0 else A[parent]
        before = np.eye(3) if parent < 0 else turned[parent]
        A.append(above @ R[:, joint])
        turned.append(before)
        if joint in angles:  # about the x axis of the camera; below 0, limbs swing forward
            L = C.T @ to_matrices([angles[joint], 0.0, 0.0]) @ C
            turned[joint] = L @ before
            local = (before @ above).swapaxes(1, 2) @ L @ before @ A[joint]
            rotations[:, joint] = to_rotvecs(local)
    return rotations


def placed(
    transl: np.ndarray,
    camera: Camera,
    pelvis: Tensor,
    estimated_pelvis: Tensor,
    growth: float,
    focal: float,
) -> np.ndarray:
    """Move translations (T, 3) so that a misjudged size or focal length keeps the picture.

    The person is estimated ``growth`` times as large, the focal length wrong by the fraction
    ``focal``. The pelvises (3,) belong to the true and the estimated shape at rest, metres.
    """
    if growth == 1 and focal == 0:
        return transl
    R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
    P = (transl + pelvis.double().numpy()) @ R.T + t
    P = P * (growth * np.array([1, 1, 1 + focal]))
    return (P - t) @ R - estimated_pelvis.double().numpy()


def lose_hands(rotations: np.ndarray, share: float, rng: Generator) -> None:
    """Replace hands by the mean hand in some frames, in place in ``rotations`` (T, 55, 3)."""
    for side, hand in HANDS.items():
        lost = runs(rng, len(rotations), share, LOST_FRAMES)[:, None, None]
        rotations[:, hand] += lost * (mean_hand(side) - rotations[:, hand])
        rotations[:, [JOINTS.index(f"{side}_wrist")]] *= 1 - lost


def mean_hand(side: str) -> np.ndarray:
    """Return rotations (15, 3) of a relaxed hand."""
    sign = 1.0 if side == "left" else -1.0
    rotations = np.zeros((15, 3))
    rotations[:12, 2] = -sign * MEAN_FINGER_CURL  # all but the thumb
    return rotations


def swap_legs(rotations: np.ndarray, share: float, rng: Generator) -> None:
    """Swap the legs in some frames, in place in ``rotations`` (T, 55, 3)."""
    where = runs(rng, len(rotations), share, SWAPPED_FRAMES)
    left, right = ([JOINTS.index(f"{side}_{name}") for name in LEG] for side in SIDES)
    mirrored = rotations[np.ix_(where, right + left)] * (1, -1, -1)  # in the plane x = 0
    rotations[np.ix_(where, left + right)] = mirrored


def spoil_frames(rotations: np.ndarray, sizes: np.ndarray, share: float, rng: Generator) -> None:
    """Add large errors to all joints in some frames, in place in ``rotations`` (T, 55, 3).

    ``sizes`` (55, T) are the usual root mean square errors, radians.
    """
    where = rng.random(len(rotations)) < share
    error = rng.normal(size=rotations.shape) / np.sqrt(3)
    rotations[where] += (SPOILT_FACTOR * sizes.T[..., None] * error)[where]


def jumps(frames: int, outliers: Outliers, rng: Generator) -> np.ndarray:
    """Draw displacements (T, 3) in camera axes, metres, constant over runs of frames."""
    away = runs(rng, frames, outliers.jumps, JUMP_FRAMES)
    run = np.cumsum(np.diff(away, prepend=False) & away)  # its number, within a run
    where = outliers.jump * rng.normal(size=(frames + 1, 3)) * JUMP_AXES / np.sqrt(3)
    return where[run] * away[:, None]


def curve(rng: Generator, frames: int, memory: float, white: float = 0.0) -> np.ndarray:
    """Draw a random curve (T, 3) of root mean square length 1.

    ``memory`` is the standard deviation, in frames, of the window that smooths its slow part, and
    ``white`` the fraction of the variance that is independent from frame to frame.
    """
    from scipy.ndimage import gaussian_filter1d

    margin = int(3 * memory)
    noise = gaussian_filter1d(rng.normal(size=(frames + 2 * margin, 3)), memory, axis=0)
    slow = _of_unit_size(noise[margin : margin + frames])
    if white == 0:
        return slow
    quick = _of_unit_size(rng.normal(size=(frames, 3)))
    return np.sqrt(1 - white) * slow + np.sqrt(white) * quick


def bumps(
    rng: Generator, frames: int, calm: float, top: float, every: float, length: float
) -> np.ndarray:
    """Draw a curve (T,) that rises from ``calm`` at least half of the way to ``top`` at random.

    Bumps are ``every`` frames apart on average, and ``length`` frames is half their length.
    """
    margin = int(3 * length)
    t = np.arange(frames)
    curve = np.full(frames, calm)
    for centre in range(-margin, frames + margin):
        if rng.random() < 1 / every:
            height = rng.uniform(0.5, 1.0) * (top - calm)
            bump = height * np.exp(-(((t - centre) / length) ** 2) / 2)
            curve = np.maximum(curve, calm + bump)
    return curve


def runs(rng: Generator, frames: int, share: float, length: float) -> np.ndarray:
    """Draw runs of frames, (T,) bool, of mean ``length``, that cover a ``share`` of all frames."""
    start = share / (length * max(1 - share, 0.1))  # probability per frame
    inside = np.zeros(frames, dtype=bool)
    for k in np.flatnonzero(rng.random(frames) < start):
        inside[k : k + rng.poisson(length - 1) + 1] = True
    return inside


def _of_unit_size(curve: np.ndarray) -> np.ndarray:
    return curve / np.sqrt((curve**2).sum(1).mean())
