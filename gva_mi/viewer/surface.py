"""Pose and draw the surface and the skeleton under an avatar's Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.rig import Rig, moved_by
from gva_mi.body.kinematics import joint_places
from gva_mi.body.pose import LEFT_HAND, Pose
from gva_mi.body.skinning import skin_points
from gva_mi.data.normals import normal_colors
from gva_mi.mesh.coarse_body import collapse
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import BLUE, CLAY, OUTLINE
from gva_mi.splat import Camera, exclusive

COARSE_FACES = 5000  # while something moves
NEAR = 0.05  # metres; if part of the surface is nearer or behind, the whole picture is drawn
COLORS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {  # of normals, by the viewer's mode
    "normals": normal_colors,
    "mesh": lambda n: (0.2 + 0.75 * np.clip(-n[..., 2:], 0, 1)) * np.float32(CLAY),  # lit from here
}
BONE = (0.25, 0.27, 0.30)
FINE = LEFT_HAND.start  # joints from this number on belong to fingers and are drawn thinner
THICK = 400  # picture height / width of a bone, which is at least a pixel
SAMPLES = 2  # per pixel and axis of a fine picture


@dataclass(frozen=True)
class PosedSurface:
    """Surface and joints of an avatar's rig in one pose."""

    vertices: Tensor  # (V, 3) float32, world, metres
    joints: np.ndarray  # (55, 3) world, metres


@torch.no_grad()
def posed_surface(avatar: Avatar, pose: Pose) -> PosedSurface:
    """Pose the rig's surface and joints (one frame) the way the Gaussians are."""
    rig, skeleton = avatar.rig, avatar.posed_skeleton(pose)
    vertices = rig.vertices + moved_by(skeleton.coefficients, rig.directions)
    T_world_rest = skeleton.T_world_rest.to(vertices.dtype)
    joints = joint_places(T_world_rest, skeleton.joints)
    skinned = skin_points(vertices, rig.weights, T_world_rest)
    return PosedSurface(skinned.float(), joints.double().numpy())


class SurfaceRenderer:
    """Draw one surface in any pose from any camera.

    For each pose Mitsuba rebuilds its ray tracing tree, which takes most of the time. So a coarse
    mesh is drawn while something moves. A moving camera costs less.
    """

    def __init__(self, rig: Rig) -> None:
        vertices, every = rig.vertices.float(), torch.arange(len(rig.vertices))
        self._fine = _Mesh(MeshScene(rig.faces, vertices), every)
        self._coarse = self._fine
        if len(rig.faces) > COARSE_FACES:
            kept, faces = collapse(vertices, rig.faces, COARSE_FACES)
            self._coarse = _Mesh(MeshScene(faces, vertices[kept]), kept)

    def layer(self, mode: str, surface: PosedSurface, camera: Camera, fine: bool) -> np.ndarray:
        """Draw "normals" or "mesh" (clay): (H, W, 4) float32, premultiplied colour and alpha."""
        layer = np.zeros((camera.height, camera.width, 4), dtype=np.float32)
        left, top, right, bottom = _box(surface, camera)
        if left >= right or top >= bottom:
            return layer
        part = camera.cropped(left, top, right - left, bottom - top)
        mesh = self._fine if fine else self._coarse
        if fine:
            part = part.resized(SAMPLES * part.width, SAMPLES * part.height)
        seen = mesh.seen(surface, part)
        seen[..., :3] = COLORS[mode](seen[..., :3]) * seen[..., 3:]
        if fine:
            shifts = [(i, j) for j in range(SAMPLES) for i in range(SAMPLES)]
            seen = sum(seen[i::SAMPLES, j::SAMPLES] for i, j in shifts) / SAMPLES**2
        layer[top:bottom, left:right] = seen
        return layer


class _Mesh:
    """A Mitsuba scene with some of the vertices."""

    def __init__(self, scene: MeshScene, kept: Tensor) -> None:
        self._scene, self._kept = scene, kept
        self._of, self._vertices = kept, kept  # no surface yet

    def seen(self, surface: PosedSurface, camera: Camera) -> np.ndarray:
        """Return normals and mask, (H, W, 4) float32."""
        if self._of is not surface.vertices:  # the scene caches by tensor identity
            self._of, self._vertices = surface.vertices, surface.vertices[self._kept]
        with exclusive:
            return np.array(self._scene.view(self._vertices, camera).image(), dtype=np.float32)


def _box(surface: PosedSurface, camera: Camera) -> tuple[int, int, int, int]:
    """Return left, top, right and bottom of the pixels that a surface may cover."""
    points = surface.vertices.double().numpy()
    ahead = points @ camera.T_camera_world[2, :3] + camera.T_camera_world[2, 3]
    if ahead.min() < NEAR:
        return 0, 0, camera.width, camera.height
    at = camera.project(points)
    low = np.clip(np.floor(at.min(0)) - 1, 0, (camera.width, camera.height)).astype(int)
    high = np.clip(np.ceil(at.max(0)) + 1, 0, (camera.width, camera.height)).astype(int)
    return *low.tolist(), *high.tolist()


def draw_skeleton(
    joints: np.ndarray, parents: Sequence[int], camera: Camera, marked: int, fine: bool = True
) -> np.ndarray:
    """Draw joints (J, 3), metres, world, as a layer (H, W, 4) float32: premultiplied colour, alpha.

    Bones are lines, joints dots, larger for the body than for fingers; ``marked`` is orange.
    The parent of the root is -1. Edges are smooth if ``fine``.
    """
    from PIL import Image, ImageDraw

    samples = SAMPLES if fine else 1
    width, height = samples * camera.width, samples * camera.height
    view = camera.resized(width, height)
    depth = joints @ view.T_camera_world[2, :3] + view.T_camera_world[2, 3]
    seen = depth > NEAR
    at = view.project(np.where(seen[:, None], joints, view.position + view.T_camera_world[2, :3]))
    # Lines far outside the picture would be rasterised pixel by pixel.
    seen &= (np.abs(at - (width / 2, height / 2)) < 4 * max(width, height)).all(1)
    picture = Image.new("RGBA", (width, height))
    draw, bone = ImageDraw.Draw(picture), max(1, height // THICK)
    for joint, parent in enumerate(parents):
        if parent >= 0 and seen[joint] and seen[parent]:
            line = [tuple(at[parent]), tuple(at[joint])]
            draw.line(line, _ink(BONE), 2 * bone if joint < FINE else bone)
    for joint in np.argsort(-depth):
        if seen[joint]:
            radius = 2.5 * bone if joint < FINE else 1.3 * bone
            radius *= 1.6 if joint == marked else 1
            ink = _ink(OUTLINE if joint == marked else BLUE)
            (x, y), r = at[joint], radius
            draw.ellipse((x - r, y - r, x + r, y + r), ink)
    picture = picture.convert("RGBa")  # RGBa, with a small a, is premultiplied
    return np.asarray(picture.reduce(samples), dtype=np.float32) / 255


def _ink(color: tuple[float, float, float]) -> tuple[int, int, int, int]:
    return *(round(255 * x) for x in color), 255
