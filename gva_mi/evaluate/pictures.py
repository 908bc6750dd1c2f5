"""Pictures of avatars beside the ground truth, for the page of a run.

Novel poses and views are shown after the similarity transform (:mod:`gva_mi.evaluate.similarity`),
so that a picture shows the avatar and not how far away the subject was assumed to be. All pictures
are 8-bit (H, W, 3), on white.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import JOINTS, Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.evaluate.measure import OF_VIDEO, Split, SplitView, aligned_views, views_of
from gva_mi.evaluate.page import Picture, Section, picture
from gva_mi.evaluate.regions import person_box
from gva_mi.evaluate.similarity import similarity_to_truth
from gva_mi.fit.completion import normals_beneath, shown_pixels
from gva_mi.fit.renders import WHITE, CameraPath, cut_out, layer_of, over, render_frame, shots
from gva_mi.fit.samples import FrameSampler
from gva_mi.mesh.surface import as_scipy, uniform_laplacian
from gva_mi.splat import Camera, Gaussians, look_at, render
from gva_mi.splat.kernels.sh import C0
from gva_mi.subject.cameras import depths
from gva_mi.subject.crop import Box
from gva_mi.subject.pictures import in_8_bits
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Video

# Chosen: what is easy to see on a page.
ZOOMED_PIXELS = 220  # about the side of an enlarged box
DOT_SIZE = 0.0015  # metres, standard deviation of a Gaussian drawn as a dot
DOTS_HEIGHT, DOTS_MARGIN = 560, 28  # pixels: height of the pictures of dots, and beside the person
RED_LEVELS = 64  # levels of 255, difference that is fully red
Scale = Sequence[tuple[tuple[int, int, int], str]]  # of Section
SECTIONS: dict[Split, str] = {
    "test": "Test frames",
    "held_out_range": "The held-out range",
    "novel_pose": "Novel poses",
    "novel_view": "Novel views",
}


def shown_views(avatar: Avatar, trained: Video, body: BodyModel) -> dict[Split, SplitView]:
    """Open the splits of a video for an avatar, with novel ones in the avatar's world.

    Args:
        avatar: to show.
        trained: opened with the poses that the avatar was trained under.
        body: the fitted body model.
    """
    views = views_of(trained, tuple(SECTIONS), body)
    similarity = similarity_to_truth(avatar.rig, trained, body)
    if similarity is not None:
        own = [view for view in views if view.split in OF_VIDEO]
        views = own + aligned_views(views, similarity, avatar.rig, body)
    return {view.split: view for view in views}


def picture_sections(
    avatar: Avatar, views: Mapping[Split, SplitView], count: int
) -> Iterator[Section]:
    """Yield a section for each split: ``count`` frames, the avatar's render, and the difference."""
    for split, title in SECTIONS.items():
        if split in views:
            pictures = list(_of_view(avatar, views[split], count))
            whole, close = ([x for x in pictures if ("," in x.caption) is y] for y in (False, True))
            columns = 3 if len(whole) % 3 == 0 else 2  # no empty cell
            yield Section(title, whole, columns=columns, close_ups=close)
    yield Section("The Gaussians", [dots("", avatar.canonical)], columns=3)


def _of_view(avatar: Avatar, view: SplitView, count: int) -> Iterator[Picture]:
    """Show some frames, whole and in close-ups, which are rendered at their enlarged resolution."""
    frames = [view.video.with_true_mask(view.video[k]) for k in spread(view.frames, count)]
    people = [person_box(frame.mask) for frame in frames]
    size = max(box.width for box in people), max(box.height for box in people)
    for k, frame, box in zip(spread(view.frames, count), frames, people, strict=True):
        boxes = [("", _widened(box, size, frame.camera))]
        if view.details is not None and view.split != "novel_view":
            boxes += [(f", {what}", box) for what, box in view.details.boxes(k)]
        for what, box in boxes:
            times = max(1, round(ZOOMED_PIXELS / box.width)) if what else 1
            target = box.cut(cut_out(frame)).repeat(times, 0).repeat(times, 1)
            camera = box.cut_camera(frame.camera).resized(times * box.width, times * box.height)
            image = render_frame(avatar, frame.pose, camera)
            row = np.concatenate([target, image, difference(target, image)], axis=1)
            yield picture(f"frame {k}{what}", row)


def _widened(box: Box, size: tuple[int, int], camera: Camera) -> Box:
    """Widen a box to a size (w, h) inside the picture, so that cards are of one height."""
    left, top = (
        min(max(0, (low + high - wanted) // 2), whole - wanted)
        for low, high, wanted, whole in (
            (box.left, box.right, size[0], camera.width),
            (box.top, box.bottom, size[1], camera.height),
        )
    )
    return Box(left, top, left + size[0], top + size[1])


def difference(target: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Show the largest difference of the three channels in red."""
    share = np.abs(image.astype(int) - target).max(-1)[..., None] / RED_LEVELS
    white, red = np.array([255, 255, 255]), np.array([190, 20, 40])
    return np.round(white + np.minimum(share, 1) * (red - white)).astype(np.uint8)


def turntable(
    avatar: Avatar, pose: Pose, count: int, size: tuple[int, int]
) -> Iterator[np.ndarray]:
    """Render the avatar in one pose from ``count`` cameras on a circle around it."""
    path = CameraPath("turntable", frames=count, size=size)
    for shot in shots(path, avatar.rig, pose):
        yield render_frame(avatar, pose, shot.camera)


# Of seen_map, chosen: a share of 1 is a surface that all frames show squarely, and a person who
# turns once shows each side in 0.2.
SEEN_FRAMES = 12  # that are looked at
SEEN_LIMITS = 0.003, 0.06  # shares that are a guess, and well seen; between them by logarithm
SEEN_ROUNDS = 12  # averages over neighbouring vertices: a patch of some centimetres
SEEN_VIEWS = ("front", "left side", "back", "right side")
SEEN_SCALE = (
    ((194, 65, 12), "a guess: no frame shows it"),
    ((253, 230, 170), "seen briefly, or at an angle"),
    ((21, 94, 117), "well seen"),
)


@torch.no_grad()
def seen_map(avatar: Avatar, video: Video, pose: Pose) -> Section:
    """Show the avatar in a pose, coloured by how well the training frames show each part.

    That is eq. 1 of :mod:`gva_mi.fit.completion` per area of the body, over the pixels that this
    area has when a frame shows it squarely.
    """
    from scipy.spatial import cKDTree

    frames, rig = spread(video.splits.train, SEEN_FRAMES), avatar.rig
    samples = FrameSampler(video, frames, 0, max(video.size), 0.0)
    w = shown_pixels(avatar, normals_beneath(avatar), samples, video.pose).numpy()
    a, b, c = rig.vertices[rig.faces].unbind(1)
    corner = torch.linalg.cross(b - a, c - a).norm(dim=1) / 6  # a third of a face
    area = torch.bincount(rig.faces.T.flatten(), corner.repeat(3), len(rig.vertices)).numpy()
    cameras = [video.cameras[k] for k in frames]
    depth = depths(cameras, (rig.joints[0] + video.pose.transl[frames]).double().numpy())
    squarely = np.mean([(one.fx / z) ** 2 for one, z in zip(cameras, depth, strict=True)])
    near = cKDTree(rig.vertices.numpy()).query(avatar.canonical.means.numpy())[1]
    total = np.stack([np.bincount(near, w, len(area)), squarely * area], 1)
    laplacian = as_scipy(uniform_laplacian(rig.faces.numpy(), len(area)))
    for _ in range(SEEN_ROUNDS):
        total = total - laplacian @ total
    low, high = np.log(SEEN_LIMITS)
    share = np.log((total[:, 0] / total[:, 1].clip(1e-9)).clip(1e-9))[near]
    pictures = _colored(avatar, pose, 2 * (share - low) / (high - low), SEEN_SCALE)
    return Section("How well each part was seen", pictures, columns=4, scale=SEEN_SCALE)


# Of trust_map: mm that are certain, and uncertain; between them by logarithm. Chosen: the errors of
# the best and of the worst parts of the body in docs/studies.md.
TRUST_LIMITS = 10.0, 60.0
TRUST_SCALE = (
    ((21, 94, 117), f"{TRUST_LIMITS[0]:.0f} mm"),
    ((253, 230, 170), f"{np.sqrt(np.prod(TRUST_LIMITS)):.0f} mm"),
    ((194, 65, 12), f"{TRUST_LIMITS[1]:.0f} mm and more"),
)
# Joints of the parts that the page names.
PARTS = {
    "trunk": ("spine1", "spine2", "spine3", "left_hip", "right_hip"),
    "head": ("head",),
    "left arm": ("left_elbow",), "right arm": ("right_elbow",),
    "left hand": ("left_wrist", "left_middle1"), "right hand": ("right_wrist", "right_middle1"),
    "left leg": ("left_knee",), "right leg": ("right_knee",),
    "left foot": ("left_ankle", "left_foot"), "right foot": ("right_ankle", "right_foot"),
}  # fmt: skip


@torch.no_grad()
def trust_map(avatar: Avatar, uncertainty: Tensor, pose: Pose) -> Section:
    """Show the avatar in a pose, coloured by how uncertain the place of each part is.

    Args:
        avatar: to show.
        uncertainty: (55,) of its joints, mm, of :func:`gva_mi.evaluate.refinement.joint_errors`.
        pose: one frame.
    """
    from scipy.spatial import cKDTree

    rig, found = avatar.rig, uncertainty.numpy()
    mm = _along_bones(rig, found)[cKDTree(rig.vertices).query(avatar.canonical.means.numpy())[1]]
    low, high = np.log(TRUST_LIMITS)
    pictures = _colored(avatar, pose, 2 * (np.log(mm) - low) / (high - low), TRUST_SCALE)
    of = {name: found[[JOINTS.index(x) for x in joints]].max() for name, joints in PARTS.items()}
    best, worst = (f(of, key=of.get) for f in (min, max))
    text = f"Trust the {best} most ({of[best]:.0f} mm), and the {worst} least ({of[worst]:.0f} mm)."
    return Section("Which parts to trust", pictures, columns=4, text=text, scale=TRUST_SCALE)


def _along_bones(rig: Rig, joints: np.ndarray) -> np.ndarray:
    """Spread values (55,) of joints over the vertices (V,), between the ends of their bones."""
    values, total = np.zeros(len(rig.vertices)), 0.0
    for j in range(len(joints)):
        ends = [j, *(k for k, parent in enumerate(rig.parents) if parent == j)]
        gap = torch.cdist(rig.vertices, rig.joints[ends]).double().numpy()
        near = 1 / gap.clip(1e-3) ** 2
        weight = rig.weights[:, j].double().numpy()
        values += weight * (near @ joints[ends]) / near.sum(1)
        total = total + weight
    return values / total


def _colored(avatar: Avatar, pose: Pose, at: np.ndarray, scale: Scale) -> list[Picture]:
    """Draw an avatar from four sides, its Gaussians (N,) at places 0 to 2 of a scale."""
    colors = [np.interp(at.clip(0, 2), range(3), x) for x in np.array([c for c, _ in scale]).T]
    sh = torch.zeros_like(avatar.canonical.sh)
    sh[:, 0] = torch.as_tensor((np.stack(colors, 1) / 255 - 0.5) / C0).to(sh)
    path = CameraPath("turntable", frames=4, size=(300, 400))
    gaussians = avatar.animate(pose, sh).gaussians
    return [
        picture(name, over(layer_of(gaussians, shot.camera), np.array(WHITE)))
        for name, shot in zip(SEEN_VIEWS, shots(path, avatar.rig, pose), strict=True)
    ]


def dots(caption: str, gaussians: Gaussians) -> Picture:
    """Draw every Gaussian as a dot of its own colour, from the front and from the side."""
    means = gaussians.means.detach()
    small = Gaussians(
        means,
        means.new_zeros(len(gaussians), 4),  # round, so any rotation will do
        torch.full_like(means, DOT_SIZE),
        torch.full_like(gaussians.opacities.detach(), 0.99),
        sh=gaussians.sh.detach()[:, :1],
    )
    low, high = np.quantile(means.numpy(), [0.001, 0.999], axis=0)
    centre, size = (low + high) / 2, (high - low) * 1.1
    scale, views = DOTS_HEIGHT / size[1], []
    for axis, across in (((0, 0, 1), 0), ((1, 0, 0), 2)):
        distance = 8.0  # far away, for a nearly parallel view
        width = round(size[across] * scale) + 2 * DOTS_MARGIN
        T_camera_world = look_at(centre + distance * np.array(axis), centre)
        focal = distance * scale
        camera = Camera(
            focal, focal, width / 2, DOTS_HEIGHT / 2, T_camera_world, width, DOTS_HEIGHT
        )
        with torch.no_grad():
            views.append(in_8_bits(render(small, camera, background=torch.ones(3)).color.numpy()))
    text = f"{caption} {len(gaussians):,} Gaussians".strip()
    return picture(text, np.concatenate(views, axis=1))
