"""Make the masks of a video from its pictures and a network's rough probabilities.

1. Does the camera move? If so, its motion is found from picture to picture.
2. The plate and the colours of person and background are gathered from some pictures of the whole
   video, twice: first by the probabilities, then by the masks that follow from them.
3. Each picture then gets its evidence, its cut and the shares at the outline.

Memory does not grow with the video's length: pictures are read one by one.

The outline of a picture is the smoothest cut (:mod:`gva_mi.matting.cut`) by the log odds of its
pixels (:mod:`gva_mi.matting.odds`). A pixel there mixes the person's colour F and the background's
B:

1. ``I = a F + (1 - a) B``,   so   ``a = <I - B, F - B> / |F - B|^2``
2. its variance is   ``v = (n^2 + a^2 V) / |F - B|^2``

with the noise n of a colour and the variance V of the person's colours around. F is their mean just
inside, and B is the background, in the shade that is seen just outside
(:meth:`gva_mi.matting.plate.Plate.beside`). The cut, blurred a little, is another
estimate of a, whose variance w falls with the distance from the cut. The result is the
mean of both, weighted by the inverse variances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.core.console import Progress, listed
from gva_mi.core.tasks import on_all_cores
from gva_mi.matting.camera import (
    ALL_BACKGROUND,
    ShrunkPicture,
    WorkGrid,
    camera_motions,
    moved,
    moved_pixels,
)
from gva_mi.matting.cut import smoothest_cut
from gva_mi.matting.hands import Bones
from gva_mi.matting.odds import (
    BONE_RADIUS,
    HAND_RADIUS,
    ColorsByHeight,
    PersonColors,
    Shadows,
    count_shadows,
    log_odds,
)
from gva_mi.matting.plate import MEAN_SQUARE, Around, Plate, filled_in, overlay_of
from gva_mi.subject.crop import bounds
from gva_mi.subject.folder import SubjectWriter
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.splits import spread

# All chosen. Pixels are those of the working grid, unless the picture's are named.
OVERLAY_PICTURES = 24  # that show captions over the person; chosen, as for the scene
SCENE_PICTURES = 48  # pictures from which the scene is gathered: more cost time and show the same
MOTION_PICTURES = 6  # pictures that show whether the camera moves at all
STILL_PIXELS = 0.5  # the camera stands still if the picture's corners move by less
PERSON_PROBABILITY = 0.5  # a pixel with a larger one belongs to the person's extent
SMALLEST_PERSON = 64  # the picture's pixels: a person of fewer pixels is not a person
CHANGING_SPREAD = 0.04  # of the plate's colours in [0, 1]: with more it hardly tells the person
POSSIBLE_PERSON, CERTAIN_PERSON = 0.05, 0.95  # probabilities: background below, person above
# Pixels within this distance of the possible person are possible, too: first by the network's
# probability, then by the cut, which is closer to the outline.
POSSIBLE_MARGINS = 4, 3
INNER_MARGIN = 1  # pixels inside the outline, which mix two colours: they are not counted
LOOK_MARGIN = 0.12  # of the person's longer side: a picture is searched so far around the person
OUTLINE_PRICE, FLAT_OUTLINE_PRICE = 1.5, 4.0  # g of the cut: everywhere, and added on flat colours
# Difference of colours that leaves 1 / e of what is added, in mean differences of neighbours in the
# picture, as in GrabCut (Rother et al. 2004). Chosen on two rendered persons, by the face's masks.
EDGE_CONTRAST = 2.0
HAND_DISCOUNT = 0.5  # share of g that is saved at hands: fingers have much outline, little area
LEAST_DIFFERENCE = 1 / 255  # of neighbours: a picture of one colour has none
CUT_STEPS = 50  # iterations of the cut; later ones change few pixels
SMALLEST_PIECE = 0.002  # share of the largest piece's area: smaller pieces are dropped
LEAST_PIECE_PROBABILITY = 0.3  # mean probability of a piece; with less the network denies it


def video_masks(
    pictures: Sequence[np.ndarray],
    probabilities: Sequence[np.ndarray],
    landmarks: Landmarks,
    writer: SubjectWriter,
    progress: Progress | None = None,
) -> list[str]:
    """Write a soft mask of each picture of a subject; return notes.

    Args:
        pictures: T pictures (H, W, 3) 8-bit of one video. Each is read a few times; only the one
            that is worked on, and parts of some, stay in memory.
        probabilities: T probabilities of the person (H, W) 8-bit, 255 for certain; all zero where
            there is nobody.
        landmarks: of the T pictures; those of elbows and hands are used, where there are any.
        writer: of the subject. A picture without a person gets an empty mask.
        progress: called after each picture.
    """
    total = len(pictures)
    extents = np.array([_extent(probabilities[k]) for k in range(total)]).reshape(total, 4)
    shown = np.flatnonzero(extents[:, 2] > 0)
    notes: list[str] = []
    if len(shown):
        on_grid = _VideoOnGrid(pictures, probabilities, landmarks, extents, shown)
        scene = VideoScene.gather([on_grid.view(k) for k in spread(shown, SCENE_PICTURES)])
        notes = on_grid.notes()
        if on_grid.overlay is not None:
            overlay = on_grid.grid.paste(on_grid.overlay.astype(np.float32)) > 0
            writer.overlay(overlay)
            notes.append(
                f"{overlay.mean():.1%} of the picture stays the same while the person moves behind "
                "it, such as a caption; these pixels are not used"
            )
        spreads = scene.plate.spread[scene.plate.seen]
        if len(spreads) and np.median(spreads) > CHANGING_SPREAD:
            notes.append("the background changes, so masks rely on the network and on colours")
    nobody = np.zeros(pictures[0].shape[:2], np.uint8)

    def write(numbered: tuple[int, GridPicture | None]) -> int:
        k, view = numbered
        mask = nobody if view is None else on_grid.grid.paste(scene.mask(view))
        writer.mask(k, mask)
        return k

    views = ((k, on_grid.view(k) if extents[k, 2] > 0 else None) for k in range(total))
    for k in on_all_cores(write, views):
        if progress:
            progress(k + 1, total)
    absent = np.setdiff1d(np.arange(total), shown)
    if len(absent):
        notes.append(f"frames without a person, whose masks are empty: {listed(absent.tolist())}")
    return notes


def _extent(probability: np.ndarray) -> np.ndarray:
    """Return left, top, right, bottom (4,) of the person; zeros if there is none.

    ``probability`` is (H, W) 8-bit.
    """
    inside = probability > 255 * PERSON_PROBABILITY
    if inside.sum() < SMALLEST_PERSON:
        return np.zeros(4)
    return bounds(inside)


@dataclass
class _VideoOnGrid:
    """A video's pictures on their working grid, and its camera's motion."""

    pictures: Sequence[np.ndarray]
    probabilities: Sequence[np.ndarray]
    landmarks: Landmarks
    extents: np.ndarray  # (T, 4) of the person
    shown: np.ndarray  # numbers of the pictures that show the person

    def __post_init__(self) -> None:
        first = int(self.shown[0])
        self.grid = WorkGrid.around(self.extents[self.shown], self.pictures[first].shape[:2])
        self._motions: dict[int, np.ndarray | None] | None = None  # None: the camera stands
        tall = float(np.median(self.extents[self.shown] @ [0, -1, 0, 1])) * self.grid.scale
        read = (self._read(k) for k in spread(self.shown, OVERLAY_PICTURES))
        self.overlay = overlay_of(read, tall)
        some = self._found(spread(self.shown, MOTION_PICTURES)).values()
        if any(A is None or self._pixels(A) * self.grid.scale > STILL_PIXELS for A in some):
            self._motions = self._found(self.shown.tolist())

    def view(self, k: int) -> GridPicture:
        """Return a picture on the grid."""
        image, P = self._read(k)
        if self.overlay is not None:
            image, P = (filled_in(x, self.overlay) for x in (image, P))
        A = np.eye(3) if self._motions is None else self._motions[k]
        motion = None if A is None else self.grid.in_shares(A)
        bones = Bones.of(self.landmarks, k, self.grid)
        return GridPicture(image, P, self.grid.heights(self.extents[k]), motion, bones)

    def _read(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a picture on the grid (h, w, 3) 8-bit, and the person's probability (h, w)."""
        image, P = (self.grid.cut(x[k]) for x in (self.pictures, self.probabilities))
        return image, P.astype(np.float32) / 255

    def notes(self) -> list[str]:
        """Return sentences: that the camera moves, and in which pictures its motion is unknown."""
        if self._motions is None:
            return []
        moves = max(self._pixels(A) for A in self._motions.values() if A is not None)
        notes = [f"the camera moves: pictures shift by up to {moves:.0f} pixels"]
        lost = sum(A is None for A in self._motions.values())
        if lost:
            notes.append(
                f"{lost} of {len(self._motions)} frames share too little background with the "
                "middle one, so their masks rely on the network and on colours"
            )
        return notes

    def _found(self, numbers: Sequence[int]) -> dict[int, np.ndarray | None]:
        """Return the camera's motion (3, 3) from the middle picture to each, by number."""
        shrunk = lambda k: ShrunkPicture.of(self.pictures[k], self.probabilities[k])
        return camera_motions(shrunk, numbers)

    def _pixels(self, A: np.ndarray) -> float:
        """Return how far the picture's corners move, in its pixels."""
        return moved_pixels(A, self.grid.picture[::-1])


@dataclass(frozen=True)
class GridPicture:
    """One picture on the working grid."""

    image: np.ndarray  # (h, w, 3) 8-bit
    probability: np.ndarray  # (h, w) float32 in [0, 1], of the person
    height: np.ndarray  # (h,) of each row: 0 at the person's highest pixel, 1 at the lowest
    motion: np.ndarray | None  # (3, 3) from the plate, as in camera.py; None: unknown
    bones: Bones  # of hands and forearms

    def near_bones(self, radius: float) -> np.ndarray:
        """Return n (h, w) of a radius, a share of the person's height (:mod:`.hands`)."""
        person = 1 / (self.height[1] - self.height[0])
        return self.bones.near(self.probability.shape, radius * person)


@dataclass(frozen=True)
class VideoScene:
    """The background, its shadows, and the colours of person and background."""

    plate: Plate
    shadows: Shadows
    person: PersonColors
    background: ColorsByHeight

    @staticmethod
    def gather(views: Sequence[GridPicture]) -> VideoScene:
        """Gather the scene: by the probabilities, then by the masks found with these."""
        from scipy.ndimage import binary_dilation, binary_erosion

        inside = [view.probability > CERTAIN_PERSON for view in views]
        possible = [view.probability > POSSIBLE_PERSON for view in views]
        for near in POSSIBLE_MARGINS:
            outside = [~binary_dilation(x, iterations=near) for x in possible]
            person, background = PersonColors(), ColorsByHeight()
            for k, view in enumerate(views):
                inner = binary_erosion(inside[k], iterations=INNER_MARGIN)
                person.add(view.image, inner, view.height, view.near_bones(BONE_RADIUS))
                background.add(view.image, outside[k], np.linspace(0, 1, len(view.image)))
            scene = VideoScene(_plate(views, outside), Shadows(), person, background)
            scene = replace(scene, shadows=scene._shadows_of(views, outside))
            if near == POSSIBLE_MARGINS[0]:
                inside = list(on_all_cores(scene.inside, views))
                pairs = zip(inside, views, strict=True)
                possible = [x | (view.probability > CERTAIN_PERSON) for x, view in pairs]
        return scene

    def mask(self, view: GridPicture) -> np.ndarray:
        """Return the mask (h, w) float32 in [0, 1] of a picture."""
        mask, plate = np.zeros(view.probability.shape, np.float32), self._plate_in(view)
        inside = self.inside(view, plate)
        if not inside.any():
            return mask
        left, top, right, bottom = (int(x) for x in bounds(inside))
        wide = lambda low, high: slice(max(0, low - OUTLINE_BORDER), high + OUTLINE_BORDER)
        part = wide(top, bottom), wide(left, right)
        image = view.image[part].astype(np.float32) / 255
        mask[part] = outline_alpha(image, inside[part], plate.part(part))
        return mask

    def inside(self, view: GridPicture, plate: Plate | None = None) -> np.ndarray:
        """Return where the person is in a picture, (h, w) bool; ``plate`` is its plate."""
        part = _looked_at(view)
        image, P = view.image[part], view.probability[part]
        plate, rows = (plate or self._plate_in(view)).part(part), view.height[part[0]]
        grid_rows = np.linspace(0, 1, len(view.image))[part[0]]
        at_bones, at_hands = (view.near_bones(r)[part] for r in (BONE_RADIUS, HAND_RADIUS))
        person = self.person.density(image, rows, at_hands)
        background = self.background.density(image, grid_rows)
        image = image.astype(np.float32) / 255
        odds = log_odds(image, P, rows, plate, self.shadows, person, background, at_bones)
        cut = smoothest_cut(odds, _prices(image, at_hands), odds > 0, CUT_STEPS) > 0.5
        whole = np.zeros(view.probability.shape, bool)
        whole[part] = _person_alone(cut, P)
        return whole

    def _shadows_of(self, views: Sequence[GridPicture], outside: Sequence[np.ndarray]) -> Shadows:
        """Count shadows in pictures where the person is not, ``outside`` (h, w) bool of each."""

        def count(seen: tuple[GridPicture, np.ndarray]) -> np.ndarray:
            view, bare = seen
            part = _looked_at(view)
            image = view.image[part].astype(np.float32) / 255
            plate, height = self._plate_in(view).part(part), view.height[part[0]]
            return count_shadows(image, plate, bare[part], height)

        return Shadows.of(sum(on_all_cores(count, zip(views, outside, strict=True))))

    def _plate_in(self, view: GridPicture) -> Plate:
        """Return the plate as a picture's camera sees and exposes it."""
        if view.motion is None:
            return Plate.unknown(view.probability.shape)
        still = (view.motion == np.eye(3)).all()
        plate = self.plate if still else self.plate.moved(np.linalg.inv(view.motion))
        return plate.exposed_as(view.image, view.probability < POSSIBLE_PERSON)


def _plate(views: Sequence[GridPicture], outside: Sequence[np.ndarray]) -> Plate:
    """Gather the plate of pictures, as the reference's camera sees them."""
    images, bare = [], []
    for view, out in zip(views, outside, strict=True):
        if view.motion is None:
            continue
        image = view.image
        if not (view.motion == np.eye(3)).all():
            image = np.round(moved(image, view.motion)).astype(np.uint8)
            out = moved(out[..., None], view.motion, outside=0)[..., 0] > ALL_BACKGROUND
        images.append(image)
        bare.append(out)
    return Plate.gather(np.stack(images), np.stack(bare))


def _looked_at(view: GridPicture) -> tuple[slice, slice]:
    """Return rows and columns of a picture that may show the person."""
    possible = view.probability > POSSIBLE_PERSON
    rows, columns = (np.flatnonzero(possible.any(axis)) for axis in (1, 0))
    if not len(rows):
        return slice(0, 1), slice(0, 1)
    border = round(LOOK_MARGIN * max(np.ptp(rows), np.ptp(columns)) + 2)
    return tuple(slice(max(0, x[0] - border), x[-1] + 1 + border) for x in (rows, columns))


def _prices(image: np.ndarray, at_hands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return g of the cut between each pixel (h, w, 3) and its right and lower neighbour.

    ``at_hands`` (h, w) in [0, 1] is 1 at hands.
    """
    cheaper = 1 - HAND_DISCOUNT * at_hands

    def price(axis: int) -> np.ndarray:
        R, G, B = np.moveaxis(np.abs(np.diff(image, axis=axis)), -1, 0)
        differs = np.maximum(np.maximum(R, G), B)
        differs /= EDGE_CONTRAST * max(differs.mean(), LEAST_DIFFERENCE)
        price = OUTLINE_PRICE + FLAT_OUTLINE_PRICE * np.exp(-(differs**2))
        return price * (cheaper[:, 1:] if axis else cheaper[1:])

    return price(axis=1), price(axis=0)


def _person_alone(inside: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Drop pieces of a mask (h, w) bool that are small, or background to the network."""
    from scipy.ndimage import label

    pieces, count = label(inside)
    if count < 2:
        return inside
    area = np.bincount(pieces.ravel())[1:]
    likely = np.bincount(pieces.ravel(), probability.ravel())[1:] / area
    sure = (likely > LEAST_PIECE_PROBABILITY) | (area == area.max())
    kept = (area >= SMALLEST_PIECE * area.max()) & sure
    return np.concatenate([[False], kept])[pieces]


# Chosen: the blur of a phone's picture is a pixel or two wide.
OPEN_BAND = 3  # pixels on each side of the cut where eq. 1 decides
# Pixels around the person that have to be in the picture.
OUTLINE_BORDER = OPEN_BAND + MEAN_SQUARE + 2
CUT_BLUR = 0.6  # pixels, standard deviation
CUT_DEVIATION = 0.2  # square root of w at the cut
CUT_FADING = 1.2  # pixels, over which this square root falls to 1 / e
COLOR_NOISE = 0.02  # n of eq. 2, of colours in [0, 1]


def outline_alpha(image: np.ndarray, inside: np.ndarray, plate: Plate) -> np.ndarray:
    """Return the person's share (h, w) float32 of a picture (h, w, 3) in [0, 1].

    ``inside`` (h, w) bool is the cut.
    """
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    away = distance_transform_edt(inside) + distance_transform_edt(~inside) - 0.5
    open_ = away < OPEN_BAND
    alpha = inside.astype(np.float32)
    if not open_.any() or inside.all():
        return alpha
    blurred = gaussian_filter(alpha, CUT_BLUR)
    sure, bare = inside & ~open_, ~inside & ~open_
    F, V = Around.of(sure).moments(image)
    B = plate.beside(image, bare)
    span = np.einsum("ijk,ijk->ij", F - B, F - B) + 1e-6
    share = (np.einsum("ijk,ijk->ij", image - B, F - B) / span).clip(0, 1)
    doubt = (COLOR_NOISE**2 + share**2 * V) / span
    w = (CUT_DEVIATION * np.exp(-away / CUT_FADING)) ** 2
    mixed = (share * w + blurred * doubt) / (w + doubt)
    return np.where(open_, mixed, alpha).astype(np.float32)
