"""Colours of a fit that no loss gives: first ones, unseen ones, and how they follow the light.

A fit starts from the colours c of the body's vertices v that the training frames k show:

    1. Σ_k w_vk (I_k(π_k(x_vk)) - c_v) = λ (Δ c)_v,    w_vk = S_k(π_k(x_vk)) max(0, -n_vk · d_vk)²

with x the posed vertex, n its normal, d the direction from the camera to it, π the projection, I
the picture, S the mask, and Δ the uniform Laplacian. Surfaces seen from the front count fully,
grazing ones hardly. If a limb hides a vertex in some frames, the other frames outweigh them, and
the fit corrects the rest. What no frame shows takes the colours around it. From grey, Adam's steps
of constant size would take hundreds of iterations to reach black or white.

Once a fit is over, colours that it hardly saw are completed, because it changes them at random. A
frame teaches a Gaussian as much as the frame shows of it, in pixels, and less at a grazing angle:

    2. w_i = mean over frames of  max(0, (s - n_i · d_i) / (s + 1))² Σ_p T_ip α_ip

with the normal n of the body beside it, the direction d from the camera to it, and its share T α of
pixel p of the mask (Eq. 1-3). Colours c, and their changes with the light, replace those of the
fit, f, by the solution of

    3. w_i (c_i - f_i) + λ b_i (c_i - h_i) = λ Σ_j a_ij (c_j - c_i)

A Gaussian that frames show keeps its colour. Others take the colours of Gaussians j that face the
same way

* around i,
* at the mirrored place: the left and the right of a person look alike,
* before or behind i, on arms and legs: trousers end at one height,

and, where b_i is not zero, a guessed colour h_i,

* on the back of a head: the colour of its highest part that frames show, hair or a hat,
* on chest and back: the median of what frames show at that height. A shirt is red all around, but
  its print is on one side.

So the far arm of a person who only walks past takes the colours of the near arm, and the back of a
person who never turns takes the colours of the front.

The colour of a Gaussian is linear in the direction t of the light at rest
(:mod:`gva_mi.avatar.skin_gaussians`). Pictures teach its slopes only along directions that the
light takes: a person who turns upright never shows a surface in the light from below. So slopes are
learned as differences from the slopes of a matt surface, Lambert's law:

    4. f_k = s n_k a + δ_k          k = x, y, z at rest

with n the normal of the rest surface beside the Gaussian, a its mean colour, and s one number for
the whole person, learned with them: the light's strength, relative to the ambient light. δ starts
at zero. What turning around teaches of s and of the light's direction then holds for raised arms.
Its adjoint, for gradients g_k of f_k (a is a constant):

    5. grad_δ_k = g_k,    grad_s = Σ n_k (Σ_c g_kc a_c)         over Gaussians and k; c: channels

When the fit is over, f takes the place of δ, so an avatar stores no trace of this law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx
from torch.nn.functional import normalize

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.held import head_weights
from gva_mi.body.pose import JOINTS, Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.fit.renders import AVATAR_SPLATTING
from gva_mi.fit.samples import FrameSampler, Sample
from gva_mi.jit.rowwise import Lane, launch
from gva_mi.mesh.surface import as_scipy, uniform_laplacian, vertex_normals
from gva_mi.splat import Camera, render
from gva_mi.splat.kernels.sh import C0
from gva_mi.subject.video import Frame, Video

if TYPE_CHECKING:
    from scipy.sparse import csr_array


UNSEEN_COLOR = 0.5  # in [0, 1], of the whole person if no frame shows it; chosen: grey
VERTEX_SMOOTHNESS = 0.01  # λ of eq. 1, frames; chosen: far less than one frame that sees a vertex
MEAN_COLOR_WEIGHT = 1e-6  # frames; chosen: only decides where nothing else does


@torch.no_grad()
def seen_colors(video: Video, body: BodyModel, offsets: Tensor | None = None) -> Tensor:
    """Return colours of the body's vertices, (V, 3), as the training frames show them.

    ``offsets`` (V, 3) displace the rest surface, metres.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    total = torch.zeros(len(body.v_template), 3, dtype=torch.float64)
    weight = torch.zeros(len(body.v_template), 1, dtype=torch.float64)
    for frame in video.frames(video.splits.train):
        vertices = body(frame.pose, video.shape, offsets).vertices[0]
        color, seen = _frame_colors(frame, vertices, vertex_normals(vertices, body.faces))
        total += seen * color
        weight += seen
    # Every vertex tends a little to the mean of all, also one that is connected to none of these.
    mean = total.sum(0) / weight.sum() if weight.sum() > 0 else torch.full((3,), UNSEEN_COLOR)
    total, weight = total + MEAN_COLOR_WEIGHT * mean, weight[:, 0] + MEAN_COLOR_WEIGHT
    smooth = VERTEX_SMOOTHNESS * as_scipy(uniform_laplacian(body.faces.numpy(), len(weight)))
    colors = splu((diags_array(weight.numpy()) + smooth).tocsc()).solve(total.numpy())
    return torch.from_numpy(colors).to(body.v_template)


def _frame_colors(frame: Frame, vertices: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """Return one frame's colours (V, 3) of the vertices, and their weights (V, 1)."""
    camera, image = frame.camera, torch.from_numpy(frame.image)
    T = torch.tensor(camera.T_camera_world, dtype=vertices.dtype)
    x = vertices @ T[:3, :3].T + T[:3, 3]
    before = x[:, 2] > 1e-3
    z = x[:, 2].clamp_min(1e-3)
    column = (camera.fx * x[:, 0] / z + camera.cx).floor().long()
    row = (camera.fy * x[:, 1] / z + camera.cy).floor().long()
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & before
    column, row = column.clamp(0, camera.width - 1), row.clamp(0, camera.height - 1)
    toward = torch.nn.functional.normalize(x, dim=1)
    facing = -(normals @ T[:3, :3].T * toward).sum(1)
    mask = torch.from_numpy(frame.mask)[row, column]
    return image[row, column], (mask * inside * facing.clamp_min(0).square())[:, None]


# Completion, eq. 2 and 3: chosen on rendered persons, by eye.
COMPLETION_FRAMES = 32  # at most, that eq. 2 is the mean of
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
def complete_colors(avatar: Avatar, samples: FrameSampler, poses: Callable[[int], Pose]) -> None:
    """Replace the colours of an avatar by the solution of eq. 3.

    Args:
        avatar: whose ``canonical.sh`` (N, K, 3) changes.
        samples: of the training frames.
        poses: of each frame, by its number.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    G, rig = avatar.canonical, avatar.rig
    on_body = vertex_normals(rig.vertices, rig.faces)
    normals = normalize(avatar.skin.beneath_points(G.means, on_body), dim=1)
    some = [samples[k] for k in range(min(COMPLETION_FRAMES, len(samples)))]
    shown = torch.stack([_shown(avatar, normals, s, poses(s.frame)) for s in some])
    w = shown.mean(0).double().numpy() + UNSEEN_WEIGHT
    f = G.sh.flatten(1).double().numpy()
    places = Places.of(avatar, normals)
    h, b = guesses(places, w, f)
    a, b = (COMPLETION_SMOOTHNESS * w.mean() * x for x in (neighbours(places), b))
    system = diags_array(w + b + a.sum(1)) - a
    found = splu(system.tocsc()).solve(w[:, None] * f + b[:, None] * h)
    G.sh.copy_(torch.from_numpy(found).view(G.sh.shape))


def _shown(avatar: Avatar, normals: Tensor, sample: Sample, pose: Pose) -> Tensor:
    """Return what one frame shows of each Gaussian (N,), pixels, weighted by its angle (eq. 2)."""
    G = avatar.canonical
    with torch.enable_grad():  # d picture / d (colour of a Gaussian) = Σ T α
        sh = torch.zeros_like(G.sh, requires_grad=True)
        gaussians = avatar.animate(pose, sh).gaussians
        target = sample.target(gaussians)
        image = render(gaussians, target.camera, AVATAR_SPLATTING)
        total = (image.color * target.composite().mask[..., None]).sum()
        (by_sh,) = torch.autograd.grad(total, sh)
    T_world_rest = avatar.posed_skeleton(pose).T_world_rest
    A = G.weights @ T_world_rest[:, :3, :3].flatten(1).to(G.weights)  # blended, as in Eq. 5
    turned = (A.view(-1, 3, 3) * normals[:, None]).sum(2)
    angle = facing(turned, gaussians.means, sample.camera)
    return by_sh[:, 0].mean(1) / C0 * angle


def facing(normals: Tensor, places: Tensor, camera: Camera) -> Tensor:
    """Return how squarely a camera sees normals (N, 3) at places (N, 3), metres.

    This is max(0, (s - n · d) / (s + 1))² of eq. 2, (N,).
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
    """

    points: np.ndarray
    normals: np.ndarray
    skull: np.ndarray
    trunk: np.ndarray
    limbs: np.ndarray

    @staticmethod
    @torch.no_grad()
    def of(avatar: Avatar, normals: Tensor) -> Places:
        """Find the places of an avatar's Gaussians; ``normals`` (N, 3) as above."""
        G, joints = avatar.canonical, avatar.rig.joints
        points = (G.means - joints[0]).double().numpy()
        head = (head_weights(G.weights) > 0.5).numpy()
        skull = head & (points[:, 1] > float((joints[HEAD] - joints[0])[1]))
        trunk = ~head & (G.weights[:, _TRUNK].sum(1) > 0.5).numpy()
        return Places(points, normals.double().numpy(), skull, trunk, ~head & ~trunk)


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
    row = np.floor(height / ROW_HEIGHT)
    for one in np.unique(row[places.trunk]):
        beside = places.trunk & (np.abs(height - (one + 0.5) * ROW_HEIGHT) < ROW_REACH)
        median = weighted_median(f[beside], w[beside])
        guess(places.trunk & (row == one), median, beside, np.abs(ahead))
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


FIRST_STRENGTH = 1.0  # s; chosen: turned to the light, a colour is 0.3 brighter than its mean


class Lambert(nn.Module):
    """Lambert's law for the Gaussians of an avatar whose slopes are differences from it.

    Attributes:
        strength: () s.
        normals: (N, 3) n, unit; see :meth:`follow`.
    """

    def __init__(self, avatar: Avatar) -> None:
        super().__init__()
        rig = avatar.rig
        self._on_body = vertex_normals(rig.vertices, rig.faces)
        self.strength = nn.Parameter(self._on_body.new_tensor(FIRST_STRENGTH))
        self.follow(avatar)

    def follow(self, avatar: Avatar) -> None:
        """Take the normals beside the Gaussians where they are now."""
        normals = avatar.skin.beneath_points(avatar.canonical.means, self._on_body)
        self.normals = torch.nn.functional.normalize(normals, dim=1)

    def forward(self, sh: Tensor) -> Tensor:
        """Return f_0 and f (N, 4, 3) from f_0 and δ, differentiable in these and in s.

        Constant colours, (N, 1, 3), have no slopes and stay.
        """
        if sh.shape[1] == 1 or not len(sh):
            return sh
        return _Lit.apply(sh, self.normals, self.strength)

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {"strength": self.strength.detach().clone(), "normals": self.normals}

    @torch.no_grad()
    def load_state(self, state: dict[str, Any]) -> None:
        """Restore a :meth:`state`, to the bit."""
        self.strength.copy_(state["strength"])
        self.normals = state["normals"]


def _color(sh: Lane) -> Lane:
    """Return the mean colour a of eq. 4, in the unit of sh."""
    return [dr.maximum(x + 0.5 / C0, 0) for x in sh[:3]]


def _forward(sh: Lane, normal: Lane, strength: Lane) -> list[Lane]:
    """Evaluate eq. 4 for sh, which holds f_0 and δ."""
    law = [strength[0] * n * a for n in normal for a in _color(sh)]
    return [sh[:3] + [d + x for d, x in zip(sh[3:], law, strict=True)]]


def _adjoint(sh: Lane, grad: Lane) -> list[Lane]:
    """Evaluate the sums over channels of eq. 5."""
    a = _color(sh)
    return [[sum(grad[3 * k + c] * a[c] for c in range(3)) for k in (1, 2, 3)]]


class _Lit(torch.autograd.Function):
    """Autograd function of sh (N, 4, 3), normals (N, 3), which are constant, and strength ()."""

    @staticmethod
    def forward(ctx: FunctionCtx, sh: Tensor, normals: Tensor, strength: Tensor) -> Tensor:
        ctx.save_for_backward(sh, normals)
        (lit,) = launch(_forward, sh.flatten(1), normals, strength.view(1, 1))
        return lit.view(sh.shape)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None, Tensor]:
        sh, normals = ctx.saved_tensors
        (by_law,) = launch(_adjoint, sh.flatten(1), grad.flatten(1))
        return grad, None, (by_law * normals).sum()
