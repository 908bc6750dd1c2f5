"""Training frames of a fit: kept in memory, and served one per step on a changing background.

Reading, decoding and cutting out a frame takes longer than rendering it. So every training frame is
read once, cut to the box around its mask, and kept as 8 bits, on disk if the video is long
(:mod:`gva_mi.core.spill_cache`). In its step it is composited on a background of a new colour,
which teaches alpha (:mod:`gva_mi.fit.backgrounds`):

1. ``I = S P + (1 - S) b``   on the background ``b``
2. ``I = P``                 on the background ``B``, where the mask is uncertain

of the picture P and the person's mask S. Outlines of masks are off by some pixels, differently in
each frame, and cutting by them blurs the avatar's edge. The picture itself shows the outline to a
fraction of a pixel if the render is composited on what is behind the person, B. So eq. 1 is used
only for what is plainly inside or outside.

B must be known. Between two shins, for example, all of the background lies near an outline; with a
wrong B, Gaussians in the colours of the floor would fill the gap. A camera that stands still shows
it in other frames (:mod:`gva_mi.matting.plate`). Where no frame does, or where the plate
disagrees with what is seen nearby, the nearest background of the same frame takes its place.

Only the part of the picture with the person, the window or a Gaussian is compared; elsewhere render
and target are the same background. So a step takes time in proportion to the person, not the room.

All random numbers of a step depend only on the run's seed and the step's number, so a resumed run
draws the same ones, with no state to save.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from torch import Tensor

from gva_mi.avatar.rig import Rig
from gva_mi.core.spill_cache import SpillCache
from gva_mi.core.tasks import on_all_cores
from gva_mi.fit.backgrounds import (
    OVERLAY,
    CompositeTarget,
    Cutout,
    absolute_errors,
    composite_render,
    composite_target,
)
from gva_mi.jit.frozen import Frozen, exclusive
from gva_mi.jit.rowwise import flat_array, load_columns
from gva_mi.jit.tensors import PRECISION
from gva_mi.matting.plate import Plate
from gva_mi.splat import Camera, Gaussians, Image, SplatOptions
from gva_mi.splat.kernels.tiles import Layout
from gva_mi.subject import backdrop
from gva_mi.subject.cameras import depths
from gva_mi.subject.crop import Box, Extent
from gva_mi.subject.pictures import in_8_bits
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Frame, Video


@dataclass(frozen=True)
class Person:
    """A person cut out of a frame."""

    pixels: Tensor  # (h, w, 4) uint8, picture and mask
    kept: Box  # their place in the whole picture
    box: Box  # around the inside of the mask, in the whole picture
    error: float  # pixels by which the mask's outline may be off
    overlay: np.ndarray | None  # (h, w) bool

    @staticmethod
    def of(frame: Frame, mask_error: float) -> Person:
        """Cut a frame; ``mask_error`` is a share of the root of the area of the person's box."""
        box = _box_of(frame.mask > 0.5)
        error = mask_error * (box.width * box.height) ** 0.5
        kept = _box_of(frame.mask > 0, math.ceil(error) + 1)
        overlay = None if frame.overlay is None else kept.cut(frame.overlay)
        pixels = _to_8bit(kept.cut(frame.image), kept.cut(frame.mask))
        return Person(pixels, kept, box, error, overlay)

    @property
    def picture(self) -> np.ndarray:
        """The picture (h, w, 3) in [0, 1]."""
        return self.pixels[..., :3].numpy().astype(np.float32) / 255

    @property
    def mask(self) -> np.ndarray:
        """The mask (h, w) in [0, 1]."""
        return self.pixels[..., 3].numpy().astype(np.float32) / 255

    @property
    def unsure(self) -> np.ndarray:
        """Where the mask may be wrong (h, w) bool."""
        return backdrop.unsure(self.mask, self.error)

    def bare(self, unsure: np.ndarray) -> np.ndarray:
        """Where the person surely is not (h, w) bool."""
        return (self.pixels[..., 3].numpy() == 0) & ~unsure

    def behind(self, plate: Plate | None, place: Box) -> Tensor:
        """Return what is behind the person and where the mask is uncertain (h, w, 4) uint8.

        ``plate`` is what :func:`background_of` found in the part ``place`` of the picture. Without
        it, or where it disagrees with this frame, the nearest background of this frame is taken.
        """
        image, unsure = self.picture, self.unsure
        bare = self.bare(unsure)
        if plate is None or not bare.any():
            found = backdrop.behind(image, np.maximum(self.mask, unsure))
        else:
            part = plate.part(within(self.kept, place)).agreeing(image, bare)
            found = np.where(bare[..., None], image, part.beside(image, bare))
        packed = _to_8bit(found, unsure)
        if self.overlay is not None:
            packed[torch.from_numpy(self.overlay), 3] = OVERLAY
        return packed


def background_of(frames: Iterable[tuple[np.ndarray, Person]], place: Box) -> Plate:
    """Return the background that pictures (H, W, 3) 8-bit of one camera show in a part of them."""
    pictures, bare = [], []
    for picture, person in frames:
        pictures.append(place.cut(picture))
        bare.append(np.ones((place.height, place.width), bool))
        bare[-1][within(person.kept, place)] = person.bare(person.unsure)
    return Plate.gather(np.stack(pictures), np.stack(bare))


def within(box: Box, part: Box) -> tuple[slice, slice]:
    """Return rows and columns of a box in a larger one."""
    top, left = box.top - part.top, box.left - part.left
    return slice(top, top + box.height), slice(left, left + box.width)


def _to_8bit(image: np.ndarray, fourth: np.ndarray) -> Tensor:
    """Pack an image (H, W, 3) and a fourth channel (H, W), all in [0, 1], as 8 bits."""
    four = np.concatenate([image, fourth[..., None]], axis=-1)
    return torch.from_numpy(np.round(four * 255).astype(np.uint8))


def _box_of(mask: np.ndarray, margin: int = 0) -> Box:
    """Return the box around a mask (H, W) bool; the whole picture if it is empty."""
    H, W = mask.shape
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    if not len(rows):
        return Box(0, 0, W, H)
    left, top = max(0, int(columns[0]) - margin), max(0, int(rows[0]) - margin)
    right, bottom = min(W, int(columns[-1]) + 1 + margin), min(H, int(rows[-1]) + 1 + margin)
    return Box(left, top, right, bottom)


ALPHA_SIGMAS = 3.4  # standard deviations at which alpha is below 1/255: √(2 ln 255) = 3.33
BLUR_BORDER = 2  # pixels; chosen: more than the blur that every Gaussian gets
PLATE_FRAMES = 32  # that the background is gathered from; chosen: they fit in memory


class RandomStream(IntEnum):
    """Streams of random numbers in a run, one per purpose."""

    ORDER = 0  # order of the frames in a pass
    BACKGROUND = 1
    WINDOW = 2
    SEED = 3  # seeding of the avatar
    DENSIFY = 4
    REINIT = 5


def random_state(seed: int, stream: RandomStream, number: int) -> np.random.Generator:
    """Return the numpy generator of one stream at one step (or pass) of a run."""
    return np.random.default_rng([seed, stream, number])


def torch_state(seed: int, stream: RandomStream, number: int = 0) -> torch.Generator:
    """Return the torch generator of one stream at one step of a run."""
    drawn = random_state(seed, stream, number).integers(2**63)
    return torch.Generator().manual_seed(int(drawn))


def smallest_pixel(video: Video, rig: Rig) -> float:
    """Return the smallest size on the person of a pixel of the training frames, metres.

    Finer detail was never seen, and finer Gaussians leave cracks between them, which the blur of a
    pixel hides until a camera comes closer (Yu et al., *Mip-Splatting*, 2024).
    """
    train = list(video.splits.train)
    cameras = [video.cameras[k] for k in train]
    depth = depths(cameras, (rig.joints[0] + video.pose.transl[train]).detach().double().numpy())
    focal = np.array([max(camera.fx, camera.fy) for camera in cameras])
    return float(max(0.0, (depth / focal).min()))


@dataclass(frozen=True)
class SampleTarget:
    """A part of a picture as it should be rendered, on a background."""

    cutout: Cutout
    part: Box  # of the whole picture
    camera: Camera  # of this part
    window: Box  # of the whole picture, inside of this part
    area: int  # pixels of the person's box

    def composite(self) -> CompositeTarget:
        """Return the target on its background."""
        return composite_target(self.cutout, self.part)

    def errors(self, image: Image) -> tuple[Tensor, Tensor]:
        """Return the means of ``|C - I|`` and ``|A - S|``: sums over this part by the person's
        area.
        """
        return absolute_errors(image.color, image.alpha, self.cutout, self.part, self.area)

    def in_window(self, image: Image) -> tuple[Tensor, Tensor]:
        """Return a render of this part on its background, and the target, inside the window."""
        target, background, _, shown = composite_target(self.cutout, self.window)
        inside = within(self.window, self.part)
        seen = composite_render(image.color[inside], image.alpha[inside], background)
        return torch.where(shown[..., None] > 0, seen, target), target


@dataclass(frozen=True)
class Sample:
    """The training frame of one step, cut to its mask."""

    frame: int  # its number in the video
    cutout: Cutout  # on a background of a new colour
    area: int  # pixels of the person's box
    camera: Camera  # of the whole picture
    window: Box  # a random part of the whole picture, with some of the person in it

    def target(self, gaussians: Gaussians) -> SampleTarget:
        """Return the part with the person, the window and the Gaussians."""
        part = joined(self.cutout.box, self.window, box_of_gaussians(gaussians, self.camera))
        part = in_tiles(part, self.camera)
        camera = part.cut_camera(self.camera)
        return SampleTarget(self.cutout, part, camera, self.window, self.area)


class FrameSampler:
    """Training frames of a video; ``sampler[step]`` is the sample of a step.

    Args:
        video: the video they are read from.
        frames: numbers of the frames.
        seed: seed of the run.
        window: side of the random window, pixels; a smaller image is taken whole.
        mask_error: possible error of mask outlines, as a share of the root of the area of the
            person's box.
        still_camera: whether other frames show what is behind the person.
        folder: holds frames for which memory has no room; None: the system's temporary folder.
    """

    def __init__(
        self,
        video: Video,
        frames: Sequence[int],
        seed: int,
        window: int,
        mask_error: float,
        still_camera: bool = False,
        folder: Path | None = None,
    ) -> None:
        self.frames, self.seed = list(frames), seed
        self.window = window
        self.cameras = [video.cameras[k] for k in self.frames]
        self.boxes = []
        folder = Path(tempfile.gettempdir()) if folder is None else folder
        self._people, self._behind = SpillCache[Person](folder), SpillCache[Tensor](folder)
        kept, pictures = [], {}
        shown = spread(range(len(self)), PLATE_FRAMES) if still_camera else []

        def cut(numbered: tuple[int, Frame]) -> Person:
            k, frame = numbered
            if k in shown:
                pictures[k] = in_8_bits(frame.image)
            return Person.of(frame, mask_error)

        for k, person in enumerate(on_all_cores(cut, enumerate(video.frames(self.frames)))):
            self.boxes.append(person.box)
            kept.append(person.kept)
            self._people[k] = person
        place, plate = joined(*kept), None
        if still_camera:
            seen = [(pictures.pop(k), self._people[k]) for k in shown]
            plate = background_of(seen, place)
        behind = lambda person: person.behind(plate, place)
        for k, found in enumerate(on_all_cores(behind, self._people.values())):
            self._behind[k] = found

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, step: int) -> Sample:
        """Return the sample of a step; every pass over the frames has a new order."""
        k = self._drawn(step)
        # A new colour at each step teaches the avatar its alpha.
        color = random_state(self.seed, RandomStream.BACKGROUND, step).random(3, dtype=np.float32)
        box, window = self.boxes[k], self._window(k, step)
        person, area = self._people[k], box.width * box.height
        cutout = Cutout(person.pixels, self._behind[k], person.kept, torch.from_numpy(color))
        return Sample(self.frames[k], cutout, area, self.cameras[k], window)

    def frame(self, step: int) -> int:
        """Return the frame of a step, its number in the video."""
        return self.frames[self._drawn(step)]

    def _drawn(self, step: int) -> int:
        which, position = divmod(step, len(self))
        order = random_state(self.seed, RandomStream.ORDER, which).permutation(len(self))
        return int(order[position])

    def _window(self, k: int, step: int) -> Box:
        random = random_state(self.seed, RandomStream.WINDOW, step)
        box, camera = self.boxes[k], self.cameras[k]
        top, height = self._span(random, box.top, box.bottom, camera.height)
        left, width = self._span(random, box.left, box.right, camera.width)
        return Box(left, top, left + width, top + height)

    def _span(
        self, random: np.random.Generator, first: int, last: int, size: int
    ) -> tuple[int, int]:
        """Draw start and length of a side whose middle lies in [first, last)."""
        side = min(self.window, size)
        start = int(random.integers(first, last)) - side // 2
        return min(max(start, 0), size - side), side


@exclusive
def box_of_gaussians(gaussians: Gaussians, camera: Camera) -> Box | None:
    """Return the part of a picture that Gaussians can reach; None: none is visible."""
    means, sizes = gaussians.means, gaussians.scales
    sizes = gaussians.covars if sizes is None else sizes
    if not len(means):
        return None
    view = [*camera.T_camera_world[:3].ravel(), camera.fx, camera.fy, camera.cx, camera.cy]
    memory = flat_array(means), flat_array(sizes), PRECISION[means.dtype](view)
    found = _reached(*memory, n=len(means), columns=sizes.shape[1])
    low, high = np.array([x[0] for x in found], np.float64).reshape(2, 2)
    if (low > high).any():  # all are behind the camera
        return None
    size = np.array([camera.width, camera.height])
    if not np.isfinite([low, high]).all():  # a diverged fit is compared on the whole picture
        return Box(0, 0, camera.width, camera.height)
    outside = (high <= 0).any() or (low >= size).any()
    return None if outside else Extent(low, high).box(0.0, size)


@Frozen
def _reached(means: Array, sizes: Array, view: Array, *, n: int, columns: int) -> list[Array]:
    """Return the least u and v, and the largest, that Gaussians before the camera reach, pixels."""
    lane = dr.arange(dr.uint32_array_t(means), n)
    mean, size = load_columns(means, 3, lane), load_columns(sizes, columns, lane)
    *T, fx, fy, cx, cy = load_columns(view, 16, lane * 0)
    x, y, z = (sum(T[4 * i + k] * mean[k] for k in range(3)) + T[4 * i + 3] for i in range(3))
    if columns == 6:  # of a covariance: the trace bounds its largest variance
        radius = dr.sqrt(dr.maximum(size[0] + size[3] + size[5], 0))
    else:
        radius = dr.maximum(dr.maximum(size[0], size[1]), size[2])
    x, y = x / z, y / z
    # Off centre, a ball looks longer by the secant of its angle.
    longer = dr.sqrt(1 + x * x + y * y)
    reach = ALPHA_SIGMAS * radius * longer / z * dr.maximum(fx, fy) + BLUR_BORDER
    before, places = z > SplatOptions.near, (fx * x + cx, fy * y + cy)
    low = [dr.select(before, at - reach, dr.inf) for at in places]
    high = [dr.select(before, at + reach, -dr.inf) for at in places]
    dr.eval(low, high)  # together: else each reduction computes its own
    found = [*map(dr.min, low), *map(dr.max, high)]
    dr.eval(found)
    return found


def joined(*boxes: Box | None) -> Box:
    """Return the smallest box that contains some others."""
    sides = [(box.left, box.top, -box.right, -box.bottom) for box in boxes if box is not None]
    left, top, right, bottom = map(min, zip(*sides, strict=True))
    return Box(left, top, -right, -bottom)


def in_tiles(box: Box, camera: Camera) -> Box:
    """Widen a box to whole tiles of the renderer, where the picture has room.

    A picture in whole tiles shares its memory with its tensor, which need not be copied.
    """
    height, width = Layout(box.width, box.height).padded
    height, width = min(height, camera.height), min(width, camera.width)
    top, left = min(box.top, camera.height - height), min(box.left, camera.width - width)
    return Box(left, top, left + width, top + height)
