"""Errors that hang on the camera and are the same in every frame.

* What hangs from a joint leans toward the camera: with A the global rotation of a joint, A_p that
  of its parent, L a constant rotation about the camera's x axis, brought to world axes,

      A' = L A,    that is  R' = A_pᵀ L A_p R  for the rotation R relative to the parent.

* A person taken for s times as large is put s times as far away, and one seen with a focal length
  that is taken for 1 + f times the true one is put 1 + f times as deep: with P the pelvis in
  camera axes,

      P' = s (P_x, P_y, (1 + f) P_z).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import roma
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.splat import Camera

HANGS = {"legs": ("left_hip", "right_hip"), "arms": ("left_shoulder", "right_shoulder")}
STANDS = {"trunk": ("spine1",)}  # on its joint: what is above goes forward with it


@dataclass(frozen=True)
class Lean:
    """How far parts of the body lean toward the camera, radians; below 0 they lean away."""

    legs: float = 0.0
    trunk: float = 0.0
    arms: float = 0.0

    def times(self, factor: float) -> Lean:
        """The same, larger or smaller."""
        return replace(
            self, legs=factor * self.legs, trunk=factor * self.trunk, arms=factor * self.arms
        )

    def _angles(self) -> dict[int, float]:
        """About the camera's x axis, by joint; below 0 brings forward what hangs down."""
        down = {name: -getattr(self, part) for part, names in HANGS.items() for name in names}
        up = {name: getattr(self, part) for part, names in STANDS.items() for name in names}
        return {JOINTS.index(name): a for name, a in (down | up).items() if a != 0}


def leaning(rotations: np.ndarray, camera: Camera, lean: Lean) -> np.ndarray:
    """Rotations (T, 55, 3) of a person who leans; radians, axis-angle relative to the parent."""
    angles = lean._angles()
    if not angles:
        return rotations
    R = matrices(rotations.reshape(-1, 3)).reshape(*rotations.shape, 3)
    C = camera.T_camera_world[:3, :3]
    rotations, A, turned = rotations.copy(), [], []  # A: global; turned: what was put before it
    for joint, parent in enumerate(PARENTS):
        above = np.broadcast_to(np.eye(3), R[:, 0].shape) if parent < 0 else A[parent]
        before = np.eye(3) if parent < 0 else turned[parent]
        A.append(above @ R[:, joint])
        turned.append(before)
        if joint in angles:
            L = C.T @ matrices(np.array([[angles[joint], 0.0, 0.0]]))[0] @ C
            turned[joint] = L @ before
            local = (before @ above).swapaxes(1, 2) @ L @ before @ A[joint]
            rotations[:, joint] = roma.rotmat_to_rotvec(torch.from_numpy(local)).numpy()
    return rotations


def placed(
    transl: np.ndarray,
    camera: Camera,
    pelvis: Tensor,
    believed_pelvis: Tensor,
    growth: float,
    focal: float,
) -> np.ndarray:
    """Translations (T, 3) that keep the picture where size or focal length are misjudged.

    Args:
        transl: metres, world.
        camera: the true view.
        pelvis: (3,) of the true shape at rest, metres; ``transl`` is added to it.
        believed_pelvis: (3,) of the shape that is believed.
        growth: how many times as large the person is taken for.
        focal: by which share the focal length is taken for longer.
    """
    if growth == 1 and focal == 0:
        return transl
    R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
    P = (transl + pelvis.double().numpy()) @ R.T + t
    P = P * (growth * np.array([1, 1, 1 + focal]))
    return (P - t) @ R - believed_pelvis.double().numpy()


def matrices(rotvecs: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) of axis-angle vectors (N, 3)."""
    return roma.rotvec_to_rotmat(torch.from_numpy(rotvecs)).numpy()
