"""Find the masks of a video from its pictures and a network's rough probabilities.

1. Does the camera move? If so, its motion is found from picture to picture.
2. The plate and the colours of person and background are gathered from some pictures of the whole
   video, twice: first by the probabilities, then by the masks that follow from them.
3. Each picture then gets its evidence, its cut and the shares at the outline.

Memory does not grow with the video's length: pictures are read one by one.

The outline of a picture is the smoothest cut. With log odds L of being the person and the price g
of an outline between two pixels, the set ``{u = 1}`` that minimises

1. ``E(u) = sum g |grad u| - sum L u``,   ``0 <= u <= 1``

is the minimum cut: the relaxation to fractions is exact, and any threshold of u gives an optimum
(Chan, Esedoglu and Nikolova 2006). It is found by the primal-dual iteration of Chambolle and Pock
(2011), whose dual variable p has ``|p| <= g``:

2. ``p <- project(p + s grad v)``
3. ``u' = clip(u + t (div p + L), 0, 1)``,   ``v = 2 u' - u``

A pixel there mixes the person's colour F and the background's B:

4. ``I = a F + (1 - a) B``,   so   ``a = <I - B, F - B> / |F - B|^2``
5. its variance is   ``v = (n^2 + a^2 V) / |F - B|^2``

with the noise n of a colour and the variance V of the person's colours around. F is their mean just
inside, and B is the background, in the shade that is seen just outside
(:meth:`gva_mi.matting.plate.Plate.beside`). The cut says something, too: blurred a little, it
is another estimate of a, whose variance w falls with the distance from the cut. The result is the
mean of both, weighted by the inverse variances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gva_mi.core.console import Progress, listed
from gva_mi.core.tasks import on_all_cores
from gva_mi.matting.camera import ShrunkPicture, WorkGrid, camera_motion, moved
from gva_mi.matting.odds import ColorsByHeight, Shadows, counted, log_odds
from gva_mi.matting.plate import REACH, Plate, mean_around
from gva_mi.subject.crop import bounds
from gva_mi.subject.folder import frame_name
from gva_mi.subject.pictures import write_image
from gva_mi.subject.splits import spread

GATHERED = 48  # pictures that the plate and the colours are gathered from
COMPARED = 6  # pictures that show whether the camera moves at all
STILL = 0.5  # pixels of the grid: the camera stands if the picture's corners move less
PERSON = 0.5  # probability from which a pixel counts to the person's extent
SMALLEST = 64  # pixels of that kind: with fewer there is no person
UNSTEADY = 0.04  # spread of colours: beyond it the background changes too much to help
POSSIBLE, CERTAIN = 0.05, 0.95  # probabilities: below the one is background, above the other person
NEAR = 4, 3  # pixels around what is possible that count as possible, too: by the network, the cut
INNER = 1  # pixels inside of the outline whose colours are not counted
AROUND = 0.12  # of the person's longer side: where a picture is looked at beyond what is possible
PRICE, FLAT_PRICE = 1.5, 4.0  # of an outline: anywhere, and added where colours are equal
EDGE = 0.1  # difference of colours, in [0, 1], at which less than half of this is added
STEPS = 50  # of the cut
ISLAND = 0.002  # share of the largest piece's area: smaller ones are dropped


def video_masks(
    pictures: Sequence[np.ndarray],
    probabilities: Sequence[np.ndarray],
    out: Path,
    progress: Progress | None = None,
) -> list[str]:
    """Write a soft mask of each picture, ``out/000000.png`` and so on; return notes.

    Args:
        pictures: T pictures (H, W, 3) 8-bit of one video. Each is read a few times; only the one
            that is worked on, and parts of some, stay in memory.
        probabilities: T probabilities of the person (H, W) 8-bit, 255 for certain; all zero where
            there is nobody.
        out: folder of the masks. A picture without a person gets an empty one.
        progress: called after each picture.
    """
    total = len(pictures)
    extents = np.array([_extent(probabilities[k]) for k in range(total)]).reshape(total, 4)
    shown = np.flatnonzero(extents[:, 2] > 0)
    notes: list[str] = []
    if len(shown):
        recording = _VideoOnGrid(pictures, probabilities, extents, shown)
        scene = VideoScene.gather([recording.view(k) for k in spread(shown, GATHERED)])
        notes = recording.notes()
        if scene.plate.seen.any() and np.median(scene.plate.spread[scene.plate.seen]) > UNSTEADY:
            notes.append("the background changes, so masks rely on the network and on colours")
    nobody = np.zeros(pictures[0].shape[:2], np.uint8)

    def write(numbered: tuple[int, GridPicture | None]) -> int:
        k, view = numbered
        mask = nobody if view is None else recording.grid.paste(scene.mask(view))
        write_image(Path(out) / frame_name(k), mask)
        return k

    views = ((k, recording.view(k) if extents[k, 2] > 0 else None) for k in range(total))
    for k in on_all_cores(write, views):
        if progress:
            progress(k + 1, total)
    absent = np.setdiff1d(np.arange(total), shown)
    if len(absent):
        notes.append(f"frames without a person, whose masks are empty: {listed(absent.tolist())}")
    return notes


def _extent(probability: np.ndarray) -> np.ndarray:
    """Return left, top, right, bottom (4,) of a probability (H, W) 8-bit; zeros without anybody."""
    inside = probability > 255 * PERSON
    if inside.sum() < SMALLEST:
        return np.zeros(4)
    return bounds(inside)


@dataclass
class _VideoOnGrid:
    """A video's pictures on their working grid, and its camera's motion."""

    pictures: Sequence[np.ndarray]
    probabilities: Sequence[np.ndarray]
    extents: np.ndarray  # (T, 4) of the person
    shown: np.ndarray  # numbers of the pictures that show the person

    def __post_init__(self) -> None:
        first = int(self.shown[0])
        self.grid = WorkGrid.around(self.extents[self.shown], self.pictures[first].shape[:2])
        self._motions: dict[int, np.ndarray | None] | None = None  # None: the camera stands
        some = np.array(spread(self.shown, COMPARED))
        if any(A is None or self._pixels(A) > STILL for A in self._found(some).values()):
            self._motions = self._found(self.shown)

    def view(self, k: int) -> GridPicture:
        """Return a picture on the grid."""
        image, P = (self.grid.cut(x[k]) for x in (self.pictures, self.probabilities))
        A = np.eye(3) if self._motions is None else self._motions[k]
        motion = None if A is None else self.grid.in_shares(A)
        P = P.astype(np.float32) / 255
        return GridPicture(image, P, self.grid.heights(self.extents[k]), motion)

    def notes(self) -> list[str]:
        """Return a sentence if the camera moves, and one on pictures where it is lost."""
        if self._motions is None:
            return []
        moves = max(self._pixels(A) for A in self._motions.values() if A is not None)
        notes = [f"the camera moves: pictures shift by up to {moves / self.grid.scale:.0f} pixels"]
        lost = [k for k, A in self._motions.items() if A is None]
        if lost:
            notes.append(f"frames that share too little background with others: {listed(lost)}")
        return notes

    def _found(self, numbers: np.ndarray) -> dict[int, np.ndarray | None]:
        """Return the camera's motion (3, 3) from the middle picture to each, by number."""
        shrunk = lambda k: ShrunkPicture.of(self.pictures[k], self.probabilities[k])
        middle = len(self.shown) // 2
        reference, found = shrunk(int(self.shown[middle])), {}
        after = numbers >= self.shown[middle]
        for run in (numbers[after], numbers[~after][::-1]):
            last = np.eye(3)
            for k in run.tolist():
                found[k] = camera_motion(reference, shrunk(k), last)
                last = last if found[k] is None else found[k]
        return found

    def _pixels(self, A: np.ndarray) -> float:
        """Return how far the picture's corners move, in pixels of the grid."""
        corners = np.array([[x, y, 1.0] for x in (-1, 1) for y in (-1, 1)])
        away = (corners @ A.T - corners)[:, :2] * self.grid.picture[::-1] / 2
        return float(np.abs(away).max() * self.grid.scale)


@dataclass(frozen=True)
class GridPicture:
    """One picture on the working grid."""

    image: np.ndarray  # (h, w, 3) 8-bit
    probability: np.ndarray  # (h, w) float32 in [0, 1], of the person
    height: np.ndarray  # (h,) of each row: 0 at the person's highest pixel, 1 at the lowest
    motion: np.ndarray | None  # (3, 3) from the plate to this picture, as in camera.py; None: lost


@dataclass(frozen=True)
class VideoScene:
    """The background, its shadows, and the colours of person and background."""

    plate: Plate
    shadows: Shadows
    person: ColorsByHeight
    background: ColorsByHeight

    @staticmethod
    def gather(views: Sequence[GridPicture]) -> VideoScene:
        """Gather the scene: by the probabilities, then by the masks found with these."""
        from scipy.ndimage import binary_dilation, binary_erosion

        inside = [view.probability > CERTAIN for view in views]
        possible = [view.probability > POSSIBLE for view in views]
        for near in NEAR:
            outside = [~binary_dilation(x, iterations=near) for x in possible]
            person, background = ColorsByHeight(), ColorsByHeight()
            for k, view in enumerate(views):
                person.add(view.image, binary_erosion(inside[k], iterations=INNER), view.height)
                background.add(view.image, outside[k], np.linspace(0, 1, len(view.image)))
            scene = VideoScene(_plate(views, outside), Shadows(), person, background)
            scene = replace(scene, shadows=scene._shadows_of(views, outside))
            if near == NEAR[0]:
                inside = list(on_all_cores(scene.inside, views))
                possible = [
                    x | (view.probability > CERTAIN) for x, view in zip(inside, views, strict=True)
                ]
        return scene

    def mask(self, view: GridPicture) -> np.ndarray:
        """Return the mask (h, w) float32 in [0, 1] of a picture."""
        mask, plate = np.zeros(view.probability.shape, np.float32), self._plate_in(view)
        inside = self.inside(view, plate)
        if not inside.any():
            return mask
        left, top, right, bottom = (int(x) for x in bounds(inside))
        wide = lambda low, high: slice(max(0, low - BORDER), high + BORDER)
        part = wide(top, bottom), wide(left, right)
        image = view.image[part].astype(np.float32) / 255
        mask[part] = outline_alpha(image, inside[part], plate.part(part))
        return mask

    def inside(self, view: GridPicture, plate: Plate | None = None) -> np.ndarray:
        """Return where the person is in a picture (h, w) bool, whose plate may be known."""
        part = _looked_at(view)
        image, P = view.image[part], view.probability[part]
        plate, rows = (plate or self._plate_in(view)).part(part), view.height[part[0]]
        grid_rows = np.linspace(0, 1, len(view.image))[part[0]]
        person, background = (
            self.person.density(image, rows),
            self.background.density(image, grid_rows),
        )
        image = image.astype(np.float32) / 255
        odds = log_odds(image, P, rows, plate, self.shadows, person, background)
        cut = smoothest_cut(odds, _prices(image), odds > 0, STEPS) > 0.5
        whole = np.zeros(view.probability.shape, bool)
        whole[part] = _person_alone(cut, P)
        return whole

    def _shadows_of(self, views: Sequence[GridPicture], outside: Sequence[np.ndarray]) -> Shadows:
        """Count shadows around the person, in pictures (h, w) bool of where it is not."""

        def count(seen: tuple[GridPicture, np.ndarray]) -> np.ndarray:
            view, bare = seen
            part = _looked_at(view)
            image = view.image[part].astype(np.float32) / 255
            return counted(image, self._plate_in(view).part(part), bare[part], view.height[part[0]])

        return Shadows.of(sum(on_all_cores(count, zip(views, outside, strict=True))))

    def _plate_in(self, view: GridPicture) -> Plate:
        """Return the plate as a picture's camera sees and exposes it."""
        if view.motion is None:
            return Plate.unknown(view.probability.shape)
        still = (view.motion == np.eye(3)).all()
        plate = self.plate if still else self.plate.moved(np.linalg.inv(view.motion))
        return plate.exposed_as(view.image, view.probability < POSSIBLE)


def _plate(views: Sequence[GridPicture], outside: Sequence[np.ndarray]) -> Plate:
    """Gather the plate of pictures, as the reference's camera sees them."""
    images, bare = [], []
    for view, out in zip(views, outside, strict=True):
        if view.motion is None:
            continue
        image = view.image
        if not (view.motion == np.eye(3)).all():
            image = np.round(moved(image, view.motion)).astype(np.uint8)
            out = moved(out[..., None], view.motion, outside=0)[..., 0] > 0.99
        images.append(image)
        bare.append(out)
    return Plate.gather(np.stack(images), np.stack(bare))


def _looked_at(view: GridPicture) -> tuple[slice, slice]:
    """Return rows and columns of a picture that may show the person."""
    possible = view.probability > POSSIBLE
    rows, columns = (np.flatnonzero(possible.any(axis)) for axis in (1, 0))
    if not len(rows):
        return slice(0, 1), slice(0, 1)
    border = round(AROUND * max(np.ptp(rows), np.ptp(columns)) + 2)
    return tuple(slice(max(0, x[0] - border), x[-1] + 1 + border) for x in (rows, columns))


def _prices(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the price of an outline between each pixel (h, w, 3) and the right and lower one."""
    found = []
    for axis in (1, 0):
        R, G, B = np.moveaxis(np.abs(np.diff(image, axis=axis)), -1, 0)
        differs = np.maximum(np.maximum(R, G), B) / EDGE
        found.append(PRICE + FLAT_PRICE * np.exp(-(differs**2)))
    return found[0], found[1]


def _person_alone(inside: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Drop pieces (h, w) bool that are small, or that the network holds for background."""
    from scipy.ndimage import label

    pieces, count = label(inside)
    if count < 2:
        return inside
    area = np.bincount(pieces.ravel())[1:]
    likely = np.bincount(pieces.ravel(), probability.ravel())[1:] / area
    kept = (area >= ISLAND * area.max()) & ((likely > 0.3) | (area == area.max()))
    return np.concatenate([[False], kept])[pieces]


STEP = 0.35  # s = t; s t |grad|^2 <= 1 is needed, and |grad|^2 <= 8


def smoothest_cut(
    odds: np.ndarray, price: tuple[np.ndarray, np.ndarray], start: np.ndarray, steps: int
) -> np.ndarray:
    """Return u (H, W) in [0, 1], nearly binary, that minimises eq. 1.

    Args:
        odds: L (H, W) float32, log odds of the person.
        price: g of an outline between a pixel and its right neighbour (H, W - 1), and between
            a pixel and the one below (H - 1, W), in the odds' unit.
        start: u to start from (H, W).
        steps: iterations.
    """
    right, below = (x.astype(np.float32) for x in price)
    u = start.astype(np.float32)
    v, moved = u.copy(), np.empty_like(u)
    p, q = np.zeros_like(right), np.zeros_like(below)
    step_p, step_q, least_p, least_q = np.empty_like(p), np.empty_like(q), -right, -below
    for _ in range(steps):
        p += np.multiply(np.subtract(v[:, 1:], v[:, :-1], out=step_p), STEP, out=step_p)
        q += np.multiply(np.subtract(v[1:], v[:-1], out=step_q), STEP, out=step_q)
        np.minimum(np.maximum(p, least_p, out=p), right, out=p)  # half of the time of np.clip
        np.minimum(np.maximum(q, least_q, out=q), below, out=q)
        moved[:] = odds
        moved[:, :-1] += p
        moved[:, 1:] -= p
        moved[:-1] += q
        moved[1:] -= q
        moved *= STEP
        moved += u
        np.minimum(np.maximum(moved, 0, out=moved), 1, out=moved)
        np.subtract(np.multiply(moved, 2, out=v), u, out=v)
        u, moved = moved, u
    return u


BAND = 3  # pixels on each side of the cut whose share is open
BORDER = BAND + REACH + 2  # pixels around the person that have to be in the picture
BLUR = 0.6  # pixels, of the cut
DOUBT, FADES = 0.2, 1.2  # square root of w at the cut; pixels in which it falls to a share 1 / e
NOISE = 0.02  # n


def outline_alpha(image: np.ndarray, inside: np.ndarray, plate: Plate) -> np.ndarray:
    """Return the person's share (h, w) float32 of a picture (h, w, 3) in [0, 1].

    ``inside`` (h, w) bool is the cut.
    """
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    away = distance_transform_edt(inside) + distance_transform_edt(~inside) - 0.5
    open_ = away < BAND
    alpha = inside.astype(np.float32)
    if not open_.any() or inside.all():
        return alpha
    blurred = gaussian_filter(alpha, BLUR)
    sure, bare = inside & ~open_, ~inside & ~open_
    F, V = mean_around(image, sure)
    B = plate.beside(image, bare)
    span = np.einsum("ijk,ijk->ij", F - B, F - B) + 1e-6
    share = (np.einsum("ijk,ijk->ij", image - B, F - B) / span).clip(0, 1)
    doubt = (NOISE**2 + share**2 * V) / span
    w = (DOUBT * np.exp(-away / FADES)) ** 2
    mixed = (share * w + blurred * doubt) / (w + doubt)
    return np.where(open_, mixed, alpha).astype(np.float32)
