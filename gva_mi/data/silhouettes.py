"""Does the body stand where the masks are? Silhouettes of both, their overlap, and a sheet of them.

:func:`sanity_check` asks this quickly before hours of work; ``gva-mi check`` looks closely.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import BODY, PARENTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.cpu import one_torch_thread
from gva_mi.data.splits import spread
from gva_mi.data.video import Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import OUTLINE, outlined, strip
from gva_mi.splat import Camera

SMALL = 192  # px, longer side of the masks that are compared: a person of 1.8 m has 1 px a cm
COMPARED = 8  # frames of the sanity check
FEWEST_INSIDE = 0.5  # of the joints in the picture; noise and loose clothes leave most in the masks
LEAST_OVERLAP = 0.25  # IoU; wide clothes and occlusion leave more
COARSE = 48  # px, longer side: vertices of a body are as dense
FEWEST_SEEN = 0.2  # of all joints are in the picture; head and shoulders are a third of them
SHOWN, HEIGHT, CAPTION = 6, 360, 20  # the sheet: frames; px of a frame and of the line of text
GREEN = (0.1, 0.75, 0.35)  # of the masks, beside the body's orange


def overlap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the IoU (n,) of two stacks of masks (n, h, w) bool; 0 if both are empty."""
    both, either = (a & b).sum((1, 2)), (a | b).sum((1, 2))
    return both / np.maximum(either, 1)


@dataclass(frozen=True)
class Silhouettes:
    """The masks of n frames and the body in them, at a reduced size."""

    numbers: np.ndarray  # (n,) of the frames, ascending
    cameras: list[Camera]  # n, of the reduced size
    masks: np.ndarray  # (n, h, w) bool
    pose: Pose  # n frames
    shape: Shape

    @staticmethod
    def of(video: Video, progress: Progress | None = None) -> Silhouettes:
        """Read the masks of a video's frames that are not absent, of which there must be one."""
        numbers = [k for k in range(len(video)) if k not in video.absent]
        size, masks = _reduced(*video.size, SMALL), []
        for done, outline in enumerate(video.outlines(numbers), 1):
            masks.append(_shrunk(outline.mask > 0.5, size))
            if progress is not None:
                progress(done, len(numbers))
        cameras = [video.cameras[k].resized(*size) for k in numbers]
        return Silhouettes(
            np.array(numbers), cameras, np.stack(masks), video.pose[numbers], video.shape
        )

    def some(self, places: Sequence[int]) -> Silhouettes:
        """Return those at some of the n places."""
        places = list(places)
        cameras = [self.cameras[i] for i in places]
        return replace(
            self, numbers=self.numbers[places], cameras=cameras, masks=self.masks[places],
            pose=self.pose[places],
        )  # fmt: skip

    @torch.no_grad()
    def bodies(self, body: BodyModel) -> np.ndarray:
        """Render the body's silhouettes, (n, h, w) bool."""
        scene = MeshScene(body.faces, body.v_template.float())
        shown = []
        with one_torch_thread():
            for i, camera in enumerate(self.cameras):
                vertices = body(self.pose[i], self.shape).vertices[0].float()
                shown.append(scene.render(vertices, camera).numpy()[..., 3] > 0.5)
        return np.stack(shown)

    @torch.no_grad()
    def joints_inside(self, body: BodyModel) -> np.ndarray:
        """Return the share (n,) of root and body joints that lie in the masks."""
        rest = body.rest(self.shape).joints.double().numpy()
        rotations, transl = self.pose.rotations.numpy(), self.pose.transl.numpy()
        places = joints_in_world(rotations, transl, rest)[:, : BODY.stop]
        inside = [
            count_in_mask(joints_seen(camera, joints), mask)[0]
            for camera, joints, mask in zip(self.cameras, places, self.masks, strict=True)
        ]
        return np.array(inside) / BODY.stop


def _reduced(width: int, height: int, longer: int) -> tuple[int, int]:
    """Return the size (w, h), ``longer`` at most, at which a picture is compared."""
    scale = min(1.0, longer / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def _shrunk(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a mask (H, W) bool in ``size`` (w, h), (h, w) bool."""
    from PIL import Image

    small = Image.fromarray(mask.astype(np.float32)).resize(size, Image.Resampling.BOX)
    return np.asarray(small) > 0.5


def joints_in_world(rotations: np.ndarray, transl: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return joint positions (T, 55, 3), metres, under ``rotations`` (T, 55, 3) axis-angle.

    ``transl`` is (T, 3); ``joints`` are (55, 3) of the body at rest.
    """
    rotations, rest, transl = (
        torch.from_numpy(np.array(x, np.float64)) for x in (rotations, joints, transl)
    )
    T = joint_transforms(rotations, rest, PARENTS, transl).numpy()
    return np.einsum("tjab,jb->tja", T[..., :3, :3], joints) + T[..., :3, 3]


def joints_seen(camera: Camera, places: np.ndarray) -> np.ndarray:
    """Project joints (J, 3), metres, world, to pixels (J, 2); infinite behind the camera."""
    depth = places @ camera.T_camera_world[2, :3] + camera.T_camera_world[2, 3]
    with np.errstate(all="ignore"):
        return np.where(depth[:, None] > 0, camera.project(places), np.inf)


def count_in_mask(pixels: np.ndarray, mask: np.ndarray) -> tuple[int, int]:
    """Count the joints (J, 2) pixels that lie in a mask (H, W) bool, and those in the picture."""
    height, width = mask.shape
    u, v = np.floor(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0).clip(-1, 1e6)).T
    seen = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    return int(mask[v[seen].astype(int), u[seen].astype(int)].sum()), int(seen.sum())


def sanity_check(video: Video, body: BodyModel) -> str | None:
    """Return a warning if the video's body does not stand where its masks are, else None."""
    frames = [k for k in range(len(video)) if k not in video.absent]
    outlines = video.outlines(spread(frames, COMPARED))
    doubt = doubt_of(((x.pose, x.camera, x.mask) for x in outlines), video.shape, body)
    check = f"gva-mi check {video.folder} looks for the cause"
    return None if doubt is None else f"{video.folder}: {doubt}; {check}"


@torch.no_grad()
def doubt_of(
    frames: Iterable[tuple[Pose, Camera, np.ndarray]], shape: Shape, body: BodyModel
) -> str | None:
    """Return a doubt if the body is not where the masks (H, W) of frames are, else None.

    Joints beyond the picture's edge are ignored, because many videos end at the hips. Vertices
    stand for the silhouette, so that nothing has to be rendered.
    """
    inside, seen, of, overlaps = 0, 0, 0, []
    for pose, camera, mask in frames:
        posed = body(pose, shape)
        joints = posed.joints[0, : BODY.stop].double().numpy()
        hits, there = count_in_mask(joints_seen(camera, joints), mask > 0.5)
        inside, seen, of = inside + hits, seen + there, of + len(joints)
        size = _reduced(camera.width, camera.height, COARSE)
        pixels = joints_seen(camera.resized(*size), posed.vertices[0].double().numpy())
        whole = np.floor(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(int)
        x, y = whole[((whole >= 0) & (whole < size)).all(1)].T
        shown = np.zeros(size[::-1], bool)  # pixels that hold a vertex
        shown[y, x] = True
        overlaps.append(overlap(shown[None], _shrunk(mask > 0.5, size)[None])[0])
    if not of:
        return None
    share, both = inside / max(1, seen), float(np.mean(overlaps))
    if seen < FEWEST_SEEN * of:
        figure = f"{seen / of:.0%} of the body's joints lie in the picture"
    elif share < FEWEST_INSIDE:
        figure = f"{share:.0%} of the body's joints lie in the masks"
    elif both < LEAST_OVERLAP:
        return f"doubtful: {both:.0%} of the body and of the masks is in both, expected half"
    else:
        return None
    return f"doubtful: {figure}, expected most of them"


def draw_sheet(video: Video, silhouettes: Silhouettes, body: BodyModel) -> np.ndarray:
    """Draw the outlines of body and mask over some frames, (h, w, 3) float32."""
    from PIL import Image, ImageDraw, ImageFont

    some = silhouettes.some(spread(range(len(silhouettes.numbers)), SHOWN))
    first = some.cameras[0]
    size = max(1, round(HEIGHT * first.width / first.height)), HEIGHT
    large = replace(some, cameras=[camera.resized(*size) for camera in some.cameras])
    resized = lambda image: Image.fromarray(image).resize(size, Image.Resampling.BILINEAR)
    pictures = []
    for number, mask, shown in zip(some.numbers, some.masks, large.bodies(body), strict=True):
        image = np.round(video[int(number)].image * 255).astype(np.uint8)
        picture = np.asarray(resized(image), np.float32) / 255
        mask = np.asarray(resized(mask.astype(np.uint8) * 255)) > 127
        pictures.append(outlined(outlined(picture, mask, GREEN), shown, OUTLINE))
    row = strip([pictures])
    line = Image.new("RGB", (row.shape[1], CAPTION), "white")
    font = ImageFont.load_default(size=14)
    ImageDraw.Draw(line).text((4, 2), "orange: body, green: mask", "black", font)
    return np.concatenate([np.asarray(line, np.float32) / 255, row])
