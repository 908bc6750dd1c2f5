"""One similarity transform between the world of an avatar and the true one.

One camera that stands still sees a person of twice the size, twice as far away, in the same
pixels. And it sees where the person's surface is, but not where in it the skeleton stands: poses
that are a centimetre too low come with an avatar that lies a centimetre too high on its skeleton.
So a video says neither how large its world is nor, to a centimetre, where its joints are. And
figures of novel views and poses in the *true* world mix that with the quality of the avatar. Both
are told apart by measuring once more after one similarity transform for the whole video, which
changes no picture of it: a scale about the eye, of the camera that was given and of the true one,

    1. s        = argmin Σ_k Σ_j |s (R_c x_kj + t_c) - (R*_c y_kj + t*_c)|²
    2. y        = s R x + t,    R = R*_cᵀ R_c,    t = R*_cᵀ (s t_c - t*_c)

with the joints j of the body, x under the avatar's poses and y the true ones, in the training
frames k. Where the camera moves, s, R and t are those that lay x onto y (Umeyama 1991). How the
skeleton then stands off from the true one, in the axes of its pelvis, is kept as pictures show it,
by all its joints and without what lies along the camera's axis z:

    3. o        = argmin Σ_k |P_k (R_k,root o - mean_j (x_kj - Rᵀ (y_kj - t) / s))|²,
       P_k      = 1 - z_k z_kᵀ

The avatar stays as it is. Poses and cameras of the truth are taken over to its world instead:

    4. camera      R_c (s R x + t) + t_c  ~  (R_c R) x + (R_c t + t_c) / s    pictures have no scale
    5. root        Rᵀ R*_root, with the pelvis at Rᵀ (y_pelvis - t) / s + Rᵀ R*_root o

Only figures use it: nothing is trained with it, and the figures without it stand beside.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import roma
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Rig
from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.truth import POSES, load_truth
from gva_mi.data.video import Video
from gva_mi.splat import Camera

BODY_JOINTS = 22  # of the trunk and the limbs; those of the fingers would count as much


@dataclass(frozen=True)
class Similarity:
    """Eq. 2 and 3, in float64."""

    scale: float
    rotation: np.ndarray  # (3, 3)
    translation: np.ndarray  # (3,) metres
    stance: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) o, metres

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the avatar's world in the true one."""
        return self.scale * points @ self.rotation.T + self.translation

    def camera(self, camera: Camera) -> Camera:
        """A camera of the true world in the avatar's, eq. 4."""
        R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
        T = np.eye(4)
        T[:3, :3] = R @ self.rotation
        T[:3, 3] = (R @ self.translation + t) / self.scale
        return camera.with_matrices(T_camera_world=T)

    def pose(self, pose: Pose, pelvis: Tensor, own_pelvis: Tensor) -> Pose:
        """Poses of the true world in the avatar's, eq. 5.

        Args:
            pose: the true ones, T frames.
            pelvis: (3,) the rest pelvis of the body that they belong to, metres.
            own_pelvis: (3,) that of the avatar.
        """
        R = torch.from_numpy(self.rotation)
        root = R.T @ roma.rotvec_to_rotmat(pose.rotations[:, 0].double())
        place = pose.transl.double() + pelvis - torch.from_numpy(self.translation)
        rotations = pose.rotations.clone()
        rotations[:, 0] = roma.rotmat_to_rotvec(root).to(rotations)
        stance = root @ torch.from_numpy(self.stance)
        transl = (place @ R / self.scale + stance - own_pelvis).to(pose.transl)
        return Pose(rotations, transl, pose.expression)

    def to_json(self) -> dict[str, float]:
        """Its size as a record holds it: scale, turn in degrees, shift in metres."""
        turn = np.degrees(np.arccos(np.clip((np.trace(self.rotation) - 1) / 2, -1, 1)))
        shift = float(np.linalg.norm(self.translation))
        found = {"scale": self.scale, "turn_degrees": float(turn), "shift_m": shift}
        return found | {"stance_m": float(np.linalg.norm(self.stance))}


def umeyama(x: np.ndarray, y: np.ndarray) -> Similarity:
    """The similarity that lays points x onto points y, both (N, 3), with the least squares.

    Raises:
        ValueError: fewer than three points, or all on one line: no turn follows from them.
    """
    mean_x, mean_y = x.mean(0), y.mean(0)
    a, b = x - mean_x, y - mean_y
    U, S, Vt = np.linalg.svd(b.T @ a / len(x))
    if len(x) < 3 or S[1] <= 1e-9 * max(S[0], 1e-30):
        raise ValueError("umeyama(): needs three points at least that are not on one line")
    mirrored = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U @ np.diag(mirrored) @ Vt
    scale = float((S * mirrored).sum() / np.square(a).sum(1).mean())
    return Similarity(scale, R, mean_y - scale * R @ mean_x)


@torch.no_grad()
def similarity_to_truth(rig: Rig, video: Video, body: BodyModel) -> Similarity | None:
    """The similarity of an avatar's world to the true one; None where nothing is known of it.

    Args:
        rig: the avatar's rest body.
        video: opened with the poses that the avatar was trained under.
        body: the body model that was fitted.
    """
    if video.truth is None or not (video.truth / POSES).is_file():
        return None
    truth, frames = load_truth(video.truth, body), video.splits.train
    found = posed_joints(rig, video.pose[frames])
    true = truth.body(truth.pose[frames], truth.shape).joints
    x, y = (joints[:, :BODY_JOINTS].double().numpy() for joints in (found, true))
    given, real = ([cameras[k] for k in frames] for cameras in (video.cameras, truth.cameras))
    stands = all(_same_place(c, some[0]) for some in (given, real) for c in some)
    flat = lambda joints: joints.reshape(-1, 3)
    whole = (
        _about_the_eye(flat(x), flat(y), given[0], real[0])
        if stands
        else umeyama(*map(flat, (x, y)))
    )
    off = (x - (y - whole.translation) @ whole.rotation / whole.scale).mean(1)
    root = roma.rotvec_to_rotmat(video.pose.rotations[frames, 0].double()).numpy()
    z = np.stack([camera.T_camera_world[2, :3] for camera in given])
    return replace(whole, stance=_stance(off, root, z))


def _stance(off: np.ndarray, root: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Eq. 3.

    Args:
        off: (n, 3) by what the joints stand off in n frames, in the mean over them, metres.
        root: (n, 3, 3) turns of the pelvis.
        z: (n, 3) the cameras' axes.

    Returns:
        (3,) metres. What the frames hardly show, for the person turns by less than about a tenth of
        a radian, is left at 0.
    """
    P = np.eye(3) - z[:, :, None] * z[:, None, :]
    matrix = np.einsum("kai,kab,kbj->ij", root, P, root)
    vector = np.einsum("kai,kab,kb->i", root, P, off)
    return np.linalg.pinv(matrix, rcond=0.01, hermitian=True) @ vector


def _about_the_eye(x: np.ndarray, y: np.ndarray, given: Camera, real: Camera) -> Similarity:
    """Eq. 1 and 2 for points (N, 3)."""
    (R, t), (R_real, t_real) = (
        (c.T_camera_world[:3, :3], c.T_camera_world[:3, 3]) for c in (given, real)
    )
    a, b = x @ R.T + t, y @ R_real.T + t_real
    scale = float((a * b).sum() / np.square(a).sum())
    return Similarity(scale, R_real.T @ R, R_real.T @ (scale * t - t_real))


def _same_place(a: Camera, b: Camera) -> bool:
    return np.allclose(a.T_camera_world, b.T_camera_world, atol=1e-9)


@torch.no_grad()
def in_avatars_world(similarity: Similarity, source: Video, rig: Rig, body: BodyModel) -> Video:
    """A true video, with its poses and cameras taken over to the avatar's world.

    Args:
        similarity: of the avatar's world to that of the video.
        source: opened with true poses of ``body``, such as ``truth/novel_pose``.
        rig: the avatar's rest body.
        body: the body model that was fitted.
    """
    pelvis = body.rest(Shape(source.shape.betas)).joints[0].double()
    return replace(
        source,
        pose=similarity.pose(source.pose, pelvis, rig.joints[0].double()),
        cameras=[similarity.camera(camera) for camera in source.cameras],
    )


def posed_joints(rig: Rig, pose: Pose) -> Tensor:
    """An avatar's joints in some poses, (T, 55, 3) metres, world."""
    T_world_rest = joint_transforms(pose.rotations, rig.joints, rig.parents, pose.transl)
    R, t = T_world_rest[..., :3, :3], T_world_rest[..., :3, 3]
    return (R @ rig.joints[..., None])[..., 0] + t
