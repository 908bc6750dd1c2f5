"""``Landmarks``: named points of a person, found in every frame by a network.

The body has 33 points (:data:`BODY_LANDMARKS`) and each hand 21 (:func:`hand_names`), named as in
MediaPipe's networks. The face has 51 (:data:`FACE_LANDMARKS`): numbers 17 to 67 of iBUG's 68
points, which SMPL-X's face landmarks and COCO-WholeBody share. A program that finds other points
writes other names; readers ignore names that they do not know.

``landmarks.npz`` in a subject's folder holds the fields of :class:`Landmarks` as arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gva_mi.core.files import read_arrays, require_array, require_keys, write_arrays

BODY_LANDMARKS = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye",
    "right_eye_outer", "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_pinky",
    "right_pinky", "left_index", "right_index", "left_thumb", "right_thumb", "left_hip",
    "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel", "right_heel",
    "left_foot_index", "right_foot_index",
)  # fmt: skip
# Brows (17-26), nose (27-35), eyes (36-47), lips (48-67); each begins on the person's right.
FACE_LANDMARKS = tuple(f"face_{number}" for number in range(17, 68))


def hand_names(side: str) -> tuple[str, ...]:
    """Return the 21 names of a hand, ``side`` left or right: the wrist, then 4 of each finger."""
    parts = {"thumb": ("cmc", "mcp", "ip", "tip")}
    fingers = ("thumb", "index", "middle", "ring", "pinky")
    of_finger = {name: parts.get(name, ("mcp", "pip", "dip", "tip")) for name in fingers}
    points = [f"{name}_{part}" for name in fingers for part in of_finger[name]]
    return tuple(f"{side}_hand_{point}" for point in ("wrist", *points))


@dataclass(frozen=True)
class Landmarks:
    """P named points in T frames; NaN for points that were not found."""

    names: Sequence[str]  # P
    pixels: np.ndarray  # (T, P, 2) x, y; the centre of the first pixel is (0.5, 0.5)
    confidence: np.ndarray  # (T, P) in [0, 1], by the network; for hand and face, of the whole part
    spread: np.ndarray  # (T, P) pixels: standard deviation between passes of the network, or 0
    # (T, P, 3) metres in the camera's axes, x right, y down, z away from the camera; relative to
    # the middle of the hips, or for a hand to its own middle. NaN if the network gives none.
    metric: np.ndarray
    # Names of points that lie at the joint itself, and not where BlazePose marks it.
    at_joints: Sequence[str] = ()

    def __len__(self) -> int:
        return len(self.pixels)

    def indices(self, names: Sequence[str]) -> list[int]:
        """Return the positions of the given names in :attr:`names`."""
        return [list(self.names).index(name) for name in names]

    def downscaled(self, factor: int) -> Landmarks:
        """Return the landmarks of pictures that are ``factor`` times smaller."""
        return replace(self, pixels=self.pixels / factor, spread=self.spread / factor)

    def without(self, frames: Sequence[int]) -> Landmarks:
        """Return the landmarks as if nobody had been found in ``frames``."""
        unknown = {"pixels": np.nan, "metric": np.nan, "confidence": 0, "spread": 0}
        found = {name: getattr(self, name).copy() for name in unknown}
        for name, value in unknown.items():
            found[name][list(frames)] = value
        return replace(self, **found)

    def save(self, path: Path) -> None:
        """Write ``landmarks.npz``; it appears when it is complete."""
        numbers = {name: getattr(self, name).astype(np.float32) for name in _SHAPES}
        names = {"names": np.array(self.names), "at_joints": np.array(self.at_joints, str)}
        write_arrays(path, **names, **numbers)

    @staticmethod
    def load(path: Path) -> Landmarks:
        """Read ``landmarks.npz``."""
        arrays = read_arrays(path, "landmarks of a video")
        require_keys(path, arrays, ("names", *_SHAPES))
        names, at_joints = (
            tuple(map(str, np.atleast_1d(arrays.get(name, ())))) for name in ("names", "at_joints")
        )
        found, count = [], None
        for name, more in _SHAPES.items():
            found.append(require_array(path, name, arrays[name], (count, len(names), *more)))
            count = len(found[0])
        return Landmarks(names, *found, at_joints)


# What follows (T, P) in the shape of each array.
_SHAPES = {"pixels": (2,), "confidence": (), "spread": (), "metric": (3,)}
