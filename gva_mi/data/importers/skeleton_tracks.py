"""Tracks of a person whose source is a skeleton of its own, and no body model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gva_mi.body.pose import LARGEST
from gva_mi.data.importers.bvh import read_bvh
from gva_mi.data.importers.joint_fit import poses_from_joints
from gva_mi.data.importers.retarget import Retargeted, retarget
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.importers.tracks import Track


def bvh_track(path: Path, body: TargetBody) -> tuple[Track, float, list[str]]:
    """Return the track of a BVH's person on ``body``, its frames a second, and notes."""
    clip, notes = read_bvh(path), []
    if clip.announced != str(len(clip)):
        notes.append(f"says that it has {clip.announced} frames, and has {len(clip)}")
    # Programs put the pose by which they calibrate before the motion.
    if len(clip) > 2 and not clip.turns_in(0) and clip.turns_in(1):
        clip = clip.since(1)
        notes.append("the pose of zero angles before the motion is left out")
    motion = retarget(path, clip, body.joints)
    track = _track("BVH", motion, np.arange(len(clip)), body)
    return track, 1 / clip.frame_time, [*notes, *motion.notes]


def joints_track(places: np.ndarray, fps: float, body: TargetBody) -> tuple[Track, list[str]]:
    """Return the track on ``body`` of joints (T, 22, 3), and notes; lost frames are NaN."""
    known = np.flatnonzero((np.abs(places) < LARGEST["transl"]).all((1, 2)))
    motion = poses_from_joints(places[known], body.joints, fps)
    return _track("joints without rotations", motion, known, body), motion.notes


def _track(form: str, motion: Retargeted, frames: np.ndarray, body: TargetBody) -> Track:
    K = np.tile(np.eye(3), (len(frames), 1, 1))
    return Track("0", frames, motion.rotations, motion.pelvis, None, K, form, motion.has_hands)
