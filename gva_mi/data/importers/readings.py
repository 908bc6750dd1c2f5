"""What every reader of an estimator's file makes of it: a lens, and a track of checked arrays.

Estimators name three kinds of camera, and all become K and a translation t in the camera's axes:

====================  ===================================================================
Camera                K and t
====================  ===================================================================
of the whole picture  as they are; :func:`rescaled` where the picture was of another size
weak perspective      :func:`of_weak_perspective`: u = W/2 (1 + s (X + t))
of the pelvis         :func:`of_pelvis`: t from where the pelvis is, and not the root at rest
====================  ===================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import roma
import torch

from gva_mi.data.importers.fields import find_betas, find_joints, find_translation
from gva_mi.data.importers.tracks import Track
from gva_mi.errors import InputError

# The pelvis of the neutral mean person at rest, metres: what the public models regress.
PELVIS = {
    "SMPL": (-0.0018, -0.2233, 0.0282), "SMPL+H": (-0.0018, -0.2233, 0.0282),
    "SMPL-X": (0.0031, -0.3514, 0.0120),
}  # fmt: skip
_SAME_SHAPE = 0.01  # how much two pictures' sides may differ in proportion
_REACH = 1.0  # metres that somebody moves from frame to frame at most


@dataclass(frozen=True)
class View:
    """What a reader needs to know beside the file."""

    size: tuple[int, int]  # (W, H) of the video, pixels
    focal: float | None = None  # pixels, where the file says none
    components: np.ndarray | None = None  # (2, K, 45) of the body file's PCA of hands


def centred(focal: float, size: tuple[int, int], frames: int) -> np.ndarray:
    """K (frames, 3, 3) of a lens whose axis meets the middle of the picture."""
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return np.tile(K, (frames, 1, 1))


def rescaled(where: str, K: np.ndarray, of: Sequence[float], size: tuple[int, int]) -> np.ndarray:
    """K (..., 3, 3) of pictures of the size ``of`` (W, H), for those of the video.

    Raises:
        InputError: the pictures are of another shape.
    """
    factors = np.array(size, np.float64) / np.maximum(of, 1e-9)
    if not abs(factors[0] / factors[1] - 1) <= _SAME_SHAPE or min(of) < 1:
        raise InputError(
            f"{where}: its camera is of pictures of {of[0]:g}x{of[1]:g}, but the video has "
            f"{size[0]}x{size[1]}; expected the same shape"
        )
    return K * np.array([*factors, 1])[:, None]


def of_weak_perspective(cameras: np.ndarray, focal: float, size: tuple[int, int]) -> np.ndarray:
    """Translations (n, 3) before a lens of ``focal`` pixels, of scales and shifts (n, 4).

    The cameras (sx, sy, tx, ty) show X at u = W/2 (1 + sx (X + tx)), in the whole picture; a lens
    that is far enough away, z = 2 f / (sx W), shows the same.
    """
    sx, _, tx, ty = np.asarray(cameras, np.float64).T
    return np.stack([tx, ty, 2 * focal / (sx * size[0])], axis=1)


def of_pelvis(place: np.ndarray, form: str) -> np.ndarray:
    """The translation (n, 3) of a body whose pelvis is at ``place`` (n, 3)."""
    return np.asarray(place, np.float64).reshape(-1, 3) - np.array(PELVIS[form])


def seen_from(track: Track, R: np.ndarray, T: np.ndarray) -> Track:
    """A track of the world in the axes of a camera, x_cam = R x + T; a body turns about its pelvis.

    Args:
        track: in the world.
        R: (3, 3), or (n, 3, 3) where the camera moves; made a rotation where digits were lost.
        T: (3,) or (n, 3) metres.
    """
    n, pelvis = len(track.frames), np.array(PELVIS[track.form])
    R = roma.special_procrustes(torch.from_numpy(np.array(R, np.float64))).numpy()
    R = np.broadcast_to(R, (n, 3, 3))
    turn = roma.rotmat_to_rotvec(torch.from_numpy(R.copy()))
    rotations = track.rotations.copy()
    root = torch.from_numpy(rotations[:, 0].copy())
    rotations[:, 0] = roma.rotvec_composition([turn, root]).numpy()
    place = np.einsum("nij,nj->ni", R, track.transl + pelvis) + np.reshape(T, (-1, 3))
    return replace(track, rotations=rotations, transl=place - pelvis)


def through_lens(track: Track, focal: float) -> Track:
    """A track as a lens of ``focal`` pixels sees it, of an estimator that assumed another one.

    The picture is what the estimator has seen, so in it the person keeps place and size: the pelvis
    moves along the camera's axis, as many times as far away as the lens is longer. And they turn to
    the eye the side that they did before: by as much as the ray on which the pelvis is seen turns
    (as CLIFF, Li et al. 2022, tells the turn of a crop from that of the person).

    Args:
        track: of one person.
        focal: pixels.
    """
    pelvis, K = np.array(PELVIS[track.form]), track.K.copy()
    before = track.transl + pelvis
    scale = np.sqrt(K[:, 0, 0] * K[:, 1, 1])
    longer = focal / scale
    aside = longer[:, None] * before[:, :2] * K[:, [0, 1], [0, 1]] / focal
    after = np.concatenate([aside, longer[:, None] * before[:, 2:]], axis=1)
    K[:, 0, 0] = K[:, 1, 1] = focal
    turn = torch.from_numpy(_between(before, after))
    rotations = track.rotations.copy()
    root = torch.from_numpy(rotations[:, 0].copy())
    rotations[:, 0] = roma.rotvec_composition([turn, root]).numpy()
    return replace(track, rotations=rotations, transl=after - pelvis, K=K)


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The shortest turns (n, 3) from directions (n, 3) to others, axis-angle."""
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, (a * b).sum(1, keepdims=True))
    return axis * (angle / np.maximum(sine, 1e-300))


def make_track(
    where: str,
    person: str,
    frames: np.ndarray,
    found: Mapping[str, Any],
    K: np.ndarray,
    components: np.ndarray | None = None,
) -> Track:
    """A track of arrays that hold all frames, checked to be as many.

    Args:
        where: file and person, for the error.
        person: the estimator's name of them.
        frames: (n,) their numbers.
        found: arrays by name, as :mod:`fields` knows them.
        K: (n, 3, 3) pixels.
        components: of the PCA of hands, where the body file has one.

    Raises:
        InputError: arrays of another form, or of another number of frames.
    """
    joints = find_joints(where, found, components)
    count = len(frames)
    if len(joints.rotations) != count or K.shape != (count, 3, 3):
        raise InputError(
            f"{where}: {len(joints.rotations)} poses and K {K.shape} for {count} frames"
        )
    betas = find_betas(where, found)
    betas = None if betas is None else np.broadcast_to(betas, (count, betas.shape[-1]))
    transl = find_translation(where, found, count)
    return Track(
        person, frames, joints.rotations, transl, betas, K, joints.form, joints.has_hands,
        joints.from_mean_hand,
    )  # fmt: skip


def follow(places: Sequence[np.ndarray]) -> list[list[str]]:
    """Names for people whom an estimator saw in each frame anew: who is nearest goes on.

    Args:
        places: of each frame, (n, 3) where its people are, metres.

    Returns:
        Of each frame, the names of its people, "0" for the first who is seen.
    """
    last: list[np.ndarray] = []  # where each person was seen last
    names = []
    for found in places:
        found = np.asarray(found, np.float64).reshape(-1, 3)
        chosen: dict[int, int] = {}
        pairs = [(np.linalg.norm(x - y), i, j) for i, x in enumerate(found)
                 for j, y in enumerate(last)]  # fmt: skip
        for distance, i, j in sorted(pairs):
            if distance < _REACH and i not in chosen and j not in chosen.values():
                chosen[i] = j
        for i, place in enumerate(found):
            if i not in chosen:
                chosen[i] = len(last)
                last.append(place)
            last[chosen[i]] = place
        names.append([str(chosen[i]) for i in range(len(found))])
    return names
