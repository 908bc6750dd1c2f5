"""Keep Gaussians near the rest body and its clothes, closest at fingers and in armpits.

Fingers are bare skin. A video constrains them badly: a finger is a few pixels wide, often hidden,
and its pose is off by more than its width. Gaussians that follow such pictures leave the finger,
take the colours of what is behind it, and tear off once the hand opens.

In an armpit, skinning weights change from the trunk's to the arm's within a few centimetres. While
the arms hang, Gaussians that stand off the body there are hidden between arm and trunk. Once the
arms rise, these Gaussians hang from both as a flap.

A surface that a video shows from one side only may lie anywhere along the line of sight: shins of a
person who never turned became too thick. Silhouettes have shown how far clothes stand off the body;
they show less of hair, because it is softer than a mask.

Hair may stand off a head, but not off a face: Gaussians before the face would show another face
from each side.

A hand before a skirt looks like cloth that stands off it. Gaussians of a wide skirt, which may
stand off it far, would take the hand's shape. So they may do so only as far as pictures tell the
clothes there, ``told`` in [0, 1] (:mod:`gva_mi.fit.first_surface`).

So a Gaussian that has left the body is moved back toward its nearest vertex v, to the distance

    1. reach(v) = FINGER_REACH                            for fingers
                = max(ARMPIT_REACH, looseness(v))         in armpits, where clothes may be loose
                = looseness(v) + HAIR_REACH               for the head, if clothes are known
                = looseness(v) + BODY_REACH               for a face, if told is given
                = BARE_REACH                              for bare arms, if told is given
                = looseness(v) + BODY_REACH               for arms, if clothes are known
                = told(v) looseness(v) + BODY_REACH       for the rest, if clothes are known

A Gaussian may also be long along the line of sight. From the side it is a spike. A disc that stands
on the surface like a fin sticks out where the body is seen in profile, takes the colour of the wall
there, and shows it from all sides. So the standard deviation d along the normal n of v is at most
MAX_THICKNESS. Each axis a_i, of standard deviation s_i, shrinks by its share of d²:

    2. log s_i <- log s_i - (d_i / d)² log(d / MAX_THICKNESS)
       d_i = s_i a_i·n,    d² = Σ_i d_i²

This is not in the paper.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.canonical import CanonicalGaussians, rotated
from gva_mi.avatar.rig import Rig
from gva_mi.body.face import face_shares
from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.body.skinning import finger_weights
from gva_mi.body.smplx import Rest
from gva_mi.mesh.surface import vertex_normals

# Metres, of eq. 1 and 2.
FINGER_REACH = 0.004  # chosen: half the thickness of a finger
ARMPIT_REACH = 0.015  # chosen: flaps bulged by 5 cm
BARE_REACH = 0.006  # chosen on a rendered person in a dress: farther off, arms grow shards
HAIR_REACH, BODY_REACH = 0.03, 0.01  # chosen: masks miss soft hair by centimetres, clothes by less
MAX_THICKNESS = 0.008  # chosen: less than BODY_REACH
# Product of the weights of trunk and arm in an armpit. Chosen: 0.25 where both are equal, and it
# falls to this within a few centimetres.
ARMPIT_WEIGHTS = 0.05
# Cosine between normals of an armpit and the direction between side and down. Chosen: within 60°.
ARMPIT_COSINE = 0.5
_TRUNK = [JOINTS.index(k) for k in ("spine1", "spine2", "spine3", "left_collar", "right_collar")]
_ARMS = [JOINTS.index(k) for k in ("left_shoulder", "right_shoulder")]
_ARMS_AND_HANDS = [
    *_ARMS,
    *(JOINTS.index(f"{side}_{joint}") for side in SIDES for joint in ("elbow", "wrist")),
]
_HEAD = [JOINTS.index(k) for k in ("neck", "head")]


class Held:
    """The parts of an avatar's rest body that Gaussians must not leave.

    Example:
        Gaussians of fingers have drifted 5 cm forward, and come back to 4 mm.

        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> G, rig = avatar.canonical, avatar.rig
        >>> finger = finger_weights(G.weights) > 0.5
        >>> G.means.data[finger, 2] += 0.05
        >>> Held(rig).hold(avatar, body=False)
        >>> bare = rig.vertices[finger_weights(rig.weights) > 0.5]
        >>> off = torch.cdist(G.means[finger], bare).amin(1)
        >>> bool((off < FINGER_REACH + 1e-4).all())
        True
    """

    def __init__(self, rig: Rig, told: Tensor | None = None) -> None:
        """Find the parts of a rest body.

        ``told`` (V,) in [0, 1] is how well pictures tell the clothes of each vertex; arms without
        clothes are bare then. None: clothes are told everywhere, and no arm is bare.
        """
        from scipy.spatial import cKDTree

        normals = vertex_normals(rig.vertices, rig.faces)
        outward = torch.sign(rig.vertices[:, 0]) * normals[:, 0]  # at rest, arms are level
        armpit = shared_weights(rig.weights) > ARMPIT_WEIGHTS
        armpit &= (outward - normals[:, 1]) / 2**0.5 > ARMPIT_COSINE
        loose = rig.looseness.clamp_min(ARMPIT_REACH).where(armpit, torch.inf)
        finger = finger_weights(rig.weights) > 0.5
        bare = torch.full_like(rig.looseness[finger], FINGER_REACH)
        self._parts = [
            _Part(lambda weights: finger_weights(weights) > 0.5, rig.vertices[finger], bare),
            _Part(
                lambda weights: shared_weights(weights) > ARMPIT_WEIGHTS / 2, rig.vertices, loose
            ),
        ]
        known = slice(None if bool(rig.looseness.any()) else 0)
        every = lambda weights: torch.ones(len(weights), dtype=torch.bool)
        head = head_weights(rig.weights) > 0.5
        beyond = torch.where(head, HAIR_REACH, BODY_REACH)
        looseness = rig.looseness
        if told is not None:
            arm = arm_weights(rig.weights) > 0.5
            beyond[(looseness == 0) & arm] = BARE_REACH
            face = face_shares(Rest(rig.vertices, rig.joints), rig.weights)
            beyond = beyond + head * face * (BODY_REACH - HAIR_REACH)
            looseness = torch.where(arm | head, looseness, told * looseness)
        reach = (looseness + beyond).to(rig.looseness)
        self._body = _Part(every, rig.vertices[known], reach[known])
        self._normals, self._tree = normals, cKDTree(rig.vertices.double().numpy())

    def hold(self, avatar: Avatar, body: bool) -> None:
        """Move Gaussians that have left their part of the body back (eq. 1), and flatten (eq. 2).

        Without ``body``, which takes longer, only Gaussians of fingers and armpits are moved.
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
        excess = torch.log(thick / MAX_THICKNESS**2).clamp_min(0) / 2
        G.log_scales -= squares / thick * excess


class _Part:
    """A part of the body: vertices (V, 3) at rest, metres, and the reach (V,) of its Gaussians.

    ``mine`` chooses its Gaussians by skinning weights (N, 55), as (N,) bool.
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
    """Return the product of the weights of trunk and upper arms, (N,), from weights (N, 55).

    Example:
        >>> weights = torch.zeros(1, 55)
        >>> weights[0, [JOINTS.index("spine3"), JOINTS.index("left_shoulder")]] = 0.5
        >>> shared_weights(weights)
        tensor([0.2500])
    """
    return weights[:, _TRUNK].sum(1) * weights[:, _ARMS].sum(1)


def head_weights(weights: Tensor) -> Tensor:
    """Return the share of each row of skinning weights (N, 55) that belongs to head and neck, (N,).

    Example:
        >>> head_weights(torch.eye(55)[[JOINTS.index("head"), JOINTS.index("pelvis")]])
        tensor([1., 0.])
    """
    return weights[:, _HEAD].sum(1)


def arm_weights(weights: Tensor) -> Tensor:
    """Return the share of skinning weights (N, 55) that belongs to arms and hands, (N,).

    Example:
        >>> arm_weights(torch.eye(55)[[JOINTS.index("left_elbow"), JOINTS.index("left_collar")]])
        tensor([1., 0.])
    """
    return weights[:, _ARMS_AND_HANDS].sum(1) + finger_weights(weights)
