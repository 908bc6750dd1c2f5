"""``Seen``: the frames that can be compared, in small pictures; joints and silhouettes in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import BODY, PARENTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.threads import one_torch_thread
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera


@dataclass(frozen=True)
class Seen:
    """A folder as it is read: n frames with mask, camera and pose.

    Attributes:
        frames: their numbers, ascending.
        cameras: n, of the small pictures.
        masks: (n, h, w) bool.
        pose: n frames.
        shape: the person's.
        joints: (55, 3) of the person at rest, metres.
    """

    frames: tuple[int, ...]
    cameras: tuple[Camera, ...]
    masks: np.ndarray
    pose: Pose
    shape: Shape
    joints: np.ndarray

    def __len__(self) -> int:
        return len(self.frames)

    def of(self, some: Sequence[int]) -> Seen:
        """Some of the n frames, by their places."""
        return replace(
            self,
            frames=tuple(self.frames[i] for i in some),
            cameras=tuple(self.cameras[i] for i in some),
            masks=self.masks[list(some)],
            pose=self.pose[list(some)],
        )

    def places(self) -> np.ndarray:
        """Where root and body joints are, in the cameras' axes, (n, 22, 3) metres."""
        rest, some = torch.from_numpy(self.joints), slice(0, BODY.stop)
        pose = self.pose.to(torch.float64)
        T = joint_transforms(pose.rotations, rest, PARENTS, pose.transl).numpy()[:, some]
        world = np.einsum("tjab,jb->tja", T[..., :3, :3], self.joints[some]) + T[..., :3, 3]
        cameras = np.stack([c.T_camera_world for c in self.cameras])
        return np.einsum("tab,tjb->tja", cameras[:, :3, :3], world) + cameras[:, None, :3, 3]

    def pixels(self) -> np.ndarray:
        """The same in the small pictures, (n, 22, 2); infinite behind the camera."""
        x = self.places()
        f = np.array([(c.fx, c.fy) for c in self.cameras])[:, None]
        c = np.array([(c.cx, c.cy) for c in self.cameras])[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(x[..., 2:] > 0, f * x[..., :2] / x[..., 2:] + c, np.inf)

    def inside(self) -> np.ndarray:
        """The share (n,) of these joints that lie in the mask; those beyond the border do not."""
        pixels, (height, width) = self.pixels(), self.masks.shape[1:]
        u, v = np.floor(pixels.clip(-1, 1e6)).astype(int).transpose(2, 0, 1)
        there = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        rows = np.arange(len(self))[:, None]
        hits = self.masks[rows, v.clip(0, height - 1), u.clip(0, width - 1)] & there
        return hits.mean(1)


class Silhouettes:
    """Renders the body of one person small."""

    def __init__(self, body: BodyModel) -> None:
        self._body, self._known = body, {}
        self._scene = MeshScene(body.faces, body.v_template.float())

    @torch.no_grad()
    def render(self, seen: Seen) -> np.ndarray:
        """Normals in the cameras' axes and silhouette of each frame, (n, h, w, 4) float32."""
        images = []
        with one_torch_thread():
            for k, camera in enumerate(seen.cameras):
                images.append(self._image(camera, seen.pose[k], seen.shape))
        return np.stack(images)

    def _image(self, camera: Camera, pose: Pose, shape: Shape) -> np.ndarray:
        """A picture, which is kept: readings that differ in the masks alone need no other."""
        key = (camera, pose.rotations.numpy().tobytes(), pose.transl.numpy().tobytes())
        if key not in self._known:
            vertices = self._body(pose, shape).vertices[0].float()
            self._known[key] = self._scene.render(vertices, camera).numpy().copy()
        return self._known[key]


def overlap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """IoU (n,) of two stacks of masks (n, h, w) bool; 0 where both are empty."""
    both, either = (a & b).sum((1, 2)), (a | b).sum((1, 2))
    return both / np.maximum(either, 1)


def laid_over(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Masks ``a`` (n, h, w) moved onto masks ``b`` by one displacement for all, whole pixels.

    It is the median of those of the frames, so that what stays apart is shape and motion.
    """
    both = [(x, y) for x, y in zip(a, b, strict=True) if x.any() and y.any()]
    if not both:
        return a
    right, down = np.rint(np.median([middle(y) - middle(x) for x, y in both], axis=0)).astype(int)
    height, width = a.shape[1:]
    grown = np.pad(a, ((0, 0), (height, height), (width, width)))
    return grown[:, height - down : 2 * height - down, width - right : 2 * width - right]


def radius(mask: np.ndarray) -> float:
    """Root mean square distance of a mask from its middle, pixels, each of which is a square."""
    y, x = np.nonzero(mask)
    return float(np.sqrt(x.var() + y.var() + 1 / 6)) if len(x) else 0.0


def middle(mask: np.ndarray) -> np.ndarray:
    """The middle (x, y) of a mask's pixels."""
    y, x = np.nonzero(mask)
    return np.array([x.mean(), y.mean()]) if len(x) else np.full(2, np.nan)


def cut_off(mask: np.ndarray) -> bool:
    """Whether a mask reaches the border, so that its size is not the person's."""
    return bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
