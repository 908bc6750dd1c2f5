"""Pictures of the report do not ask which way is up in the world."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch

from gva_mi.fit.evaluation.report_pictures import face, turntable

WORLDS = {"z up": (np.pi / 2, 0, 0), "y down": (np.pi, 0, 0), "askew": (0.4, -1.1, 0.7)}


def in_world(frame, avatar, R):
    """The same frame in a world that is turned by R (3, 3)."""
    root = avatar.rig.joints[0]
    rotations = frame.pose.rotations.clone()
    rotations[0, 0] = roma.rotmat_to_rotvec(R @ roma.rotvec_to_rotmat(rotations[0, 0]))
    transl = (R @ (root + frame.pose.transl[0]) - root)[None]
    T = frame.camera.T_camera_world.copy()
    T[:3, :3] = T[:3, :3] @ R.double().numpy().T
    pose = replace(frame.pose, rotations=rotations, transl=transl)
    return replace(frame, pose=pose, camera=frame.camera.with_matrices(T, frame.camera.K))


@pytest.mark.parametrize("world", WORLDS)
def test_the_avatar_turns_about_its_own_upright(world, known, video):
    frame = video[0]
    R = roma.rotvec_to_rotmat(torch.tensor(WORLDS[world], dtype=torch.float32))
    ours, theirs = turntable(known, frame, 4), turntable(known, in_world(frame, known, R), 4)
    for a, b in zip(ours, theirs, strict=True):
        off = np.abs(a.astype(int) - b)
        assert off.mean() < 0.2 and np.percentile(off, 99) <= 3


def test_the_circle_begins_at_the_camera(known, video):
    first, _, behind, _ = turntable(known, video[0], 4)
    ink = lambda image: (image < 250).any(2)
    shown = ink(video[0].on_background().__mul__(255))
    assert (ink(first) & shown).sum() > 0.8 * shown.sum()
    assert np.abs(first.astype(int) - behind).mean() > 1


def test_a_face_is_shown_where_it_looks_into_the_camera(known, video):
    """The subject turns: it faces the camera in its first frame, and not in its fourth."""
    shown, hidden = face(known, video[0]), face(known, video[3])
    assert hidden is None
    height, width = shown.shape[:2]
    assert height == 2 * width >= 200 and (shown < 200).any()
