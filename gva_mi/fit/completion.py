"""Complete the colours that a fit hardly saw, from the rest of the person.

A fit changes colours that no frame shows at random. And where parts of the body touch in the
picture, a pose that is off by a centimetre gives the colours of one part to the other. So once a
fit is over, such colours are replaced. A frame k teaches a Gaussian i as much as it shows of it, in
pixels p of the mask, less at a grazing angle, and nothing at a contact:

    1. w_i = mean over k of  q_ki max(0, (s - n_i · d_ki) / (s + 1))² Σ_p T_kip α_kip

with the normal n of the body beside it, the direction d from the camera to it, its share T α of a
pixel (Eq. 1-3). A contact is where a picture shows two places of the body side by side that lie
apart at rest, as an arm before the trunk, or a hand on the hip. With r_ki the distance from
Gaussian i to the nearest contact of frame k, metres,

    2. q_ki = exp(-(r₀ / r_ki)²)

Colours c, and their changes with the light, replace those of the fit, f, by the solution of

    3. w_i (c_i - f_i) + λ b_i (c_i - h_i) = λ Σ_j a_ij (c_j - c_i)

A Gaussian that frames show keeps its colour. Others take the colours of Gaussians j that face the
same way

* around i,
* at the mirrored place: the left and the right of a person look alike,
* before or behind i, on arms and legs: trousers end at one height,

and, where b_i is not zero, a guessed colour h_i,

* on the back of a head: the colour of its highest part that frames show, hair or a hat,
* on chest and back: the median of what frames show at that height. A shirt is red all around, but
  its print is on one side,
* on arms and hands: the median of what frames show of both at that distance from the middle.

So the far arm of a person who only walks past takes the colours of the near arm, the back of a
person who never turns takes the colours of the front, and the inner side of an arm that hangs on a
dress takes the colour of the outer side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.avatar.avatar import AVATAR_SPLATTING, Avatar
from gva_mi.avatar.held import arm_weights, head_weights
from gva_mi.body.pose import JOINTS, Pose
from gva_mi.fit.samples import FrameSampler, Sample, box_of_gaussians, in_tiles
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat import Camera, Gaussians, render
from gva_mi.splat.kernels.sh import C0

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# r₀, metres. Chosen on three rendered persons: within half of it a contact teaches nothing, and
# poses of phone videos are off by as much.
CONTACT_REACH = 0.05
# Metres at rest between the places of a contact. Chosen: more than across a wrist.
CONTACT_APART = 0.1
# Chosen on rendered persons, by eye.
COMPLETION_FRAMES = 32  # at most, that eq. 1 is the mean of
COMPLETION_SMOOTHNESS = 0.005  # λ of eq. 3, as a share of the mean of w
NEAREST_NEIGHBOURS = 8  # j around i; a guess counts as all of them
OPPOSITE_NEIGHBOURS = 3  # j at the mirrored place, and as many before or behind
HEAD_TOP_SHARE = 0.1  # of what frames show of a head, by w, from the top down: the guess for it
ROW_HEIGHT = 0.01  # metres; a guess for the trunk is made for each row
ROW_REACH = 0.015  # metres above and below a row's middle, of the Gaussians that its guess is from
OPPOSITE_RANGE = 0.03  # metres from the opposite place at which a weight has fallen to 1 / e
# What turns left into right, and front into back.
LEFT_RIGHT, FRONT_BACK = np.array([-1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0])
SMALLEST_COSINE = 1e-3  # of neighbours that face another way, so that each Gaussian has some
RIM_COSINE = 0.4  # s: hair and loose clothes are seen beyond the rim of the body
UNSEEN_WEIGHT = 1e-7  # pixels: far less than any frame shows of a Gaussian
HEAD = JOINTS.index("head")
_TRUNK = [
    JOINTS.index(k) for k in ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar")
]


@torch.no_grad()
def complete_colors(avatar: Avatar, samples: FrameSampler, poses: Pose) -> None:
    """Replace the colours of an avatar by the solution of eq. 3.

    Args:
        avatar: whose ``canonical.sh`` (N, K, 3) changes.
        samples: of the training frames.
        poses: of all frames of the video.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    G, normals = avatar.canonical, normals_beneath(avatar)
    w = shown_pixels(avatar, normals, samples, poses).double().numpy() + UNSEEN_WEIGHT
    f = G.sh.flatten(1).double().numpy()
    places = Places.of(avatar, normals)
    h, b = guesses(places, w, f)
    a, b = (COMPLETION_SMOOTHNESS * w.mean() * x for x in (neighbours(places), b))
    system = diags_array(w + b + a.sum(1)) - a
    found = splu(system.tocsc()).solve(w[:, None] * f + b[:, None] * h)
    G.sh.copy_(torch.from_numpy(found).view(G.sh.shape))


def normals_beneath(avatar: Avatar) -> Tensor:
    """Return the unit normals (N, 3) of the body at rest beside the Gaussians."""
    on_body = vertex_normals(avatar.rig.vertices, avatar.rig.faces)
    return normalize(avatar.skin.beneath_points(avatar.canonical.means, on_body), dim=1)


@torch.no_grad()
def shown_pixels(avatar: Avatar, normals: Tensor, samples: FrameSampler, poses: Pose) -> Tensor:
    """Return w (N,) of eq. 1, pixels, as the mean over some frames.

    ``normals`` (N, 3) are those of :func:`normals_beneath`, ``poses`` those of all frames.
    """
    seen = [samples[k] for k in range(min(COMPLETION_FRAMES, len(samples)))]
    return torch.stack([_shown(avatar, normals, s, poses[s.frame]) for s in seen]).mean(0)


def _shown(avatar: Avatar, normals: Tensor, sample: Sample, pose: Pose) -> Tensor:
    """Return what one frame shows of each Gaussian (N,), pixels: a term of eq. 1."""
    G = avatar.canonical
    with torch.enable_grad():  # d picture / d (colour of a Gaussian) = Σ T α
        sh = torch.zeros_like(G.sh, requires_grad=True)
        gaussians = avatar.animate(pose, sh).gaussians
        target = sample.target(gaussians)
        image = render(gaussians, target.camera, AVATAR_SPLATTING)
        wanted = target.composite()
        total = (image.color * (wanted.mask * wanted.shown)[..., None]).sum()
        (by_sh,) = torch.autograd.grad(total, sh)
    T_world_rest = avatar.posed_skeleton(pose).T_world_rest[0]
    A = G.weights @ T_world_rest[:, :3, :3].flatten(1).to(G.weights)  # blended, as in Eq. 5
    turned = (A.view(-1, 3, 3) * normals[:, None]).sum(2)
    angle = facing(turned, gaussians.means, sample.camera)
    return by_sh[:, 0].mean(1) / C0 * angle * contact_free(gaussians, G.means, target.camera)


def facing(normals: Tensor, places: Tensor, camera: Camera) -> Tensor:
    """Return how squarely a camera sees normals (N, 3) at places (N, 3), metres.

    This is max(0, (s - n · d) / (s + 1))² of eq. 1, (N,).
    """
    T = torch.tensor(camera.T_camera_world, dtype=places.dtype)
    ahead = places + T[:3, :3].T @ T[:3, 3]
    away = (normalize(normals, dim=1) * normalize(ahead, dim=1)).sum(1)
    return ((RIM_COSINE - away) / (RIM_COSINE + 1)).clamp_min(0).square()


@dataclass(frozen=True)
class Places:
    """Places of N Gaussians on the body at rest, x to its left, y up and z ahead.

    Attributes:
        points: (N, 3) from the pelvis, metres.
        normals: (N, 3) unit normals of the body beside them.
        skull: (N,) bool, of the head above its joint, which is between the ears.
        trunk: (N,) bool, from the hips to the collars.
        limbs: (N,) bool, arms and legs.
        arms: (N,) bool, with hands.
    """

    points: np.ndarray
    normals: np.ndarray
    skull: np.ndarray
    trunk: np.ndarray
    limbs: np.ndarray
    arms: np.ndarray

    @staticmethod
    @torch.no_grad()
    def of(avatar: Avatar, normals: Tensor) -> Places:
        """Find the places of an avatar's Gaussians; ``normals`` (N, 3) as above."""
        G, joints = avatar.canonical, avatar.rig.joints
        points = (G.means - joints[0]).double().numpy()
        head = (head_weights(G.weights) > 0.5).numpy()
        skull = head & (points[:, 1] > float((joints[HEAD] - joints[0])[1]))
        trunk = ~head & (G.weights[:, _TRUNK].sum(1) > 0.5).numpy()
        arms = (arm_weights(G.weights) > 0.5).numpy()
        return Places(points, normals.double().numpy(), skull, trunk, ~head & ~trunk, arms)


def guesses(places: Places, w: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Guess colours h (N, K), with weights b (N,) of eq. 3, from w (N,) and f (N, K).

    A guess counts less if frames hardly show the Gaussians that it is taken from.
    """
    h, b, faint = f.copy(), np.zeros(len(w)), COMPLETION_SMOOTHNESS * w.mean()
    height, ahead = places.points[:, 1], places.normals[:, 2]

    def guess(of: np.ndarray, color: np.ndarray, source: np.ndarray, facing: np.ndarray) -> None:
        shown = w[source].mean()
        h[of], b[of] = color, NEAREST_NEIGHBOURS * facing[of] * shown / (shown + faint)

    if places.skull.any():
        skull = np.flatnonzero(places.skull)
        from_top = skull[np.argsort(-height[skull], kind="stable")]
        shown = np.cumsum(w[from_top])
        top = from_top[: 1 + np.searchsorted(shown, HEAD_TOP_SHARE * shown[-1])]
        guess(skull, np.average(f[top], axis=0, weights=w[top]), top, (-ahead).clip(0))
    along = np.abs(places.points[:, 0])  # arms are level at rest
    rows = ((places.trunk, height, np.abs(ahead)), (places.arms, along, np.ones(len(w))))
    for part, place, facing in rows:
        row = np.floor(place / ROW_HEIGHT)
        for one in np.unique(row[part]):
            beside = part & (np.abs(place - (one + 0.5) * ROW_HEIGHT) < ROW_REACH)
            median = weighted_median(f[beside], w[beside])
            guess(part & (row == one), median, beside, facing)
    return h, b


def weighted_median(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the median of each column of values (n, K), whose rows count as weights (n,)."""
    order = np.argsort(values, axis=0, kind="stable")
    below = np.cumsum(weights[order], axis=0)
    middle = (below < below[-1] / 2).sum(0)
    return values[order[middle, range(len(middle))], range(len(middle))]


def neighbours(places: Places) -> csr_array:
    """Return the weights a (N, N) of eq. 3 between Gaussians, a symmetric matrix."""
    points, normals = places.points, places.normals
    front_and_back = _front_and_back(points, normals, places.limbs)
    return _around(points, normals) + _mirrored(points, normals) + front_and_back


def _around(points: np.ndarray, normals: np.ndarray) -> csr_array:
    """Return the weights of the nearest points."""
    from scipy.spatial import cKDTree

    nearest = cKDTree(points).query(points, k=min(NEAREST_NEIGHBOURS + 1, len(points)))[1][:, 1:]
    return _symmetric(nearest, _alike(normals, normals[nearest]))


def _mirrored(points: np.ndarray, normals: np.ndarray) -> csr_array:
    """Return the weights of points at the mirrored place."""
    from scipy.spatial import cKDTree

    distance, there = cKDTree(points).query(
        points * LEFT_RIGHT, k=min(OPPOSITE_NEIGHBOURS, len(points))
    )
    return _symmetric(there, _near(distance) * _alike(normals * LEFT_RIGHT, normals[there]))


def _front_and_back(points: np.ndarray, normals: np.ndarray, some: np.ndarray) -> csr_array:
    """Return the weights, among some (N,) bool, of points at the same x and y that face away."""
    from scipy.spatial import cKDTree

    there = np.zeros((len(points), OPPOSITE_NEIGHBOURS), np.int64)
    weights = np.zeros(there.shape)
    front, back = (np.flatnonzero(some & (z > 0)) for z in (normals[:, 2], -normals[:, 2]))
    if min(len(front), len(back)) >= OPPOSITE_NEIGHBOURS:
        for these, those in ((front, back), (back, front)):
            distance, j = cKDTree(points[those, :2]).query(points[these, :2], k=OPPOSITE_NEIGHBOURS)
            there[these] = those[j]
            turned = normals[these] * FRONT_BACK
            weights[these] = _near(distance) * _alike(turned, normals[those[j]])
    return _symmetric(there, weights)


def _near(distance: np.ndarray) -> np.ndarray:
    """Return how much points count by their distance from the opposite place, metres."""
    return np.exp(-((distance / OPPOSITE_RANGE) ** 2))


def _alike(normals: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return cosines (N, K) between normals (N, 3) and others (N, K, 3), clamped from below."""
    return np.maximum(np.einsum("ik,ijk->ij", normals, others), SMALLEST_COSINE)


def _symmetric(columns: np.ndarray, values: np.ndarray) -> csr_array:
    """Return (A + Aᵀ) / 2 of a sparse matrix A (N, N) with values (N, K) in given columns."""
    from scipy.sparse import csr_array

    N, K = columns.shape
    a = csr_array((values.ravel(), columns.ravel(), np.arange(0, N * K + 1, K)), shape=(N, N))
    return (a + a.T) / 2


@torch.no_grad()
def contact_free(gaussians: Gaussians, places: Tensor, camera: Camera) -> Tensor:
    """Return q of N posed Gaussians in a picture, (N,); ``places`` (N, 3) are theirs at rest."""
    return torch.exp(-((CONTACT_REACH / clearance(gaussians, places, camera)) ** 2))


def clearance(gaussians: Gaussians, places: Tensor, camera: Camera) -> Tensor:
    """Return how far Gaussians are from the nearest contact in a picture, (N,) metres: r.

    Args:
        gaussians: N posed Gaussians.
        places: (N, 3) where they are at rest, metres.
        camera: of the picture.
    """
    from scipy.ndimage import distance_transform_edt

    part = box_of_gaussians(gaussians, camera)
    if part is None:
        return torch.full((len(places),), torch.inf)
    camera = in_tiles(part, camera).cut_camera(camera)
    image = render(replace(gaussians, sh=None, colors=places), camera, AVATAR_SPLATTING)
    alpha = image.alpha.numpy()
    rest = image.color.numpy() / np.maximum(alpha, 0.5)[..., None]
    contact = np.zeros(alpha.shape, bool)
    for one, middle, other in (
        (np.s_[:-2], np.s_[1:-1], np.s_[2:]),
        (np.s_[:, :-2], np.s_[:, 1:-1], np.s_[:, 2:]),
    ):  # the neighbours on both sides of a pixel, which may itself mix two places
        solid = np.minimum(alpha[one], alpha[other]) > 0.5
        apart = np.linalg.norm(rest[one][solid] - rest[other][solid], axis=1)
        contact[middle][solid] |= apart > CONTACT_APART
    if not contact.any():
        return torch.full((len(places),), torch.inf)
    pixels = distance_transform_edt(~contact)
    T = torch.tensor(camera.T_camera_world, dtype=places.dtype)
    x, y, z = (gaussians.means @ T[:3, :3].T + T[:3, 3]).T
    z = z.clamp_min(1e-3)
    column = (camera.fx * x / z + camera.cx).long().clamp(0, camera.width - 1)
    row = (camera.fy * y / z + camera.cy).long().clamp(0, camera.height - 1)
    return torch.from_numpy(pixels)[row, column].to(z) * z / camera.fx
