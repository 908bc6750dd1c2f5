"""Gaussians stay near the rest body and its clothes: most of all those of fingers and armpits.

Fingers are bare skin. What a video teaches of them is little and wrong: a finger is a few pixels
wide, often hidden, and its pose is off by more than its width. Gaussians that follow such pictures
leave the finger, take the colours of what is behind it, and tear off once the hand opens.

In an armpit, skinning weights change from the trunk's to the arm's within a few centimetres. While
the arms hang, what stands off the body there is hidden between arm and trunk. Once they rise, it
hangs from both as a flap.

What a video shows from one side only may lie anywhere along the line of sight: shins of a person
who never turned grew balloons and rags. Silhouettes have shown how far clothes stand off the body;
of hair they show less, as it is softer than a mask.

So a Gaussian that has left the body comes back toward its nearest vertex v, to the distance

    1. reach(v) = FINGER                            of fingers
                = max(ARMPIT, looseness(v))         in armpits, where clothes may be loose
                = looseness(v) + HAIR               of the head, if clothes are known
                = looseness(v) + BEYOND             of all others, if clothes are known

A Gaussian may also be long along the line of sight. From the side it is a spike. A disc that stands
on the surface like a fin sticks out where the body is seen in profile, takes the colour of the wall
there, and shows it from all sides. So the standard deviation d along the normal n of v is at most
THICK. Each axis a_i, of standard deviation s_i, shrinks by its share of d²:

    2. log s_i <- log s_i - (d_i / d)² log(d / THICK),    d_i = s_i a_i·n,    d² = Σ_i d_i²
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.canonical import CanonicalGaussians, rotated
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import JOINTS
from gva_mi.body.skinning import finger_weights
from gva_mi.mesh.surface import vertex_normals

FINGER, ARMPIT, HAIR, BEYOND, THICK = 0.004, 0.015, 0.03, 0.01, 0.008  # metres
SHARED = 0.05  # product of the weights of trunk and arm in an armpit
INTO_ARMPIT = 0.5  # cosine between normals of an armpit and the direction between side and down
_TRUNK = [JOINTS.index(k) for k in ("spine1", "spine2", "spine3", "left_collar", "right_collar")]
_ARMS = [JOINTS.index(k) for k in ("left_shoulder", "right_shoulder")]
_HEAD = [JOINTS.index(k) for k in ("neck", "head")]


class Held:
    """The parts of an avatar's rest body that Gaussians must not leave.

    ``body`` is all of it, which takes long to look through; nothing where no clothes are known.
    """

    def __init__(self, rig: Rig) -> None:
        from scipy.spatial import cKDTree

        normals = vertex_normals(rig.vertices, rig.faces)
        outward = torch.sign(rig.vertices[:, 0]) * normals[:, 0]  # at rest, arms are level
        armpit = shared_weights(rig.weights) > SHARED
        armpit &= (outward - normals[:, 1]) / 2**0.5 > INTO_ARMPIT
        loose = rig.looseness.clamp_min(ARMPIT).where(armpit, torch.inf)
        finger = finger_weights(rig.weights) > 0.5
        bare = torch.full_like(rig.looseness[finger], FINGER)
        self._parts = [
            _Part(lambda weights: finger_weights(weights) > 0.5, rig.vertices[finger], bare),
            _Part(lambda weights: shared_weights(weights) > SHARED / 2, rig.vertices, loose),
        ]
        known = slice(None if bool(rig.looseness.any()) else 0)
        everyone = lambda weights: torch.ones(len(weights), dtype=torch.bool)
        beyond = torch.where(head_weights(rig.weights) > 0.5, HAIR, BEYOND)
        reach = (rig.looseness + beyond).to(rig.looseness)
        self._body = _Part(everyone, rig.vertices[known], reach[known])
        self._normals, self._tree = normals, cKDTree(rig.vertices.double().numpy())

    def hold(self, avatar: Avatar, body: bool) -> None:
        """Move Gaussians that have left their part of the body back (eq. 1), and flatten (eq. 2).

        Without ``body``, only move those of fingers and armpits.
        """
        for part in (self._body, *self._parts) if body else self._parts:
            part.hold(avatar)
        if body:
            self._flatten(avatar.canonical)

    @torch.no_grad()
    def _flatten(self, G: CanonicalGaussians) -> None:
        nearest = torch.from_numpy(self._tree.query(G.means.double().numpy())[1])
        along = rotated(G.quats * G.quats.new_tensor([1, -1, -1, -1]), self._normals[nearest])
        squares = (along * G.scales).square()
        thick = squares.sum(1, keepdim=True)
        excess = torch.log(thick / THICK**2).clamp_min(0) / 2
        G.log_scales -= squares / thick * excess


class _Part:
    """Vertices (V, 3) at rest, metres, and how far off (V,) the Gaussians of a part may be.

    ``mine`` chooses these by skinning weights (N, 55), as (N,) bool.
    """

    def __init__(self, mine: Callable[[Tensor], Tensor], vertices: Tensor, reach: Tensor) -> None:
        from scipy.spatial import cKDTree

        self._mine, self._vertices, self._reach = mine, vertices, reach
        self._tree = cKDTree(vertices.double().numpy()) if len(vertices) else None

    @torch.no_grad()
    def hold(self, avatar: Avatar) -> None:
        G = avatar.canonical
        mine = self._mine(G.weights).nonzero()[:, 0]
        if self._tree is None or not len(mine):
            return
        means = G.means[mine]
        distance, nearest = (torch.from_numpy(x) for x in self._tree.query(means.double().numpy()))
        distance, reach = distance.to(means), self._reach[nearest]
        far = distance > reach
        beneath = self._vertices[nearest[far]]
        share = (reach / distance)[far, None]
        G.means[mine[far]] = beneath + share * (means[far] - beneath)


def shared_weights(weights: Tensor) -> Tensor:
    """Return the product of the weights of trunk and upper arms, (N,), of rows (N, 55)."""
    return weights[:, _TRUNK].sum(1) * weights[:, _ARMS].sum(1)


def head_weights(weights: Tensor) -> Tensor:
    """Return the share of each row of skinning weights (N, 55) that belongs to head and neck."""
    return weights[:, _HEAD].sum(1)
