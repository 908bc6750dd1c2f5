"""Canonical Gaussians: the learned surface of a person, in the rest pose.

=========  ===================  ==========  =============================================
symbol     code                 shape       meaning
=========  ===================  ==========  =============================================
mu         ``means``            (N, 3)      metres, in the T-pose of the body
q          ``quats``            (N, 4)      wxyz, normalised where they are used
log s      ``log_scales``       (N, 3)      logarithm of the standard deviations in metres
logit eta  ``logit_opacities``  (N,)        eta = sigmoid of it
f          ``sh``               (N, K, 3)   colour: f_0, and its slopes along x, y, z at rest
W(mu)      ``weights``          (N, 55)     skinning weights (Eq. 5), not learned
dW(mu)     ``slopes``           (N, 3, 55)  their derivatives along x, y, z, 1/m, not learned
D(mu)      ``directions``       (N, 3, K)   metres blend shapes move it by, not learned
=========  ===================  ==========  =============================================

W, dW and D come from the outer skin around mu (:mod:`gva_mi.avatar.rig`). Nearly all of their
entries are zero: an elbow's blend shapes move only what is around it. Seeding lays flat discs into
the surface of the body, so that the first image is a body and not a cloud.

Sources: parameters and activations as in 3D Gaussian splatting (Kerbl et al., 2023, Sec. 5);
Gaussians at the vertices of the body: Sec. 4.1 of the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from gva_mi.avatar.lbs_transforms import SparseWeights
from gva_mi.avatar.rig import Skin
from gva_mi.core.errors import InputError
from gva_mi.core.options import InnerShare, PythonOnly, Within, options_of
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat.kernels.sh import C0

FEWEST_GAUSSIANS = 100  # of an avatar; chosen: fewer discs leave holes in a person
SPACING_NEIGHBOURS = 3  # whose mean distance is the spacing of points, as in 3DGS (``simple-knn``)
# A number of Gaussians. Chosen: the distances of all pairs of more would take hours.
Count = Annotated[int, Within(0, 100_000)]
SMALLEST_RADIUS = 1e-5  # metres, of a new disc; chosen: points that coincide get a finite logarithm
PLASTIC_NUMBER = 1.324717957244746  # root of x³ = x + 1: the R2 sequence of Martin Roberts, 2018
PARAMETERS = ("means", "quats", "log_scales", "logit_opacities", "sh")
BINDING = ("weights", "slopes", "directions")  # taken from the outer skin, not learned


def require_count(where: str, count: int) -> None:
    """Raise an InputError for a number of Gaussians that is too small to cover a person.

    Example:
        >>> require_count("fit", 20)
        Traceback (most recent call last):
        gva_mi.core.errors.InputError: fit: count must be 0, or at least 100, got 20
    """
    if 0 < count < FEWEST_GAUSSIANS:
        raise InputError(f"{where}: count must be 0, or at least {FEWEST_GAUSSIANS}, got {count}")


class CanonicalGaussians(nn.Module):
    """N Gaussians in the rest pose: raw parameters, their activations, and skinning weights.

    It is made of the tensors of the table above by name; K is 1 or 4 coefficients of colour.

    Example:
        Ten Gaussians of 1 cm that follow the pelvis alone.

        >>> weights = torch.zeros(10, 55)
        >>> weights[:, 0] = 1
        >>> G = CanonicalGaussians(
        ...     means=torch.rand(10, 3), quats=torch.ones(10, 4),
        ...     log_scales=torch.full((10, 3), math.log(0.01)), logit_opacities=torch.zeros(10),
        ...     sh=torch.zeros(10, 1, 3), weights=weights, slopes=torch.zeros(10, 3, 55),
        ...     directions=torch.zeros(10, 3, 20),
        ... )
        >>> len(G), G.opacities[0].item(), round(G.scales[0, 0].item(), 4)
        (10, 0.5, 0.01)
    """

    def __init__(self, **tensors: Tensor) -> None:
        super().__init__()
        for name in PARAMETERS:
            setattr(self, name, nn.Parameter(tensors[name].detach().clone().contiguous()))
        for name in BINDING:
            self.register_buffer(name, tensors[name].detach().clone().contiguous())
        self._sparse: dict[tuple[str, ...], tuple[list[Tensor], list[int], Any]] = {}

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def scales(self) -> Tensor:
        """Standard deviations, (N, 3) metres."""
        return torch.exp(self.log_scales)

    @property
    def opacities(self) -> Tensor:
        """Opacities in (0, 1), (N,)."""
        return torch.sigmoid(self.logit_opacities)

    @torch.no_grad()
    def clamp_scales(self, least: float) -> None:
        """Clamp all standard deviations to at least ``least`` metres."""
        if least > 0:
            self.log_scales.clamp_(min=math.log(least))

    @torch.no_grad()
    def decay_slopes(self, share: float) -> None:
        """Shrink the colours' dependence on light or view by a share in [0, 1]."""
        if share > 0:
            self.sh[:, 1:].mul_(1 - share)

    def moved_by(self, coefficients: Tensor) -> Tensor:
        """Return D c, metres (N, 3) by which blend shapes move the means; c is (up to K,)."""
        return self._sparse_of(_SparseDirections.of, "directions")(coefficients)

    @property
    def sparse_weights(self) -> SparseWeights:
        """Skinning weights and their slopes without the zeros."""
        return self._sparse_of(SparseWeights.of, "weights", "slopes")

    def _sparse_of(self, make: Callable[..., Any], *names: str) -> Any:  # noqa: ANN401
        """Return the sparse form of buffers, which is made again when one of them has changed."""
        held = [getattr(self, name) for name in names]
        if any(x.is_inference() for x in held):  # such tensors do not record changes
            return make(*held)
        versions = [x._version for x in held]
        known = self._sparse.get(names)
        if known is None or known[1] != versions or list(map(id, known[0])) != list(map(id, held)):
            self._sparse[names] = known = held, versions, make(*held)
        return known[2]


@dataclass(frozen=True)
class _SparseDirections:
    """The non-zero entries of directions (N, 3, K), which are few."""

    count: int  # N
    entries: Tensor  # (E,) int64, the coordinate among 3 N
    shapes: Tensor  # (E,) int64, the blend shape among K
    metres: Tensor  # (E,)

    @staticmethod
    def of(directions: Tensor) -> _SparseDirections:
        N, _, K = directions.shape
        entries, shapes = directions.view(3 * N, K).nonzero().unbind(1)
        return _SparseDirections(N, entries, shapes, directions.view(3 * N, K)[entries, shapes])

    def __call__(self, coefficients: Tensor) -> Tensor:
        shapes = int(self.shapes.max()) + 1 if len(self.shapes) else 0
        padded = pad(coefficients, (0, max(0, shapes - len(coefficients))))
        metres = padded.index_select(0, self.shapes) * self.metres
        moved = metres.new_zeros(3 * self.count).index_add(0, self.entries, metres)
        return moved.view(self.count, 3)


@options_of("fit")
class SeedOptions:
    """Options of the first Gaussians, which cover the rest body.

    Example:
        >>> SeedOptions(count=5000).overlap
        0.7
    """

    # Gaussians; 0: one on each vertex, as in the paper.
    count: Count = 0
    # 0: the same colour in any light; 1: linear in the light's direction.
    sh_degree: Annotated[int, Within(0, 1)] = 1
    opacity: PythonOnly[InnerShare] = 0.9  # opacity of every new Gaussian
    # Standard deviation in the tangent plane / distance of neighbours.
    overlap: PythonOnly[Annotated[float, Within(0, 100, "low")]] = 0.7
    # Standard deviation along the normal / in the tangent plane.
    flatness: PythonOnly[Annotated[float, Within(0, 100, "low")]] = 0.25

    def __post_init__(self) -> None:
        require_count("fit", self.count)


def seed_on_surface(
    vertices: Tensor,
    faces: Tensor,
    skin: Skin,
    options: SeedOptions = SeedOptions(),  # noqa: B008 (frozen)
    colors: Tensor | None = None,
) -> CanonicalGaussians:
    """Cover a rest surface with flat discs, without random numbers.

    One Gaussian sits on each vertex (V, 3), metres, and the rest are spread over the faces (F, 3)
    by area. If fewer Gaussians than vertices are requested, all are spread over the faces. The skin
    gives them weights and blend shapes; ``colors`` (V, 3) are linear, None: grey.

    Example:
        >>> from gva_mi.avatar.rig import Rig, SkinningOptions
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> rig = Rig.of(load_body(), Shape(torch.zeros(10)))
        >>> skin = rig.skin(SkinningOptions())
        >>> G = seed_on_surface(rig.vertices, rig.faces, skin, SeedOptions(count=500))
        >>> G.means.shape, G.weights.shape
        (torch.Size([500, 3]), torch.Size([500, 55]))
    """
    V = vertices.shape[0]
    count = options.count or V
    points, normals = vertices, vertex_normals(vertices, faces)
    albedo = torch.full_like(vertices, 0.5) if colors is None else colors
    if count != V:
        chosen, barycentric = spread_over_faces(vertices, faces, count - V if count > V else count)
        on_faces = lambda x: (x[faces[chosen]] * barycentric[..., None]).sum(1)
        extra = [on_faces(x) for x in (points, normals, albedo)]
        if count > V:
            extra = [torch.cat(pair) for pair in zip((points, normals, albedo), extra, strict=True)]
        points, normals, albedo = extra
    spacing = neighbour_spacing(points)
    sh = points.new_zeros(count, (options.sh_degree + 1) ** 2, 3)
    sh[:, 0] = (albedo - 0.5) / C0
    return CanonicalGaussians(
        means=points,
        quats=disc_quats(normals),
        log_scales=disc_log_scales(spacing, options),
        logit_opacities=torch.logit(points.new_full((count,), options.opacity)),
        sh=sh,
        **skin.bind(points),
    )


def rotated(quats: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors (N, 3) by quaternions (N, 4) wxyz of any length.

    Example:
        Half a turn about z.

        >>> rotated(torch.tensor([[0.0, 0, 0, 2]]), torch.tensor([[1.0, 0, 3]]))
        tensor([[-1.,  0.,  3.]])
    """
    q = torch.nn.functional.normalize(quats, dim=-1)
    w, v = q[:, :1], q[:, 1:]
    across = 2 * torch.linalg.cross(v, vectors)
    return vectors + w * across + torch.linalg.cross(v, across)


def disc_quats(normals: Tensor) -> Tensor:
    """Return the shortest rotation of the z axis onto the line of each normal (N, 3), (N, 4) wxyz.

    A Gaussian has no front: taking n or -n so that n_z >= 0 keeps q = (1 + n_z, z x n) away from
    its pole.

    Example:
        >>> disc_quats(torch.tensor([[0.0, 0, -2], [1, 0, 0]])) + 0
        tensor([[1.0000, 0.0000, 0.0000, 0.0000],
                [0.7071, 0.0000, 0.7071, 0.0000]])
    """
    n = torch.nn.functional.normalize(normals, dim=-1)
    n = torch.where(n[:, 2:] < 0, -n, n)
    x, y, z = n.unbind(-1)
    quats = torch.stack([1 + z, -y, x, torch.zeros_like(z)], -1)
    return torch.nn.functional.normalize(quats, dim=-1)


def disc_log_scales(spacing: Tensor, options: SeedOptions) -> Tensor:
    """Return log scales (N, 3) of flat discs whose neighbours lie ``spacing`` (N,) metres away.

    Example:
        >>> disc_log_scales(torch.tensor([0.01]), SeedOptions(overlap=0.7, flatness=0.25)).exp()
        tensor([[0.0070, 0.0070, 0.0017]])
    """
    radius = (spacing * options.overlap).clamp_min(SMALLEST_RADIUS).log()
    return torch.stack([radius, radius, radius + math.log(options.flatness)], -1)


def spread_over_faces(vertices: Tensor, faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Spread ``count`` points evenly over a surface, without random numbers.

    Face k receives the points that fall into its interval of the cumulated area; inside a face they
    follow the golden-ratio sequence in two dimensions (Martin Roberts, "The Unreasonable
    Effectiveness of Quasirandom Sequences", 2018).

    Returns:
        Faces (count,) int64 and barycentric coordinates (count, 3).

    Example:
        The second triangle is three times as large as the first.

        >>> corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -3, 0]])
        >>> faces, shares = spread_over_faces(corners, torch.tensor([[0, 1, 2], [0, 3, 1]]), 100)
        >>> faces.bincount(), shares.shape
        (tensor([25, 75]), torch.Size([100, 3]))
    """
    a, b, c = vertices[faces].unbind(1)
    area = torch.linalg.cross(b - a, c - a).norm(dim=-1).double().cumsum(0)
    at = (torch.arange(count, dtype=torch.float64, device=area.device) + 0.5) / count * area[-1]
    chosen = torch.searchsorted(area, at).clamp_max(len(faces) - 1)
    k = torch.arange(1, count + 1, dtype=torch.float64, device=area.device)
    u, v = (k / PLASTIC_NUMBER).frac(), (k / PLASTIC_NUMBER**2).frac()
    outside = u + v > 1  # mirror the unit square's upper half into the triangle
    u, v = torch.where(outside, 1 - u, u), torch.where(outside, 1 - v, v)
    return chosen, torch.stack([1 - u - v, u, v], -1).to(vertices.dtype)


def neighbour_spacing(points: Tensor) -> Tensor:
    """Return the mean distance of each point (N, 3) to its nearest neighbours, (N,) metres.

    Example:
        >>> corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
        >>> neighbour_spacing(corners).round(decimals=3)  # 1, 1 and the diagonal
        tensor([1.1380, 1.1380, 1.1380, 1.1380])
    """
    from scipy.spatial import KDTree

    count = min(SPACING_NEIGHBOURS + 1, len(points))
    places = points.detach().double().numpy()
    nearest, _ = KDTree(places).query(places, range(1, count + 1))
    return torch.from_numpy(nearest[:, 1:].mean(1)).to(points)
