"""Compare the posed body with the masks, frame by frame, at a reduced size.

:func:`sanity_check` does this in seconds before a step starts; ``gva-mi check`` does it for all
frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import BODY, JOINTS, PARENTS, SIDES, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import OUTLINE, outlined, strip
from gva_mi.splat import Camera
from gva_mi.subject.folder import MASKS
from gva_mi.subject.masks import read_mask
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Video

# All chosen, for the reason beside each.
RENDERED_SIDE = 192  # px, longer side of rendered silhouettes: of a whole person, 1 px is 1 cm
VERTEX_SIDE = 48  # px, longer side without rendering: a body's vertices are about as dense
FULL_MASK = 0.995  # share of a picture that a full mask covers: the rest is noise of compression
# Share of the picture's border that an inverted mask touches. A person touches one side, or two if
# head and feet are cut off; the background touches all four.
INVERTED_BORDER = 0.5
COMPARED_FRAMES = 8  # of the sanity check, which should take seconds
# Share of the joints in the picture; noise and loose clothes leave more.
LEAST_JOINTS_IN_MASKS = 0.5
LEAST_IOU = 0.25  # of the body and the mask; wide clothes and occlusion leave more
LEAST_JOINTS_IN_PICTURE = 0.2  # share of all joints; head and shoulders alone are a third
TURNED_DEGREES = 60  # of the person, in most frames: nobody films a handstand, or who lies
SHEET_FRAMES, SHEET_HEIGHT = 6, 360  # frames of the sheet; height of each, px
_HEAD, _ANKLES = JOINTS.index("head"), [JOINTS.index(f"{side}_ankle") for side in SIDES]
MASK_COLOR = (0.1, 0.75, 0.35)  # RGB in [0, 1]: green, beside the body's orange


@dataclass(frozen=True)
class BodyAndMask:
    """How well body and mask of a frame agree. An inverted mask is inverted back first."""

    joints: tuple[int, int]  # how many of root and body lie in the mask, and in the picture
    overlap: float  # IoU of both silhouettes
    size: float  # of the mask, relative to the body; NaN if the border cuts it
    full: bool  # the mask covers the whole picture
    inverted: bool  # the mask covers the background
    lean: float  # degrees between the picture's up direction and that from feet to head


@torch.no_grad()
def compare(
    body: BodyModel,
    shape: Shape,
    frame: tuple[Pose, Camera, np.ndarray],
    scene: MeshScene | None = None,
) -> BodyAndMask:
    """Compare a body with the mask (H, W) of a frame.

    Without a ``scene`` of the body nothing is rendered: pixels with a vertex are its silhouette.
    """
    from PIL import Image

    pose, camera, mask = frame
    longer = VERTEX_SIDE if scene is None else RENDERED_SIDE
    scale = min(1.0, longer / max(camera.width, camera.height))
    size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    small = Image.fromarray(mask.astype(np.float32)).resize(size, Image.Resampling.BOX)
    inside, camera = np.asarray(small) > 0.5, camera.resized(*size)
    full = bool(inside.mean() >= FULL_MASK)
    border = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
    inverted = bool(border.mean() > INVERTED_BORDER) and not full
    inside, border = inside ^ inverted, border ^ inverted
    posed = body(pose, shape)
    joints = joints_seen(camera, posed.joints[0, : BODY.stop].double().numpy())
    pixels = joints_seen(camera, posed.vertices[0].double().numpy())
    pixels = np.unique(np.floor(pixels[np.isfinite(pixels).all(1)]), axis=0)
    x, y = pixels[((pixels >= 0) & (pixels < size)).all(1)].astype(int).T
    shown = np.zeros(size[::-1], bool)  # pixels that hold a vertex
    shown[y, x] = True
    if scene is not None:
        shown = scene.render(posed.vertices[0].float(), camera).numpy()[..., 3] > 0.5
    overlap = (inside & shown).sum() / max(1, (inside | shown).sum())
    cut = border.any() or not inside.any() or not len(pixels)
    ratio = np.nan if cut else _radius(np.argwhere(inside)) / _radius(pixels)
    with np.errstate(invalid="ignore"):  # joints behind the camera are infinite
        x, y = joints[_ANKLES].mean(0) - joints[_HEAD]
    lean = float(np.degrees(abs(np.arctan2(x, y))))
    return BodyAndMask(count_in_mask(joints, inside), float(overlap), ratio, full, inverted, lean)


def _radius(pixels: np.ndarray) -> float:
    """Return the root mean square distance of pixels (n, 2) from their middle."""
    return float(np.sqrt(pixels.var(0).sum() + 1 / 6))


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
    with np.errstate(all="ignore"):
        return np.where(camera.depths(places)[:, None] > 0, camera.project(places), np.inf)


def count_in_mask(pixels: np.ndarray, mask: np.ndarray) -> tuple[int, int]:
    """Count the joints (J, 2) pixels that lie in a mask (H, W) bool, and those in the picture."""
    height, width = mask.shape
    u, v = np.floor(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0).clip(-1, 1e6)).T
    seen = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    return int(mask[v[seen].astype(int), u[seen].astype(int)].sum()), int(seen.sum())


def sanity_check(video: Video, body: BodyModel) -> str | None:
    """Return a warning if the video's body does not lie in its masks, else None."""
    frames = [k for k in range(len(video)) if k not in video.absent]
    outlines = video.outlines(spread(frames, COMPARED_FRAMES))
    doubt = doubt_of(((x.pose, x.camera, x.mask) for x in outlines), video.shape, body)
    check = f"gva-mi check {video.folder} looks for the cause"
    return None if doubt is None else f"{video.folder}: {doubt}; {check}"


def doubt_in(
    folder: Path,
    frames: Iterable[int],
    pose: Pose,
    cameras: Sequence[Camera],
    shape: Shape,
    body: BodyModel,
) -> str | None:
    """Return what :func:`doubt_of` finds in some of a folder's frames, beside its masks."""
    masks = {k: read_mask(folder / MASKS, k) for k in map(int, spread(frames, COMPARED_FRAMES))}
    found = ((pose[k], cameras[k], mask) for k, mask in masks.items() if mask is not None)
    return doubt_of(found, shape, body)


def doubt_of(
    frames: Iterable[tuple[Pose, Camera, np.ndarray]], shape: Shape, body: BodyModel
) -> str | None:
    """Return a warning if the body does not lie in the masks (H, W) of frames, else None.

    Joints beyond the picture's edge are ignored, because many videos end at the hips.
    """
    found = [compare(body, shape, frame) for frame in frames]
    if not found:
        return None
    inside, seen = np.sum([one.joints for one in found], axis=0)
    inverted, of = np.mean([one.inverted for one in found]), BODY.stop * len(found)
    both, lean = np.mean([one.overlap for one in found]), np.median([one.lean for one in found])
    if inverted > 0.5:
        return f"doubtful: {inverted:.0%} of the masks show the background, expected the person"
    if seen < LEAST_JOINTS_IN_PICTURE * of:
        figure = f"{seen / of:.0%} of the body's joints lie in the picture"
    elif inside < LEAST_JOINTS_IN_MASKS * seen:
        figure = f"{inside / seen:.0%} of the body's joints lie in the masks"
    elif both < LEAST_IOU:
        return f"doubtful: {both:.0%} of the body and of the masks is in both, expected half"
    elif lean > TURNED_DEGREES:
        return f"doubtful: {turned_words(lean)}, as in a video that lost its rotation"
    else:
        return None
    return f"doubtful: {figure}, expected most of them"


def turned_words(lean: float) -> str:
    """Say how a person is turned by ``lean`` degrees in the pictures."""
    how = "head down" if lean > 135 else "on the side"
    return f"the person is turned by {lean:.0f} degrees, {how}"


@torch.no_grad()
def draw_sheet(video: Video, body: BodyModel) -> np.ndarray:
    """Draw the outlines of body (orange) and mask (green) over some frames, (h, w, 3) float32."""
    from PIL import Image

    scene, pictures = MeshScene(body.faces, body.v_template.float()), []
    size = max(1, round(SHEET_HEIGHT * video.size[0] / video.size[1])), SHEET_HEIGHT
    there = [k for k in range(len(video)) if k not in video.absent]
    for frame in video.frames(spread(there, SHEET_FRAMES)):
        image, mask = (
            np.asarray(Image.fromarray(x).resize(size, Image.Resampling.BILINEAR))
            for x in (np.round(frame.image * 255).astype(np.uint8), frame.mask)
        )
        vertices = body(frame.pose, video.shape).vertices[0].float()
        shown = scene.render(vertices, frame.camera.resized(*size)).numpy()[..., 3] > 0.5
        marked = outlined(image.astype(np.float32) / 255, mask > 0.5, MASK_COLOR)
        pictures.append(outlined(marked, shown, OUTLINE))
    return strip([pictures])
