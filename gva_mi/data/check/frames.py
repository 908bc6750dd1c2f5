"""``CheckedFrames``: the frames whose masks are compared with the body, in small pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from gva_mi.body.pose import BODY, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.threads import one_torch_thread
from gva_mi.data.check.files import FULL, SubjectFiles, small_size
from gva_mi.data.joints import count_in_mask, joints_in_world, joints_seen
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera


@dataclass(frozen=True)
class CheckedFrames:
    """n frames with mask, camera and pose.

    Attributes:
        numbers: of the frames, ascending.
        cameras: n, of the small pictures.
        masks: (n, h, w) bool.
        pose: n frames.
        shape: the person's.
        joints: (55, 3) of the person at rest, metres.
    """

    numbers: tuple[int, ...]
    cameras: tuple[Camera, ...]
    masks: np.ndarray
    pose: Pose
    shape: Shape
    joints: np.ndarray

    def __len__(self) -> int:
        return len(self.numbers)

    def of(self, some: Sequence[int]) -> CheckedFrames:
        """Return some of the n frames, by their places."""
        return replace(
            self,
            numbers=tuple(self.numbers[i] for i in some),
            cameras=tuple(self.cameras[i] for i in some),
            masks=self.masks[list(some)],
            pose=self.pose[list(some)],
        )

    def pixels(self) -> np.ndarray:
        """Project root and body joints, (n, 22, 2) px; infinite behind the camera."""
        turns, transl = self.pose.rotations.numpy(), self.pose.transl.numpy()
        places = joints_in_world(turns, transl, self.joints)[:, : BODY.stop]
        return np.stack([joints_seen(*one) for one in zip(self.cameras, places, strict=True)])

    def inside(self) -> np.ndarray:
        """Return the share (n,) of these joints that lie in the mask."""
        both = zip(self.pixels(), self.masks, strict=True)
        return np.array([count_in_mask(*one)[0] for one in both]) / BODY.stop


def frames_of(files: SubjectFiles, body: BodyModel) -> CheckedFrames | None:
    """Return the frames with picture, mask, camera and pose; None if there are none."""
    if files.poses is None or not files.cameras:
        return None
    pose, shape = files.poses.pose, files.poses.shape
    first = next(iter(files.cameras.values()))
    size = first.width, first.height
    numbers = [
        k for k, m in sorted(files.masks.items())
        if k in files.cameras and k < len(pose) and m.size == size and 0 < m.share < FULL
    ]  # fmt: skip
    if not numbers:
        return None
    with torch.no_grad():
        joints = body.rest(shape).joints.double().numpy()
    return CheckedFrames(
        tuple(numbers), tuple(files.cameras[k].resized(*small_size(*size)) for k in numbers),
        np.stack([files.masks[k].small != files.masks[k].inverted for k in numbers]),
        pose[numbers], shape, joints,
    )  # fmt: skip


class SilhouetteRenderer:
    """Renders one person's body small; pictures are kept."""

    def __init__(self, body: BodyModel) -> None:
        self._body, self._known = body, {}
        self._scene = MeshScene(body.faces, body.v_template.float())

    @torch.no_grad()
    def render(self, frames: CheckedFrames) -> np.ndarray:
        """Return camera-space normals and silhouette of each frame, (n, h, w, 4) float32."""
        images = []
        with one_torch_thread():
            for k, camera in enumerate(frames.cameras):
                pose = frames.pose[k]
                key = (camera, pose.rotations.numpy().tobytes(), pose.transl.numpy().tobytes())
                if key not in self._known:
                    vertices = self._body(pose, frames.shape).vertices[0].float()
                    self._known[key] = self._scene.render(vertices, camera).numpy().copy()
                images.append(self._known[key])
        return np.stack(images)

    def silhouettes(self, frames: CheckedFrames) -> np.ndarray:
        """Return the silhouettes, (n, h, w) bool."""
        return self.render(frames)[..., 3] > 0.5
