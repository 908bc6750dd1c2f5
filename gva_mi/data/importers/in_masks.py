"""Whose joints lie in the masks: which of an estimator's people a video's masks cut out.

A joint j of a track is seen at ``K (t + p + places of the joint from the pelvis)``, with t the
track's translation and p the pelvis at rest of the estimator's body (:mod:`.prepare`). Where it is
from the pelvis is taken from any body in the track's rotations: a person's height in pixels is
right to some percent, and the widths of limbs allow for that.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import BODY, PARENTS
from gva_mi.data.importers.mask_values import BARELY
from gva_mi.data.importers.tracks import Track, Votes


def joints_in_masks(
    tracks: Sequence[Track],
    cut_outs: Iterable[np.ndarray],
    first: int,
    joints: np.ndarray,
    pelvis: Sequence[np.ndarray],
) -> list[Votes]:
    """The votes of each track's joints, of the body without hands and face.

    Frames with an empty mask have no vote, and neither has a joint beyond the picture's border,
    where no mask can be.

    Args:
        tracks: of n people.
        cut_outs: masks (H, W) 8-bit, frame by frame.
        first: the number that the estimator gave the first frame.
        joints: (55, 3) of a body at rest, metres.
        pelvis: of each person, (3,): where the estimator's body has it at rest, metres.
    """
    seen = [joint_pixels(t, joints, p) for t, p in zip(tracks, pelvis, strict=True)]
    rows = [{int(f) - first: i for i, f in enumerate(t.frames)} for t in tracks]
    votes = np.zeros((len(tracks), 2), int)
    for k, mask in enumerate(cut_outs):
        inside = mask > BARELY
        if not inside.any():
            continue
        for person, row in enumerate(rows):
            if k in row:
                votes[person] += _votes(seen[person][row[k]], inside)
    return [Votes(int(inside), int(outside)) for inside, outside in votes]


def _votes(pixels: np.ndarray, inside: np.ndarray) -> tuple[int, int]:
    """How many of (J, 2) pixels are inside a mask (H, W), and how many outside."""
    height, width = inside.shape
    # What is no number, or behind the camera, is beyond any border.
    u, v = np.floor(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0).clip(-1, 1e6)).T
    there = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    hits = int(inside[v[there].astype(int), u[there].astype(int)].sum())
    return hits, int(there.sum()) - hits


def joint_pixels(
    track: Track, joints: np.ndarray, pelvis: np.ndarray, count: int = BODY.stop
) -> np.ndarray:
    """Where the first joints are seen, (n, count, 2); not finite for those behind the camera.

    Args:
        track: of n frames.
        joints: (55, 3) of a body at rest, metres.
        pelvis: (3,) where the estimator's body has it at rest, metres.
        count: of joints; root and body by default.
    """
    rotations = torch.from_numpy(np.ascontiguousarray(track.rotations, np.float64))
    rest = torch.from_numpy(np.asarray(joints, np.float64))
    T = joint_transforms(rotations, rest, PARENTS, torch.zeros(len(rotations), 3).double()).numpy()
    some = slice(0, count)
    places = np.einsum("tjab,jb->tja", T[:, some, :3, :3], joints[some]) + T[:, some, :3, 3]
    x = places - places[:, :1] + (pelvis + track.transl)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        projected = np.einsum("tab,tjb->tja", track.K, x)
        seen = projected[..., :2] / projected[..., 2:]
    return np.where(x[..., 2:] > 0, seen, np.inf)
