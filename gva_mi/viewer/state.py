"""What defines a picture of the viewer, as values: equal values give equal pictures.

A state holds how an avatar differs from the motion that drives it:

    R_j' = R_j exp([r_j]×),    psi' = psi + e

So joint j is turned by r_j in every frame, about its own axes there. Joints and expressions that
were not changed keep their bits.

A browser orbits a point about a fixed axis. That axis is the person's own upright, because a video
does not show which way is up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch.nn.functional import pad

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.rig import Rig, moved_by
from gva_mi.body.kinematics import joint_places
from gva_mi.body.pose import Pose
from gva_mi.body.skinning import skin_points
from gva_mi.body.so3 import compose
from gva_mi.fit.renders import CameraPath, cylinder, shots
from gva_mi.splat import Camera, Gaussians
from gva_mi.splat.reference import rotation
from gva_mi.subject.pictures import MOST_PIXELS

Mode = Literal["Gaussians", "surface", "skeleton"]
Angles = tuple[float, float, float]  # degrees about x, y and z: a rotation vector
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class State:
    """Everything that defines a picture, except for the browser's camera."""

    frame: int = 0  # of the motion
    mode: Mode = "Gaussians"
    turned: tuple[tuple[int, Angles], ...] = ()  # joint numbers and r_j
    expression: tuple[float, ...] = ()  # e: as many coefficients as the avatar has, or none
    background: tuple[int, int, int] = (255, 255, 255)  # 8-bit
    beside: bool = False  # the video's frame, and the avatar through the video's camera


def posed(motion: Pose, state: State) -> Pose:
    """Return the motion's pose of one frame with the state's changes applied."""
    pose = motion[state.frame]
    rotations, expression = pose.rotations, pose.expression
    for joint, angles in state.turned:
        if any(angles):
            r = torch.tensor(angles, dtype=rotations.dtype) * (math.pi / 180)
            rotations = rotations.clone()
            rotations[0, joint] = compose(rotations[0, joint], r)
    if any(state.expression):
        added = torch.tensor([state.expression], dtype=expression.dtype)
        width = max(added.shape[1], expression.shape[1])
        expression = sum(pad(x, (0, width - x.shape[1])) for x in (expression, added))
    return Pose(rotations, pose.transl, expression)


@dataclass(frozen=True)
class ShownPose:
    """An avatar in one pose."""

    gaussians: Gaussians
    vertices: np.ndarray  # (V, 3) float32: the rig's surface, world, metres
    joints: np.ndarray  # (55, 3) world, metres

    @staticmethod
    @torch.no_grad()
    def of(avatar: Avatar, pose: Pose) -> ShownPose:
        """Pose the Gaussians, and the surface and joints of the rig (one frame) as they are."""
        rig, skeleton = avatar.rig, avatar.posed_skeleton(pose)
        vertices = rig.vertices + moved_by(skeleton.coefficients, rig.directions)[0]
        T_world_rest = skeleton.T_world_rest[0].to(vertices.dtype)
        joints = joint_places(T_world_rest, skeleton.joints[0]).double().numpy()
        skinned = skin_points(vertices, rig.weights, T_world_rest)
        return ShownPose(avatar(pose), skinned.float().numpy(), joints)


@dataclass(frozen=True)
class ViewerCamera:
    """The camera of a browser; equal numbers are the same view."""

    position: Vector  # metres, world
    wxyz: tuple[float, float, float, float]  # R_world_camera, OpenCV's axes
    fov: float  # radians, over the height of the picture
    width: int  # pixels
    height: int  # pixels

    def usable(self) -> bool:
        """Return whether a picture can be drawn: a hidden browser window has no pixels."""
        numbers = np.array([*self.position, *self.wxyz, self.fov])
        pixels = min(self.width, self.height) >= 2 and self.width * self.height <= MOST_PIXELS
        unit = abs(np.linalg.norm(self.wxyz) - 1) < 1e-3
        return bool(pixels and np.isfinite(numbers).all() and unit and 0 < self.fov < np.pi)

    def to_camera(self) -> Camera:
        """Return the camera that the renderer uses."""
        R_world_camera = rotation(torch.tensor(self.wxyz, dtype=torch.float64)).numpy()
        T_camera_world = np.eye(4)
        T_camera_world[:3, :3] = R_world_camera.T
        T_camera_world[:3, 3] = -R_world_camera.T @ np.array(self.position)
        focal = self.height / (2 * np.tan(self.fov / 2))
        middle = self.width / 2, self.height / 2
        return Camera(focal, focal, *middle, T_camera_world, self.width, self.height)


@dataclass(frozen=True)
class Start:
    """The view that browsers start with."""

    position: np.ndarray  # (3,) metres
    look_at: np.ndarray  # (3,) metres: what they orbit
    up: np.ndarray  # (3,) unit: the axis of their orbits
    fov: float  # radians


def start(rig: Rig, motion: Pose) -> Start:
    """Return a view from in front of the person that shows all of the motion."""
    camera, around = shots(CameraPath("static"), rig, motion)[0].camera, cylinder(rig, motion)
    fov = 2 * np.arctan(camera.height / (2 * camera.fy))
    return Start(camera.position, around.centre, around.up, float(fov))
