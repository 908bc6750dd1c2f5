"""Errors that are constant in camera axes over all frames.

* Limbs tilt toward the camera: with A the global rotation of a joint, A_p that of its parent, and L
  a constant rotation about the camera's x axis, brought to world axes,

      A' = L A,    that is  R' = A_pᵀ L A_p R  for the rotation R relative to the parent.

* A person estimated s times as large is placed s times as far away. With the focal length estimated
  1 + f times too long, depth grows by this factor: with P the pelvis in camera axes,

      P' = s (P_x, P_y, (1 + f) P_z).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.body.rotations import to_matrices, to_rotvecs
from gva_mi.splat import Camera


@dataclass(frozen=True)
class CameraTilt:
    """Tilt of body parts toward the camera, radians; negative is away from it."""

    legs: float = 0.0
    trunk: float = 0.0
    arms: float = 0.0


def tilted(
    rotations: np.ndarray, camera: Camera, lean: CameraTilt, level: float = 1.0
) -> np.ndarray:
    """Tilt rotations (T, 55, 3), axis-angle relative to the parent, toward the camera.

    ``level`` is a factor on the tilt.
    """
    parts = {"hip": -lean.legs, "shoulder": -lean.arms, "spine1": lean.trunk}
    angles = {k: level * parts.get(name.split("_")[-1], 0) for k, name in enumerate(JOINTS)}
    angles = {k: angle for k, angle in angles.items() if angle != 0}
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
    ``focal``. The pelvises (3,) are those of the true and the estimated shape at rest, metres.
    """
    if growth == 1 and focal == 0:
        return transl
    R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
    P = (transl + pelvis.double().numpy()) @ R.T + t
    P = P * (growth * np.array([1, 1, 1 + focal]))
    return (P - t) @ R - estimated_pelvis.double().numpy()
