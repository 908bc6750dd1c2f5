"""Counts, sizes, masks that say nothing, splits, and the body that a folder is for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from gva_mi.body.smplx import BodyModel
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.data.check.contents import Contents, MaskSeen
from gva_mi.data.check.findings import Finding
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.normals import ABOUT, NormalMaps
from gva_mi.data.views import read_views
from gva_mi.splat import Camera

FULL = 0.995  # of a picture: what lies outside is noise of a file's compression
# A person stands on one side of the border, or on two where head and feet are cut off; what is
# around the person touches all four.
AROUND = 0.5  # of the border


def check_files(contents: Contents, body: BodyModel) -> Iterator[Finding]:
    """Everything that needs no picture of the body."""
    yield from _pictures(contents)
    yield from _masks(contents)
    yield from _counts(contents)
    yield from _splits(contents)
    yield from _views(contents)
    try:
        require_same_body(contents.folder, body)
    except InputError as error:
        yield Finding(
            "error", "another body", str(error), "poses of one body on another are other poses",
            "give the --body that the folder is for",
        )  # fmt: skip


def inverted(mask: MaskSeen) -> bool:
    """Whether a mask is of what is around the person."""
    return AROUND < mask.border and mask.share < FULL


def says_nothing(mask: MaskSeen) -> bool:
    """Whether a mask has no outline."""
    return mask.share == 0 or mask.share >= FULL


def _pictures(contents: Contents) -> Iterator[Finding]:
    there = contents.pictures
    gaps = [k for k in range(contents.count) if k not in there]
    if gaps:
        yield Finding(
            "doubtful", "missing pictures", f"{len(gaps)} of {contents.count}",
            "frames were lost, or numbered with a step",
            "number frames 0, 1, 2, ... without gaps, masks and poses alike", tuple(gaps),
        )  # fmt: skip
    if not there:
        return
    size = _size(contents.cameras)
    where = "cameras.npz"
    if size is None:
        size, where = next(iter(there.values())), "the first frame"
    other = [k for k, s in there.items() if s != size]
    if other:
        w, h = there[other[0]]
        yield Finding(
            "error", "picture size", f"{w}x{h}, {where} says {size[0]}x{size[1]}",
            "the pictures were shrunk or turned after the cameras were made, or before",
            "use the pictures that K belongs to, or scale K and width, height with them",
            tuple(other),
        )  # fmt: skip


def _masks(contents: Contents) -> Iterator[Finding]:
    there, masks = contents.pictures, contents.masks
    folder = contents.folder / "masks"
    files = {p.stem for p in folder.glob("*") if p.suffix in (".png", ".npy")}
    missing = [k for k in there if f"{k:06d}" not in files]
    if missing:
        none = len(missing) == len(there)
        yield Finding(
            "error" if none else "doubtful", "missing masks", f"{len(missing)} of {len(there)}",
            "no segmentation, or its files have other names" if none else "the segmenter gave none",
            "write masks/000000.png ...; frames without one are left out", tuple(missing),
        )  # fmt: skip
    more = sorted(name for name in files if not _names(name, contents))
    if more and there:
        yield Finding(
            "doubtful", "masks without a frame", f"{len(more)}, such as {more[0]}",
            "masks and frames are of different videos, or numbered from another number",
            "number masks as the frames",
        )  # fmt: skip
    other = [k for k, m in masks.items() if k in there and m.size != there[k]]
    if other:
        (w, h), (fw, fh) = masks[other[0]].size, there[other[0]]
        yield Finding(
            "error", "mask size", f"{w}x{h}, its frame is {fw}x{fh}",
            "the segmenter shrank or turned its input", "scale the masks to the frames' size",
            tuple(other),
        )  # fmt: skip
    yield from _outlines(masks)


def _names(stem: str, contents: Contents) -> bool:
    return stem.isdecimal() and int(stem) < contents.count


def _outlines(masks: dict[int, MaskSeen]) -> Iterator[Finding]:
    """Masks that are empty, full, or of the background."""
    some = lambda fits: tuple(k for k, m in masks.items() if fits(m))
    empty = some(lambda m: m.share == 0)
    labels = [masks[k].largest for k in empty if 1 < masks[k].largest < 128]
    if labels:
        yield Finding(
            "error", "masks of labels", f"largest value {max(labels)} of 255",
            "numbers of people or parts, not 0 and 255",
            "write 255 where the person is", empty,
        )  # fmt: skip
    elif empty:
        yield Finding(
            "error" if len(empty) == len(masks) else "doubtful", "empty masks",
            f"{len(empty)} of {len(masks)}", "the segmenter lost the person",
            "none, if so: these frames are left out", empty,
        )  # fmt: skip
    full = some(lambda m: m.share >= FULL)
    if full:
        share = min(masks[k].share for k in full)
        yield Finding(
            "error", "full masks", f"{100 * share:.1f} % of the picture",
            "an alpha channel that was never written, or a threshold of zero",
            "make these masks again, or delete them: frames without one are left out", full,
        )  # fmt: skip
    around = some(inverted)
    if around:
        share = np.median([masks[k].border for k in around])
        yield Finding(
            "error", "inverted masks", f"{100 * share:.0f} % of the picture's border is inside",
            "255 is the background", "write 255 where the person is", around,
        )  # fmt: skip


def _counts(contents: Contents) -> Iterator[Finding]:
    count = contents.count
    if not count:
        return
    lengths: list[tuple[str, int]] = []
    if contents.poses is not None and np.ndim(contents.poses.get("transl")) == 2:
        lengths.append((contents.poses_file.name, len(contents.poses["transl"])))
    for key in ("K", "T_camera_world"):
        array = (contents.cameras or {}).get(key)
        if np.ndim(array) == 3 and len(array) != 1:
            lengths.append((f"cameras.npz, {key}", len(array)))
    for name, length in lengths:
        if length != count:
            yield Finding(
                "error", "counts", f"{name}: {length} frames, the video has {count}",
                "the estimator dropped frames, or another frame rate was extracted",
                "make poses and cameras of exactly these frames",
            )  # fmt: skip


def _views(contents: Contents) -> Iterator[Finding]:
    try:
        read_views(contents.folder, contents.count)
    except InputError as error:
        yield Finding(
            "error", "views of other cameras", str(error), "files were lost, or of another video",
            "prepare the folder again with --views, or remove views/",
        )  # fmt: skip


def _splits(contents: Contents) -> Iterator[Finding]:
    path = contents.folder / "splits.json"
    if not path.exists():
        return
    form = '{"train": [...], "test": [...]} of frame numbers'
    try:
        data = read_json(path, form)
        with expecting(path, form):
            lists = {name: [int(k) for k in data[name]] for name in ("train", "test")}
    except InputError as error:
        yield Finding("error", "splits", f"unreadable ({error})", "of another form", form)
        return
    train, test = set(lists["train"]), set(lists["test"])
    both = sorted(train & test)
    if both:
        yield Finding(
            "error", "splits overlap", f"{len(both)} frames are in train and test",
            "ranges that include both ends", "take each frame into one list alone", tuple(both),
        )  # fmt: skip
    outside = sorted(k for k in train | test if not 0 <= k < contents.count)
    if outside and contents.count:
        yield Finding(
            "error", "splits beyond the video",
            f"frame {outside[0]}, the video has 0 to {contents.count - 1}",
            "numbered from 1, or for a longer video", form, tuple(outside),
        )  # fmt: skip
    gone = sorted(k for k in train | test if 0 <= k < contents.count and _absent(contents, k))
    if gone:
        yield Finding(
            "doubtful", "splits of absent frames", f"{len(gone)} frames",
            "they have no picture or no mask", "none, if so: they are left out", tuple(gone),
        )  # fmt: skip
    if not train:
        yield Finding("error", "splits", "no train frame", "the list is empty", form)


def _absent(contents: Contents, index: int) -> bool:
    mask = contents.masks.get(index)
    return index not in contents.pictures or mask is None or mask.share == 0


def _size(cameras: dict[str, np.ndarray] | None) -> tuple[int, int] | None:
    """(W, H) of the cameras; None where they say none."""
    found = [(cameras or {}).get(name) for name in ("width", "height")]
    if any(x is None or x.size != 1 or x.dtype.kind not in "iuf" for x in found):
        return None
    return tuple(int(x.item()) if np.isfinite(x.item()) else 0 for x in found)


def open_normals(
    contents: Contents, cameras: dict[int, Camera], say: Callable[[Finding], None]
) -> NormalMaps | None:
    """The normal maps; a finding for each kind of map that cannot be read."""
    try:
        maps = NormalMaps.open(contents.folder, max(1, contents.count))
    except InputError as error:
        say(_unreadable(str(error), ()))
        return None
    if maps is None:
        return None
    reasons: dict[int, str] = {}
    for k in sorted(cameras):
        try:
            maps.check(k, cameras[k])
        except InputError as error:
            reasons[k] = str(error)
    if reasons:
        say(_unreadable(next(iter(reasons.values())), reasons))
    return None if len(reasons) == len(cameras) else maps


def _unreadable(figure: str, frames: Iterable[int]) -> Finding:
    return Finding(
        "error", "normals cannot be read", figure, "maps of a crop, or of another size",
        f"write maps of the frame's size, or the crop's 'boxes' into {ABOUT}", tuple(frames),
    )  # fmt: skip
