"""One similarity transform between the world of an avatar and the ground truth's.

One static camera shows a person of twice the size, twice as far away, in the same pixels. It also
shows where the person's surface is, but not where the skeleton is inside it: poses a centimetre too
low come with an avatar that lies a centimetre too high on its skeleton. Errors of novel views and
poses in the *true* world mix that with the quality of the avatar. So they are measured once more
after one similarity transform for the whole video, which changes none of its pictures: a scale
about the eye, with the given camera c and the true one c*,

    1. s        = argmin Σ_k Σ_j |s (R_c x_kj + t_c) - (R*_c y_kj + t*_c)|²
    2. y        = s R x + t,    R = R*_cᵀ R_c,    t = R*_cᵀ (s t_c - t*_c)

over the joints j of the body, x under the avatar's poses and y the true ones, in the training
frames k. If the camera moves, nothing is aligned. The offset o of the skeleton
from the true one, in the axes of its pelvis, is what pictures show of it, without the part along
the camera's axis z:

    3. o        = argmin Σ_k |P_k (R_k,root o - mean_j (x_kj - Rᵀ (y_kj - t) / s))|²,
       P_k      = 1 - z_k z_kᵀ

The avatar stays as it is; true poses and cameras are transformed into its world:

    4. camera      R_c (s R x + t) + t_c  ~  (R_c R) x + (R_c t + t_c) / s    pictures have no scale
    5. root        Rᵀ R*_root, with the pelvis at Rᵀ (y_pelvis - t) / s + Rᵀ R*_root o

A focal length that was estimated wrongly, f instead of f*, puts the person f / f* times as far
away. So true cameras first get the focal length f, and true poses that distance (:func:`zoomed`).

Only evaluation uses it, and figures without it are reported beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.rig import Rig
from gva_mi.body.kinematics import joint_places, joint_transforms
from gva_mi.body.pose import ROOT_AND_BODY, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import to_matrix, to_rotvec
from gva_mi.splat import Camera
from gva_mi.subject.ground_truth import truth_of
from gva_mi.subject.video import Video


@dataclass(frozen=True)
class Similarity:
    """Eq. 2 and 3, in float64."""

    scale: float
    rotation: np.ndarray  # (3, 3)
    translation: np.ndarray  # (3,) metres
    stance: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) o, metres
    zoom: float = 1.0  # f / f*, the given focal length by the true one

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Transform points (..., 3) from the avatar's world to the true one."""
        return self.scale * points @ self.rotation.T + self.translation

    def camera(self, camera: Camera) -> Camera:
        """Transform a camera from the true world to the avatar's, eq. 4."""
        R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
        T = np.eye(4)
        T[:3, :3] = R @ self.rotation
        T[:3, 3] = (R @ self.translation + t) / self.scale
        return camera.with_matrices(T_camera_world=T)

    def pose(self, pose: Pose, pelvis: Tensor, own_pelvis: Tensor) -> Pose:
        """Transform true poses to the avatar's world, eq. 5.

        Args:
            pose: T frames.
            pelvis, own_pelvis: (3,) rest pelvis of their body and of the avatar, metres.
        """
        R = torch.from_numpy(self.rotation)
        root = R.T @ to_matrix(pose.rotations[:, 0].double())
        place = pose.transl.double() + pelvis - torch.from_numpy(self.translation)
        rotations = pose.rotations.clone()
        rotations[:, 0] = to_rotvec(root).to(rotations)
        stance = root @ torch.from_numpy(self.stance)
        transl = (place @ R / self.scale + stance - own_pelvis).to(pose.transl)
        return Pose(rotations, transl, pose.expression)

    def to_json(self) -> dict[str, float]:
        """Summarise it for a file: the scale, and the stance in metres."""
        return {"scale": self.scale, "stance_m": float(np.linalg.norm(self.stance))}


@torch.no_grad()
def similarity_to_truth(rig: Rig, video: Video, body: BodyModel) -> Similarity | None:
    """Return the similarity from an avatar's world to the true one.

    None without ground truth, and for a camera that moves.

    Args:
        rig: the avatar's rest body.
        video: opened with the poses that the avatar was trained under.
        body: the fitted body model.
    """
    truth, frames = truth_of(video, body), video.splits.train
    if truth is None:
        return None
    zoom = video.cameras[0].fx / truth.cameras[0].fx
    pelvis = truth.body.rest(truth.shape).joints[0]
    true_pose, true_cameras = zoomed(truth.pose, pelvis, truth.cameras, zoom)
    found = posed_joints(rig, video.pose[frames])
    true = truth.body(true_pose[frames], truth.shape).joints
    # Finger joints would outnumber those of trunk and limbs.
    x, y = (joints[:, ROOT_AND_BODY].double().numpy() for joints in (found, true))
    given, real = ([cameras[k] for k in frames] for cameras in (video.cameras, true_cameras))
    placed = [np.stack([c.T_camera_world for c in group]) for group in (given, real)]
    if not all(np.allclose(T, T[0], atol=1e-9) for T in placed):
        return None
    whole = _about_the_eye(x.reshape(-1, 3), y.reshape(-1, 3), given[0], real[0])
    off = (x - (y - whole.translation) @ whole.rotation / whole.scale).mean(1)
    root = to_matrix(video.pose.rotations[frames, 0].double()).numpy()
    z = np.stack([camera.T_camera_world[2, :3] for camera in given])
    return replace(whole, stance=_stance(off, root, z), zoom=zoom)


def zoomed(
    pose: Pose, pelvis: Tensor, cameras: Sequence[Camera], zoom: float
) -> tuple[Pose, Sequence[Camera]]:
    """Return cameras of a focal length ``zoom`` times as long, and poses so much farther away.

    The pelvis moves along the camera's axis to ``zoom`` times its depth, and keeps its place in the
    picture. What lies before or behind it looks flatter through a longer lens.

    Args:
        pose: T frames.
        pelvis: (3,) of the body at rest, metres.
        cameras: T of them.
        zoom: 1 returns what was given.
    """
    if zoom == 1:
        return pose, cameras
    T = torch.from_numpy(np.stack([camera.T_camera_world for camera in cameras]))
    R, t = (x.to(pose.transl) for x in (T[:, :3, :3], T[:, :3, 3]))
    axis = R[:, 2]  # of the camera, in the world
    depth = ((pelvis + pose.transl) * axis).sum(1) + t[:, 2]
    transl = pose.transl + (zoom - 1) * depth[:, None] * axis
    moved = Pose(pose.rotations, transl, pose.expression)
    return moved, [camera.zoomed(zoom) for camera in cameras]


def _stance(off: np.ndarray, root: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Solve eq. 3 for o (3,), metres.

    What frames hardly show, because the person turns by less than about 0.1 rad, is left at 0.

    Args:
        off: (n, 3) mean offset of the joints in n frames, metres.
        root: (n, 3, 3) rotations of the pelvis.
        z: (n, 3) the cameras' axes.
    """
    P = np.eye(3) - z[:, :, None] * z[:, None, :]
    matrix = np.einsum("kai,kab,kbj->ij", root, P, root)
    vector = np.einsum("kai,kab,kb->i", root, P, off)
    return np.linalg.pinv(matrix, rcond=0.01, hermitian=True) @ vector


def _about_the_eye(x: np.ndarray, y: np.ndarray, given: Camera, real: Camera) -> Similarity:
    """Solve eq. 1 and 2 for points (N, 3)."""
    matrices = (camera.T_camera_world for camera in (given, real))
    (R, t), (R_real, t_real) = ((T[:3, :3], T[:3, 3]) for T in matrices)
    a, b = x @ R.T + t, y @ R_real.T + t_real
    scale = float((a * b).sum() / np.square(a).sum())
    return Similarity(scale, R_real.T @ R, R_real.T @ (scale * t - t_real))


@torch.no_grad()
def in_avatars_world(similarity: Similarity, source: Video, rig: Rig, body: BodyModel) -> Video:
    """Transform the poses and cameras of a ground-truth video to the avatar's world.

    Args:
        similarity: from the avatar's world to the video's.
        source: opened with true poses of ``body``, such as ``truth/novel_pose``.
        rig: the avatar's rest body.
        body: the fitted body model.
    """
    pelvis = body.rest(Shape(source.shape.betas)).joints[0]
    pose, cameras = zoomed(source.pose, pelvis, source.cameras, similarity.zoom)
    return replace(
        source,
        pose=similarity.pose(pose, pelvis.double(), rig.joints[0].double()),
        cameras=[similarity.camera(camera) for camera in cameras],
    )


def posed_joints(rig: Rig, pose: Pose) -> Tensor:
    """Return an avatar's joints in T poses, (T, 55, 3) metres, world."""
    T_world_rest = joint_transforms(pose.rotations, rig.joints, rig.parents, pose.transl)
    return joint_places(T_world_rest, rig.joints)
