"""``K`` and ``T_camera_world`` as matrices: what they cannot be, and what they may be instead."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gva_mi.data.check.contents import Contents
from gva_mi.data.check.findings import Finding
from gva_mi.splat import Camera

RIGID = 1e-4  # of R Rᵀ − 1; what Camera takes for a rotation
SKEW = 0.5  # px at the picture's border, which steps ignore: half a pixel is not seen
# A lens's axis meets the middle of a picture to a few percent. K of a picture 1.25 times as large
# has it an eighth of the width away.
OFF_CENTRE = 0.12  # of width or height
ANAMORPHIC = 1.5  # fx over fy: the widest pixels of any video standard, 16:9 in PAL, are 1.46


def check_cameras(contents: Contents) -> Iterator[Finding]:
    """Findings about the matrices alone."""
    found = contents.cameras
    if found is None:
        return
    missing = [k for k in ("K", "T_camera_world", "width", "height") if k not in found]
    if missing:
        yield Finding(
            "error", "cameras lack a key", f"'{missing[0]}'; there are: {', '.join(sorted(found))}",
            "written by another program", "write K, T_camera_world, width, height",
        )  # fmt: skip
    for key, size in (("K", 3), ("T_camera_world", 4)):
        if key in found and stack(found[key], size) is None:
            yield Finding(
                "error", f"{key} of another form", f"{found[key].dtype} {found[key].shape}",
                "3x4 matrices, or one list for all" if size == 4 else "fx, fy, cx, cy as a list",
                f"({size}, {size}), or one for each frame",
            )  # fmt: skip
    K, T = stack(found.get("K"), 3), stack(found.get("T_camera_world"), 4)
    for key, stacked in (("K", K), ("T_camera_world", T)):
        if stacked is not None and (bad := ~np.isfinite(stacked).all((1, 2))).any():
            yield Finding(
                "error", f"{key} is not finite", f"{bad.sum()} of {len(bad)} frames",
                "a calibration that failed", "give these frames the camera of a neighbour",
                _frames(bad),
            )  # fmt: skip
    if K is not None:
        yield from _intrinsics(K, _size(found))
    if T is not None:
        yield from _extrinsics(T)


def stack(array: np.ndarray | None, size: int) -> np.ndarray | None:
    """Matrices (T, size, size) in float64; None where it is something else."""
    if array is None or array.dtype.kind not in "iuf" or array.ndim not in (2, 3):
        return None
    if array.shape[-2:] != (size, size) or not len(array):
        return None
    return array.astype(np.float64).reshape(-1, size, size)


def usable_cameras(contents: Contents) -> dict[int, Camera]:
    """The camera of each frame that has one, of matrices normalised and turned back where needed.

    A mirrored T_camera_world is no camera here: nothing tells which of its axes is wrong.
    """
    found = contents.cameras or {}
    K, T, size = stack(found.get("K"), 3), stack(found.get("T_camera_world"), 4), _size(found)
    if K is None or T is None or size is None:
        return {}
    cameras = {}
    for k in sorted(contents.pictures):
        if (len(K) > 1 and k >= len(K)) or (len(T) > 1 and k >= len(T)):
            break
        k_frame, t_frame = K[k if len(K) > 1 else 0], T[k if len(T) > 1 else 0]
        k_frame = k_frame.T if _is_transposed_K(k_frame[None])[0] else k_frame
        t_frame = t_frame.T if _is_transposed_T(t_frame[None])[0] else t_frame
        if not np.isfinite(t_frame).all() or np.linalg.det(t_frame[:3, :3]) <= 0:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            normalised = k_frame / k_frame[2, 2]
        try:
            cameras[k] = Camera.from_matrices(normalised, t_frame, *size)
        except ValueError:  # said by check_cameras
            continue
    return cameras


def _intrinsics(given: np.ndarray, size: tuple[int, int] | None) -> Iterator[Finding]:
    K = _finite(given)
    if K is None:
        return
    transposed = _is_transposed_K(K)
    if transposed.any():
        yield Finding(
            "error", "K is transposed", f"its last row is {_row(K[transposed][0, 2])}",
            "written column by column", "transpose K: its last row is 0 0 1", _frames(transposed),
        )  # fmt: skip
        return
    scale = K[:, 2, 2]
    other = np.abs(scale - 1) > 1e-6
    if other.any():
        yield Finding(
            "error", "K is not normalised", f"K22 is {scale[other][0]:.6g}",
            "scaled as a whole when the pictures were", "divide K by K22", _frames(other),
        )  # fmt: skip
    K = K / np.where(scale != 0, scale, 1)[:, None, None]
    bad = (K[:, 0, 0] <= 0) | (K[:, 1, 1] <= 0)
    if bad.any():
        yield Finding(
            "error", "focal length", f"fx, fy are {K[bad][0, 0, 0]:.6g}, {K[bad][0, 1, 1]:.6g}",
            "axes of OpenGL in K, or none was written", "K in OpenCV's axes: fx, fy above zero",
            _frames(bad),
        )  # fmt: skip
        return
    aspect = K[:, 0, 0] / K[:, 1, 1]
    uneven = np.maximum(aspect, 1 / aspect) > ANAMORPHIC
    if uneven.any():
        yield Finding(
            "doubtful", "focal length", f"fx / fy is {aspect[uneven][0]:.3g}",
            "normalised by width and height, or scaled in one direction", "fx, fy in pixels",
            _frames(uneven),
        )  # fmt: skip
    if size is not None and min(size) > 0:
        yield from _principal_point(K, size)


def _principal_point(K: np.ndarray, size: tuple[int, int]) -> Iterator[Finding]:
    at = K[:, :2, 2] / size
    off = (np.abs(at - 0.5) > OFF_CENTRE).any(1)
    if off.any():
        times = 2 * at[off][0]
        same = abs(times[0] - times[1]) < 0.05
        yield Finding(
            "doubtful", "principal point",
            f"at {at[off][0][0]:.2f} of the width, {at[off][0][1]:.2f} of the height",
            f"K is of pictures {times[0]:.3g} times as large" if same and times[0] > 0
            else "the pictures are crops, or K is of others",
            "scale K with the pictures, or subtract a crop's corner from cx, cy", _frames(off),
        )  # fmt: skip
    skew = np.abs(K[:, 0, 1]) * size[1] / (2 * K[:, 1, 1])
    if (skewed := skew > SKEW).any():
        yield Finding(
            "doubtful", "K has skew", f"{skew.max():.2g} px at the border",
            "a calibration's fourth parameter", "undistort the pictures: steps ignore it",
            _frames(skewed),
        )  # fmt: skip


def _extrinsics(given: np.ndarray) -> Iterator[Finding]:
    T = _finite(given)
    if T is None:
        return
    transposed = _is_transposed_T(T)
    if transposed.any():
        yield Finding(
            "error", "T_camera_world is transposed", f"its last row is {_row(T[transposed][0, 3])}",
            "written for row vectors, or column by column", "transpose it: its last row is 0 0 0 1",
            _frames(transposed),
        )  # fmt: skip
        return
    R = T[:, :3, :3]
    square, det = R @ R.swapaxes(1, 2), np.linalg.det(R)
    scale = np.sqrt(np.trace(square, axis1=1, axis2=2) / 3)
    unit = square / np.maximum(scale, 1e-12)[:, None, None] ** 2
    bent = np.abs(unit - np.eye(3)).max((1, 2)) > RIGID
    scaled = ~bent & (np.abs(scale**2 - 1) > RIGID)
    if bent.any():
        yield Finding(
            "error", "T_camera_world is no rotation",
            f"R Rᵀ is off by {np.abs(square - np.eye(3))[bent].max():.2g}",
            "rounded, blended, or projected", "replace R by the nearest rotation, by its SVD",
            _frames(bent),
        )  # fmt: skip
    if scaled.any():
        yield Finding(
            "error", "T_camera_world has a scale", f"{scale[scaled][0]:.6g}",
            "a world of other units, as structure from motion gives it",
            "divide T by it, and scale the world of the poses", _frames(scaled),
        )  # fmt: skip
    if (mirrored := ~bent & (det < 0)).any():
        yield Finding(
            "error", "T_camera_world is mirrored", "det R is -1",
            "one axis was flipped where two belong together (OpenGL: y and z)",
            "flip y and z, and x not", _frames(mirrored),
        )  # fmt: skip


def _is_transposed_K(K: np.ndarray) -> np.ndarray:
    """Of K (T, 3, 3): principal points in the last row, and none in the last column."""
    return (np.abs(K[:, 2, :2]) > 1).any(1) & (np.abs(K[:, :2, 2]) < 1).all(1)


def _is_transposed_T(T: np.ndarray) -> np.ndarray:
    """Of T (T, 4, 4): translations in the last row, and none in the last column."""
    return (np.abs(T[:, 3, :3]) > 1e-6).any(1) & (np.abs(T[:, :3, 3]) < 1e-6).all(1)


def _size(found: dict[str, np.ndarray]) -> tuple[int, int] | None:
    """(W, H), each above zero; None where they are something else."""
    try:
        width, height = (int(found[name].item()) for name in ("width", "height"))
    except (KeyError, ValueError, OverflowError, TypeError):
        return None
    return (width, height) if min(width, height) > 0 else None


def _finite(matrices: np.ndarray) -> np.ndarray | None:
    """The matrices with the first finite one in the place of those that are not."""
    good = np.isfinite(matrices).all((1, 2))
    return np.where(good[:, None, None], matrices, matrices[good][0]) if good.any() else None


def _frames(which: np.ndarray) -> tuple[int, ...]:
    """Numbers of the frames that are meant; none where one matrix stands for all."""
    return tuple(map(int, np.flatnonzero(which))) if len(which) > 1 else ()


def _row(row: np.ndarray) -> str:
    return " ".join(f"{x:.4g}" for x in row)
