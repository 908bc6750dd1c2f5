"""The rest body of an avatar, and the outer skin that clothes, hair and face of a person follow.

A point on the body follows the vertex beneath it. A point of a wide skirt has no vertex beneath it,
and the nearest vertices belong sometimes to one leg and sometimes to the other. So weights of the
nearest vertex jump, and a wide step tears the cloth there. Therefore weights are diffused on the
outer surface S of the person, which connects the parts of a garment. They are diffused more where
cloth is looser:

    1. ℓ(x) = spread · d(x), d the distance from the bare skin;  0 where d is below CLOSE_TO_SKIN
    2. W - ℓ² Δ_S W = W_near

with W_near the weights of the body's nearest vertex. Eq. 2 is one implicit step of diffusion: W
lies between the values of W_near around x, stays positive, and sums to one. Abdrashitov et al. fill
in weights where they cannot be trusted ("Robust Skin Weights Transfer via Weight Inpainting",
2023); a hem filled in from close points alone would hang from the waist and not follow the thighs.

Blend shapes, which make joints bulge and the face move, come from the body's nearest vertex.

Gaussians take both from the vertices of S around them by Shepard's interpolation, which is
continuous and exact at the vertices, so they can be bound again as they move (with the weights of
Franke and Nielson, "Smooth interpolation of large sets of scattered data", 1980). The slopes of
weights, by which cloth stretches, come from a plane that is fitted to PLANE_VERTICES vertices by
least squares:

    3. ∂W/∂x = (XᵀX + ε I)⁻¹ Xᵀ W,    ε = FLATNESS tr XᵀX,    X: these vertices minus their mean

Where the vertices lie in a plane, the slope across it is zero.

The paper takes the weights of the nearest vertex (Sec. 4.1): ``spread`` 0, ``neighbours`` 1.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Shape
from gva_mi.body.skinning import strongest
from gva_mi.body.smplx import BodyModel
from gva_mi.core.options import PythonOnly, Within, options_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array


CLOSE_TO_SKIN = 0.02  # metres off the bare skin; chosen: tight cloth follows the vertex beneath
PLANE_VERTICES = 12  # that eq. 3 is fitted to; chosen: two rings around a vertex
# 1/m; smaller slopes of a weight are left out. Chosen: they stretch cloth by 1 % in 10 cm.
SMALLEST_SLOPE = 0.1
# Of eq. 3, no unit. Chosen: a surface that is thinner than this share has no slope across.
FLATNESS = 0.005
COTANGENTS = (0.01, 100)  # of eq. 2, clipped; chosen: weights stay in the range of their neighbours


@options_of("fit")
class SkinningOptions:
    """How Gaussians take their skinning weights from the outer skin.

    Example:
        >>> as_in_the_paper = SkinningOptions(spread=0, neighbours=1)
    """

    # Of eq. 1; with 1 a skirt lags behind the legs; 0: weights are not diffused.
    spread: PythonOnly[Annotated[float, Within(0, 4)]] = 0.5
    # Vertices that a point takes its weights from.
    neighbours: PythonOnly[Annotated[int, Within(1, 11)]] = 6
    # P of Eq. 5, joints of a point; where legs and trunk share a hem, 4 are too few.
    joints: PythonOnly[Annotated[int, Within(1, 55)]] = 8


@dataclass(frozen=True)
class Skin:
    """A surface at rest with its skinning weights and blend shapes.

    Example:
        A point close to the left wrist follows forearm and hand.

        >>> from gva_mi.body.pose import JOINTS
        >>> from gva_mi.body.smplx import load_body
        >>> rig = Rig.of(load_body(), Shape(torch.zeros(10)))
        >>> skin = rig.skin(SkinningOptions())
        >>> bound = skin.bind(rig.joints[JOINTS.index("left_wrist")][None])
        >>> sorted(JOINTS[j] for j in bound["weights"][0].topk(2).indices)
        ['left_elbow', 'left_wrist']
    """

    vertices: Tensor  # (V, 3) metres
    weights: Tensor  # (V, 55) skinning weights, rows sum to 1
    beneath: Tensor  # (V,) int64, the nearest vertex of the body
    directions: Tensor  # (vertices of the body, 3, K) metres by which blend shapes move those
    options: SkinningOptions = SkinningOptions()

    def bind(self, points: Tensor) -> dict[str, Tensor]:
        """Interpolate skinning weights and blend shapes of points (N, 3).

        Returns:
            ``weights`` (N, 55) of the strongest joints, rows sum to 1; ``slopes`` (N, 3, 55), their
            derivatives along x, y, z, 1/m, rows sum to 0; ``directions`` (N, 3, K), metres by which
            blend shapes move the points.

        Note:
            Not differentiable: the pictures decide where a Gaussian lies, not the slope of its
            weights.
        """
        if not len(points):
            slopes, none = self.weights.new_zeros(0, 3, self.weights.shape[1]), self.weights[:0]
            return {"weights": none, "slopes": slopes, "directions": self.directions[:0]}
        distance, nearest = self._nearest(points, PLANE_VERTICES)
        share, few = self._shares(distance, nearest)
        weights = _means(share, few, self.weights)
        blend_shapes = mean_directions(share, self.beneath[few], self.directions)
        weights = strongest(weights, self.options.joints)
        slopes = self._slopes(nearest)
        return {"weights": weights, "slopes": slopes, "directions": blend_shapes}

    def _slopes(self, nearest: np.ndarray) -> Tensor:
        """Return slopes (N, 3, 55) 1/m by eq. 3, from the nearest vertices (N, k) of each point."""
        from scipy.sparse import csr_array

        vertices, weights = self.vertices.double().numpy(), self.weights.double().numpy()
        count = nearest.shape[1]
        X = vertices[nearest] - vertices[nearest].mean(1, keepdims=True)
        square = np.einsum("nki,nkj->nij", X, X)
        flat = FLATNESS * np.trace(square, axis1=1, axis2=2) + 1e-12
        shares = np.einsum("nij,nkj->nik", inverse(square + flat[:, None, None] * np.eye(3)), X)
        rows = np.arange(0, shares.size + 1, count)
        columns = np.repeat(nearest, 3, axis=0).ravel()
        planes = csr_array((shares.ravel(), columns, rows), (3 * len(nearest), len(vertices)))
        slopes = torch.from_numpy(planes @ weights).unflatten(0, (-1, 3))
        return _largest(slopes, self.options.joints, self.weights)

    def around(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the vertices around points (N, 3), N > 0, and their shares.

        Each of the nearest vertices has weight ((r - d) / (r d))², with d its distance and r that
        of the first one left out: nothing jumps where another vertex comes near.

        Returns:
            Shares (N, k), whose rows sum to 1, and the vertices' numbers (N, k) int64.
        """
        return self._shares(*self._nearest(points, self.options.neighbours + 1))

    def beneath_points(self, points: Tensor, on_body: Tensor) -> Tensor:
        """Return means (N, C) of the body's values (V, C) beneath the vertices around points."""
        shares, vertices = self.around(points)
        return (shares[..., None] * on_body[self.beneath[vertices]]).sum(1)

    def _nearest(self, points: Tensor, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return distances and numbers (N, k) of up to ``count`` vertices nearest to points."""
        from scipy.spatial import cKDTree

        x, tree = points.detach().double().numpy(), cKDTree(self.vertices.double().numpy())
        found = tree.query(x, k=min(count, len(self.vertices)), workers=-1)
        return tuple(part.reshape(len(x), -1) for part in found)

    def _shares(self, distance: np.ndarray, nearest: np.ndarray) -> tuple[Tensor, Tensor]:
        """Return the result of :meth:`around`, from distances and numbers of near vertices."""
        distance, nearest = (x[:, : self.options.neighbours + 1] for x in (distance, nearest))
        d = np.maximum(distance, 1e-9)
        share = np.square(1 / d - 1 / d[:, -1:])
        share[share.sum(1) == 0, 0] = 1  # all equally far
        share /= share.sum(1, keepdims=True)
        return torch.from_numpy(share).to(self.weights), torch.from_numpy(nearest)


def inverse(A: np.ndarray) -> np.ndarray:
    """Invert matrices (N, 3, 3) by cofactors, because LAPACK's bits depend on the processor.

    Example:
        >>> inverse(np.diag([1.0, 2, 4])[None])[0].diagonal()
        array([1.  , 0.5 , 0.25])
    """
    a, b, c = A[:, 0], A[:, 1], A[:, 2]
    columns = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    return columns / (a * columns[:, :, 0]).sum(1)[:, None, None]


def _largest(slopes: Tensor, joints: int, like: Tensor) -> Tensor:
    """Keep the joints with the largest slopes (N, 3, J), make their sum zero, typed as ``like``."""
    found = slopes.abs().amax(1).topk(min(joints, slopes.shape[2]), dim=1)
    chosen = found.indices[:, None].expand(-1, 3, -1)
    steep = (found.values > SMALLEST_SLOPE)[:, None].to(slopes)
    kept = slopes.gather(2, chosen) * steep
    kept = steep * (kept - kept.sum(2, keepdim=True) / steep.sum(2, keepdim=True).clamp_min(1))
    return like.new_zeros(slopes.shape).scatter(2, chosen, kept.to(like))


def mean_directions(share: Tensor, vertices: Tensor, directions: Tensor) -> Tensor:
    """Return means (N, 3, K) of k vertices' blend shapes (V, 3, K), by their shares (N, k).

    Example:
        >>> directions = torch.tensor([[[0.0], [0], [0]], [[0], [2], [0]]])  # of two vertices
        >>> mean_directions(torch.tensor([[0.5, 0.5]]), torch.tensor([[0, 1]]), directions)[0, :, 0]
        tensor([0., 1., 0.])
    """
    return _means(share, vertices, directions.flatten(1)).unflatten(1, directions.shape[1:])


def _means(share: Tensor, rows: Tensor, of: Tensor) -> Tensor:
    """Return the means (N, K) of k rows of a matrix (V, K), by their shares (N, k)."""
    from scipy.sparse import csr_array

    N, k = share.shape
    first = np.arange(0, N * k + 1, k)
    mean = csr_array((share.numpy().ravel(), rows.numpy().ravel(), first), (N, len(of)))
    return torch.from_numpy(mean @ of.numpy())


def diffused(vertices: np.ndarray, faces: np.ndarray, body: Skin, looseness: Tensor) -> Skin:
    """Make the skin of an outer surface by diffusing the body's weights on it (eq. 2).

    Args:
        vertices, faces: the outer surface at rest, metres.
        body: the skin of the rest body; it is the result if its options have no spread.
        looseness: metres by which clothes displaced each vertex of the body.

    Example:
        Around a body whose clothes stand 10 cm off, weights are smoother than on the skin.

        >>> from gva_mi.body.smplx import load_body
        >>> rig = Rig.of(load_body(), Shape(torch.zeros(10)))
        >>> skin, loose = rig.skin(SkinningOptions()), torch.full((len(rig.vertices),), 0.1)
        >>> outer = diffused(rig.vertices.double().numpy(), rig.faces.numpy(), skin, loose)
        >>> bool(outer.weights.amax(1).mean() < skin.weights.amax(1).mean())
        True
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu
    from scipy.spatial import cKDTree

    spread = body.options.spread
    if not spread:
        return body
    distance, nearest = cKDTree(body.vertices.double().numpy()).query(vertices)
    off = distance + looseness.double().numpy()[nearest]
    weights = body.weights.double().numpy()[nearest]
    loose = off > CLOSE_TO_SKIN
    if loose.any():
        area, laplacian = _laplacian(vertices, faces)
        width = spread * np.where(loose, off, 1e-3 * CLOSE_TO_SKIN)  # eq. 1
        pull = diags_array(area / width**2)
        used = weights.any(0)
        weights[:, used] = splu((pull + laplacian).tocsc()).solve(pull @ weights[:, used])
    as_tensor = lambda x: torch.from_numpy(np.ascontiguousarray(x)).to(body.weights)
    beneath = body.beneath[torch.from_numpy(nearest)]
    return Skin(as_tensor(vertices), as_tensor(weights), beneath, body.directions, body.options)


def _laplacian(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, csr_array]:
    """Return areas of vertices (V,) m², and the Laplacian of linear elements (V, V).

    Source: Pinkall and Polthier, "Computing discrete minimal surfaces and their conjugates", 1993.
    Cotangents of obtuse angles are clipped above zero; otherwise weights could leave the range of
    their neighbours.
    """
    from scipy.sparse import coo_array, diags_array

    count, corners = len(vertices), vertices[faces]
    area = np.linalg.norm(np.cross(*(corners[:, k] - corners[:, 0] for k in (1, 2))), axis=1) / 2
    edges = coo_array((count, count))
    for k in range(3):
        i, j = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        a, b = (corners[:, (k + s) % 3] - corners[:, k] for s in (1, 2))
        cotangent = (a * b).sum(1) / np.maximum(2 * area, 1e-12)
        half = np.clip(cotangent, *COTANGENTS) / 2
        edges = edges + coo_array((half, (i, j)), shape=(count, count))
    edges = (edges + edges.T).tocsr()
    share = np.bincount(faces.ravel(), np.repeat(area / 3, 3), count)
    return np.maximum(share, 1e-12), (diags_array(edges.sum(1)) - edges).tocsr()


RIG_TENSORS = (  # the tensors of a Rig
    "joints", "vertices", "faces", "weights", "looseness", "directions", "pose_features",
    "expression_joints", "betas",
)  # fmt: skip


@dataclass(frozen=True)
class Rig:
    """Skeleton and surface of a person at rest.

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> rig = Rig.of(load_body(), Shape(torch.zeros(10)))
        >>> rig.vertices.shape, rig.joints.shape, rig.looseness.max()
        (torch.Size([10989, 3]), torch.Size([55, 3]), tensor(0.))
    """

    joints: Tensor  # (55, 3) metres, rest pose
    parents: tuple[int, ...]  # 55, -1 for the root
    vertices: Tensor  # (V, 3) metres, rest pose, displaced by the clothes' offsets
    faces: Tensor  # (F, 3) int64
    weights: Tensor  # (V, 55)
    looseness: Tensor  # (V,) metres by which the clothes' offsets displaced it
    directions: Tensor  # (V, 3, P + E) metres by which blend shapes move the vertices
    pose_features: Tensor  # (P,) int64, which of the 9 (J - 1) entries of R - I
    expression_joints: Tensor  # (55, 3, E) metres by which expressions move the joints
    betas: Tensor  # (B,) the shape it was made with
    body: str  # the digest of the body model it came from

    def skin(self, options: SkinningOptions) -> Skin:
        """Return the surface itself, as a skin that points can follow."""
        itself = torch.arange(len(self.vertices))
        return Skin(self.vertices, self.weights, itself, self.directions, options)

    def outer_skin(self, options: SkinningOptions) -> Skin:
        """Return the surface as an outer skin: weights spread where clothes are loose."""
        vertices, faces = self.vertices.double().numpy(), self.faces.numpy()
        return diffused(vertices, faces, self.skin(options), self.looseness)

    @staticmethod
    @torch.no_grad()
    def of(body: BodyModel, shape: Shape, offsets: Tensor | None = None) -> Rig:
        """Build the rest body of a person from a body model.

        ``offsets`` (V, 3) displace the rest surface (SMPL-X + D), metres; None: naked.
        """
        rest, count = body.rest(shape), len(body.v_template)
        vertices = rest.vertices if offsets is None else rest.vertices + offsets
        directions = body.frame_directions[:, : 3 * count].view(-1, 3, count).permute(2, 1, 0)
        expressions = body.expression_joints.view(-1, len(body.parents), 3)
        return Rig(
            joints=rest.joints,
            parents=tuple(body.parents),
            vertices=vertices,
            faces=body.faces,
            weights=body.weights,
            looseness=(vertices - rest.vertices).norm(dim=1),
            directions=directions.contiguous(),
            pose_features=body.pose_features,
            expression_joints=expressions.permute(1, 2, 0).contiguous(),
            betas=shape.betas,
            body=digest(body),
        )


def moved_by(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Return metres (T, N, 3) that blend shapes (N, 3, K) move points; coefficients are (T, up to
    K).

    Example:
        >>> moved_by(torch.tensor([[2.0]]), torch.tensor([[[0.0, 1], [0.5, 1], [0, 1]]]))
        tensor([[[0., 1., 0.]]])
    """
    used = directions[..., : coefficients.shape[1]]
    return (coefficients @ used.flatten(0, 1).T).unflatten(1, (-1, 3))


def digest(body: BodyModel) -> str:
    """Return a fingerprint of a body model: an avatar records the one that it was fitted with.

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> len(digest(load_body()))
        16
    """
    return hashlib.sha256(body.v_template.numpy().tobytes()).hexdigest()[:16]
