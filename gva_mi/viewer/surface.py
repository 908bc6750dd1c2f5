"""The surface and the skeleton under an avatar's Gaussians, in one pose; and the surface drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar, Rig, moved_by
from gva_mi.body.pose import Pose
from gva_mi.body.skinning import skin_points
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import CLAY
from gva_mi.splat import Camera, exclusive


@dataclass(frozen=True)
class Surface:
    """The rig in one pose."""

    vertices: Tensor  # (V, 3) float32, world, metres
    joints: np.ndarray  # (55, 3) world, metres


@torch.no_grad()
def posed_surface(avatar: Avatar, rig: Rig, pose: Pose) -> Surface:
    """The rig's surface and joints in a pose (of one frame), moved as the Gaussians are."""
    driven = avatar.driven(pose)
    vertices = rig.vertices + moved_by(driven.coefficients, rig.directions)
    R, t = driven.T_world_rest[:, :3, :3], driven.T_world_rest[:, :3, 3]
    joints = (R @ driven.joints.unsqueeze(-1)).squeeze(-1) + t
    skinned = skin_points(vertices, rig.weights, driven.T_world_rest)
    return Surface(skinned.float(), joints.double().numpy())


class SurfaceDrawing:
    """Draws one surface, in any pose and from anywhere."""

    def __init__(self, rig: Rig) -> None:
        self._scene = MeshScene(rig.faces, rig.vertices.float())

    def normals(self, surface: Surface, camera: Camera, samples: int = 1) -> np.ndarray:
        """Camera-space normals, OpenCV's axes, as colours: ``(n + 1) / 2``, (H, W, 4)."""
        seen = self._seen(surface, camera, samples)
        return _layer((seen[..., :3] + 1) / 2, seen[..., 3], samples)

    def shaded(self, surface: Surface, camera: Camera, samples: int = 1) -> np.ndarray:
        """Clay, lit by a lamp on the camera, (H, W, 4)."""
        seen = self._seen(surface, camera, samples)
        light = 0.2 + 0.75 * np.clip(-seen[..., 2:3], 0, 1)
        return _layer(light * np.float32(CLAY), seen[..., 3], samples)

    @torch.no_grad()
    def _seen(self, surface: Surface, camera: Camera, samples: int) -> np.ndarray:
        """Normals and mask, (samples H, samples W, 4).

        It is the mesh that moves, into the camera's space: a scene keeps the sensor of each camera
        that it has seen, and browsers have many.
        """
        camera = camera.resized(samples * camera.width, samples * camera.height)
        T = torch.from_numpy(camera.T_camera_world.copy())
        vertices = (surface.vertices.double() @ T[:3, :3].T + T[:3, 3]).float()
        with exclusive:
            image = self._scene.render(vertices, replace(camera, T_camera_world=np.eye(4)))
        return image.numpy()


def _layer(color: np.ndarray, mask: np.ndarray, samples: int) -> np.ndarray:
    """Colour (H, W, 3) and mask (H, W) as a layer, the mean of ``samples`` squared pixels each."""
    mask = mask[..., None]
    layer = np.concatenate([color * mask, mask], axis=2).astype(np.float32)
    height, width = (n // samples for n in layer.shape[:2])
    return layer.reshape(height, samples, width, samples, 4).mean((1, 3))
