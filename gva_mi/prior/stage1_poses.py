"""Stage-1 poses of chosen frames: axes of their joints, and the places of joints in the picture.

Estimators fit the joints to the picture. So their errors are mostly depths, and what is wrong at a
shoulder is undone at the elbow: a hand lies where the picture shows it, though no rotation on the
way is right. Corrections that turn the trunk would carry the hands away, and no outline says where
a hand before the trunk is. With the displacement ``d`` of a joint across its line of sight, metres,
:class:`SeenJoints` costs

1. ``E = Σ_k Σ_j (ν + 2) / 2m · log(1 + |d_kj|² / ν σ²)``,   ``median |d|² = 1.39 σ²``

where ``m`` frames count as one. ``σ`` is inferred from the corrections that images made without
this term, by a median over all frames and joints: hidden joints hold what the others show. If it
is large, stage 1 was not fitted to these pictures, and the term is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.body.kinematics import joint_places, turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.body.so3 import compose, turns_between
from gva_mi.core.cpu import sqrt
from gva_mi.prior.error_model import STUDENT_DOF, median_of_square
from gva_mi.splat import Camera


@dataclass(frozen=True)
class Stage1Poses:
    """Stage-1 poses of n frames, which are corrected in the camera's axes.

    Attributes:
        times: (n,) frame numbers, ascending.
        pose: of the n frames.
        R_joint_camera: (n, J, 3, 3) rotate a vector from the camera's axes to a joint's axes.
        R_camera_world: (3, 3).
    """

    times: Tensor
    pose: Pose
    R_joint_camera: Tensor
    R_camera_world: Tensor

    @staticmethod
    def of(pose: Pose, frames: Sequence[int], camera: Camera) -> Stage1Poses:
        """Take some frames of a video by their numbers, ascending.

        If cameras differ, the axes of one frame's ``camera`` serve for all.
        """
        chosen = pose[list(frames)]
        R_camera_world = torch.from_numpy(camera.T_camera_world[:3, :3].copy()).float()
        at_origin = torch.zeros(1, len(PARENTS), 3)
        T_world_rest = turn_joints(chosen.rotations, at_origin, PARENTS, chosen.transl)[1]
        R_joint_camera = torch.einsum("kjai,ca->kjic", T_world_rest[..., :3, :3], R_camera_world)
        return Stage1Poses(torch.tensor(list(frames)), chosen, R_joint_camera, R_camera_world)

    @property
    def turn_amount(self) -> float:
        """Amount by which the person turns: 1 for a full turn, 0.6 for half, 0 for none."""
        # Without a turn the mean rotation has square norm 3, after a full one a third of it.
        stays = self.R_joint_camera[:, 0].mean(0).square().sum() / 3
        return float((1.5 * (1 - stays)).clamp(0, 1))

    def corrected(self, which: Sequence[int], turns: Tensor, moves: Tensor) -> Pose:
        """Correct r of the n frames.

        Args:
            which: the r frames, by index.
            turns: (r, J, 3) in the camera's axes, radians.
            moves: (r, 3) in the camera's axes, metres.
        """
        which = list(which)
        local = self.to_joint_axes(turns, which)
        rotations = compose(self.pose.rotations[which], local)
        transl = self.pose.transl[which] + moves @ self.R_camera_world
        return Pose(rotations, transl, self.pose.expression[which])

    def to_joint_axes(self, turns: Tensor, which: Sequence[int] | slice = slice(None)) -> Tensor:
        """Rotate vectors (r, J, 3) from the camera's axes to the joints' axes."""
        return (self.R_joint_camera[which] @ turns[..., None])[..., 0]

    def to_camera_axes(self, turns: Tensor, which: Sequence[int] | slice = slice(None)) -> Tensor:
        """Rotate vectors (r, J, 3) from the joints' axes to the camera's axes."""
        return (self.R_joint_camera[which].mT @ turns[..., None])[..., 0]

    def steps(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return how poses of the n frames change from frame to frame.

        Returns:
            Turns (n - 1, J, 3) in the joints' axes, and shifts (n - 1, 3) in the camera's axes.
        """
        turns = turns_between(pose.rotations[:-1], pose.rotations[1:])
        return turns, pose.transl.diff(dim=0) @ self.R_camera_world.T


# m of eq. 1. Chosen on two tuning persons: with 6, as for angles, hands still became worse.
CORRELATED_FRAMES = 2.0
# Metres, range of σ. Chosen: landmarks and joints of body models differ by the first. The second
# lies between poses solved from landmarks (10 to 17 mm) and simulated errors (slow: from 18.5;
# the demo: 22), to which the term does harm.
SMALLEST_ASIDE, LARGEST_ASIDE = 0.01, 0.018
NEAREST_DEPTH = 0.1  # metres in front of the camera; chosen: nearer joints are taken as if there
_SEEN = ("elbow", "wrist", "middle1", "knee", "ankle", "foot", "head")
SEEN_JOINTS = [k for k, name in enumerate(JOINTS) if name.split("_")[-1] in _SEEN]


@dataclass(frozen=True)
class SeenJoints:
    """Penalise joints that leave the places where stage 1 has them in the picture (eq. 1).

    Attributes:
        joints: (J, 3) of the person at rest, metres.
        T_camera_world: (4, 4) of one frame's camera, which serves for all.
        places: (n, L, 3) of :data:`SEEN_JOINTS` by stage 1, in the camera's axes, metres.
        sigma: σ, metres; None: the term is left out.
    """

    joints: Tensor
    T_camera_world: Tensor
    places: Tensor
    sigma: float | None = None

    @staticmethod
    @torch.no_grad()
    def of(stage1: Stage1Poses, joints: Tensor, camera: Camera) -> SeenJoints:
        """Take the places of joints (J, 3) from stage 1; the term is left out until inferred."""
        T = torch.from_numpy(camera.T_camera_world.copy()).float()
        seen = SeenJoints(joints.detach(), T, joints)
        return replace(seen, places=seen._places(stage1.pose.rotations, stage1.pose.transl))

    @torch.no_grad()
    def inferred(self, pose: Pose) -> SeenJoints:
        """Return the term with ``σ`` of poses that images corrected."""
        square = self._aside(pose.rotations, pose.transl).square().sum(-1).median()
        sigma = float(sqrt(square / median_of_square(2)))
        kept = sigma <= LARGEST_ASIDE
        return replace(self, sigma=max(sigma, SMALLEST_ASIDE) if kept else None)

    def energy(self, rotations: Tensor, transl: Tensor, times: Tensor) -> Tensor:
        """Return eq. 1; see :class:`gva_mi.prior.inference.PriorTerm`."""
        if self.sigma is None:
            return rotations.new_zeros(())
        off = self._aside(rotations, transl).square().sum(-1) / (STUDENT_DOF * self.sigma**2)
        return (STUDENT_DOF + 2) / (2 * CORRELATED_FRAMES) * torch.log1p(off).sum()

    def _aside(self, rotations: Tensor, transl: Tensor) -> Tensor:
        """Return ``d`` (n, L, 2) of n poses, metres."""
        rays = lambda x: x[..., :2] / x[..., 2:].clamp_min(NEAREST_DEPTH)
        return (rays(self._places(rotations, transl)) - rays(self.places)) * self.places[..., 2:]

    def _places(self, rotations: Tensor, transl: Tensor) -> Tensor:
        T_world_rest = turn_joints(rotations, self.joints, PARENTS, transl)[1][:, SEEN_JOINTS]
        x, T = joint_places(T_world_rest, self.joints[SEEN_JOINTS]), self.T_camera_world
        return x @ T[:3, :3].T + T[:3, 3]
