"""Surface-guided re-initialisation (Sec. 4.3): put Gaussians back on the person's surface.

Cloning and splitting crowd Gaussians where texture is rich. A start on the naked body leaves hair
and loose clothes to a few large Gaussians that come apart in new poses. So, 2-3 times in a fit:

1. meshing       a closed surface around the opaque Gaussians           ``mesh_gaussians``
2. smoothing     Taubin's low-pass filter of it                         ``mesh_gaussians``
3. resampling    points on it, denser where it is curved, and in faces  ``resample``
4. re-Gaussian   opacity and colour from the K nearest old ones,        ``_regaussian``
                 rotation and scale anew, skinning from the new surface

Differences from the paper (``surface="alpha"`` and ``random`` of the options are as printed):

* The "spherical shell" around the outermost Gaussians is an offset surface, not an alpha shape:
  always watertight and without inner sheets (:mod:`gva_mi.avatar.surface`). The shrunk rest
  body inside it keeps the surface from entering through holes.
* At rest, the surface would join the legs, and arms and trunk. It is made with the limbs spread
  (:mod:`gva_mi.avatar.surface`).
* Laplacian smoothing shrinks, arms most. Taubin's filter keeps the volume.
* What bridges holes would also bridge the gaps between fingers. There, points are drawn on the
  body's own surface (:mod:`gva_mi.avatar.surface`).
* Points spread by curvature alone are a centimetre apart, which leaves an eye two or three of them.
  Faces, which viewers look at first, get more.
* Random rotations would begin as a cloud of needles. Discs lie in the surface, turned randomly
  about the normal; their sizes are the spacing of the points times a random factor.

Further sources: Taubin, "A signal processing approach to fair surface design", 1995;
floaters are found as in PCL's ``StatisticalOutlierRemoval`` (Rusu et al., 2008).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.canonical import (
    FEWEST_GAUSSIANS,
    CanonicalGaussians,
    Count,
    disc_log_scales,
    disc_quats,
    require_count,
)
from gva_mi.avatar.rig import Rig, Skin, diffused
from gva_mi.avatar.surface import (
    SpreadLimbs,
    SurfaceMesh,
    SurfacePoints,
    alpha_shape,
    mean_distance,
    offset_surface,
    resample,
    with_fingers,
)
from gva_mi.body.pose import EYES, ROOT_AND_BODY
from gva_mi.body.skinning import finger_weights
from gva_mi.core.options import PythonOnly, Within, options_of
from gva_mi.mesh.surface import vertex_normals

# In distances of the eyes: a face's radius, and how far below the eyes its middle lies. Chosen:
# from the brows to the chin.
FACE_RADIUS, BELOW_EYES = 1.4, 0.6
# Only Gaussians above this opacity carry the surface. Chosen: they hide what is behind them.
SURFACE_OPACITY = 0.5
FLOATER_NEIGHBOURS = 16  # whose mean distance makes a floater; chosen: more than float together
# Density at the most curved places / in flat ones, minus 1; chosen: an ear has 3 ×.
CURVATURE_GAIN = 2.0
COLOR_NEIGHBOURS = 4  # K, of opacity and colour; chosen: the old Gaussians all around
OFFSET_ALPHA = 0.015  # metres, of the offset surface; chosen: seams close, limbs stay apart
COINCIDENT = 1e-8  # m², added to squared distances; chosen: a tenth of a millimetre counts as equal


@options_of("fit")
class ReinitOptions:
    """Sizes of the four operations, in metres where they are lengths.

    Example:
        >>> ReinitOptions(count=5000, face_gain=0.0).smoothing
        10
    """

    # Gaussians afterwards, within a few percent; 0: as many as before.
    count: PythonOnly[Count] = 0
    # The offset surface, or the outer boundary of an alpha shape with Laplacian smoothing.
    surface: PythonOnly[Literal["offset", "alpha"]] = "offset"
    # Gaussians whose mean distance to their neighbours exceeds the average by more than this many
    # standard deviations are floaters.
    floater_sigmas: PythonOnly[Annotated[float, Within(0, 1000)]] = 2.0
    # Gaps narrower than twice this are closed, metres; at least the points' spacing. Without it,
    # 0.015 for the offset surface, and for an alpha shape the smallest that closes trunk and limbs.
    alpha: Annotated[float, Within(0.004, 1, unit="metres")] | None = None
    # Depth of the inner body below its surface, metres.
    filler_depth: PythonOnly[Annotated[float, Within(0, 1)]] = 0.012
    # Steps of Taubin's, or Laplace's filter.
    smoothing: PythonOnly[Annotated[int, Within(0, 1000)]] = 10
    # Density in the face / elsewhere, minus 1.
    face_gain: PythonOnly[Annotated[float, Within(0, 1000)]] = 5.0
    # Standard deviation of the logarithm of a size.
    scale_jitter: PythonOnly[Annotated[float, Within(0, 5)]] = 0.1
    # Any orientation, and no flat side, instead of discs in the surface.
    random: PythonOnly[bool] = False

    def __post_init__(self) -> None:
        require_count("fit", self.count)


@dataclass(frozen=True)
class Reinitialised:
    """Result of :func:`reinitialise`; the avatar itself has not changed yet.

    Example:
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.avatar.densify import replace_gaussians
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> found = reinitialise(avatar, ReinitOptions(alpha=0.04), torch.manual_seed(0))
        >>> optimizer = torch.optim.Adam(avatar.canonical.parameters())
        >>> replace_gaussians(avatar, optimizer, found.canonical)
        >>> avatar.set_skin_weights(found.skin)
        >>> avatar.canonical is found.canonical, len(avatar.skin.vertices) > 1000
        (True, True)
    """

    canonical: CanonicalGaussians  # see :func:`gva_mi.avatar.densify.replace_gaussians`
    surface: SurfaceMesh  # smooth and watertight
    skin: Skin  # the surface with fingers, the avatar's next outer skin


def reinitialise(
    avatar: Avatar,
    options: ReinitOptions = ReinitOptions(),  # noqa: B008 (frozen)
    generator: torch.Generator | None = None,
) -> Reinitialised | None:
    """Make new Gaussians on the surface of an avatar's opaque Gaussians.

    The generator draws points, angles and sizes. None if too few Gaussians are opaque to be a
    surface, as in a fit that has diverged or only just begun.

    Example:
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> found = reinitialise(avatar, ReinitOptions(alpha=0.04), torch.manual_seed(0))
        >>> print(f"about {len(found.canonical):.1g} Gaussians")
        about 5e+02 Gaussians
        >>> avatar.canonical.logit_opacities.data.fill_(-5)  # nearly transparent
        tensor(...)
        >>> reinitialise(avatar) is None
        True
    """
    # One draw starts a numpy generator: the geometry below lives in numpy and float64.
    rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
    G = avatar.canonical
    solid = torch.nonzero(G.opacities.detach() > SURFACE_OPACITY).flatten()
    if len(solid) <= max(FLOATER_NEIGHBOURS, FEWEST_GAUSSIANS):
        return None
    means = G.means.detach()[solid].double().numpy()
    rig = avatar.rig
    floats = find_floaters(means, FLOATER_NEIGHBOURS, options.floater_sigmas)
    on_surface = solid[torch.from_numpy(~floats)]
    weights = G.weights[on_surface].double().numpy()
    surface = mesh_gaussians(means[~floats], rig, options, weights)
    whole = with_fingers(surface, rig) if options.surface == "offset" else surface
    density = wanted_density(whole, rig, options)
    samples = resample(whole, options.count or len(G), density, rng)
    body = rig.skin(avatar.options.skinning)
    skin = diffused(whole.vertices, whole.faces, body, rig.looseness)
    canonical = _regaussian(avatar, on_surface, samples, skin, options, rng)
    return Reinitialised(canonical, surface, skin)


def find_floaters(points: np.ndarray, neighbours: int, sigmas: float) -> np.ndarray:
    """Mark points (N, 3) that are far from all others, (N,) bool: a statistical outlier test.

    Example:
        >>> line = np.arange(20.0)[:, None] * [1, 0, 0]
        >>> line[-1, 1] = 30
        >>> np.flatnonzero(find_floaters(line, neighbours=2, sigmas=2))
        array([19])
    """
    distance = mean_distance(points, neighbours)
    return distance > distance.mean() + sigmas * distance.std()


def mesh_gaussians(
    points: np.ndarray, rig: Rig, options: ReinitOptions, weights: np.ndarray | None = None
) -> SurfaceMesh:
    """Wrap points (N, 3), and the rest body inside them, in a smooth surface.

    ``weights`` (N, 55) are the points' skinning weights; None: the weights of the body beneath.

    Example:
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> rig = Rig.of(load_body(), Shape(torch.zeros(10)))
        >>> points = rig.vertices[::20].double().numpy()
        >>> surface = mesh_gaussians(points, rig, ReinitOptions(alpha=0.04))
        >>> bool(abs(np.ptp(surface.vertices[:, 1]) - np.ptp(points[:, 1])) < 0.03)  # as tall
        True
    """
    from scipy.spatial import cKDTree

    # Between points that are further apart than alpha, the surface would sink onto the filler.
    spacing = lambda x: np.percentile(mean_distance(x, 6), 95)
    if options.surface == "alpha":
        inside = rig.joints[ROOT_AND_BODY].double().numpy() if options.alpha is None else None
        least = max(options.alpha or 0, spacing(points))
        return alpha_shape(points, least, options.smoothing, inside)
    filler, naked = _filler(rig, options.filler_depth), rig.weights.double().numpy()
    if weights is None:
        weights = naked[cKDTree(filler.vertices).query(points)[1]]
    spread = SpreadLimbs.of(rig, np.vstack([points, filler.vertices]), np.vstack([weights, naked]))
    outer, inner = np.split(spread.points, [len(points)])
    filled = SurfaceMesh(inner, filler.faces)
    alpha = max(options.alpha or OFFSET_ALPHA, spacing(outer))
    found = offset_surface(outer, filled, alpha, options.smoothing)
    return SurfaceMesh(spread.at_rest(found.vertices), found.faces)


def wanted_density(surface: SurfaceMesh, rig: Rig, options: ReinitOptions) -> np.ndarray:
    """Return the wanted density of points at the vertices of a surface, (V,), 1 where it is flat.

    The density is (1 + gain · c), with c the curvature between 0 (flat) and 1 (the 95th
    percentile), and (1 + face gain) times as much in the face: within :data:`FACE_RADIUS` times the
    distance of the eyes from a place below them.

    Example:
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> rig = Rig.of(load_body(), Shape(torch.zeros(10)))
        >>> body = SurfaceMesh(rig.vertices.double().numpy(), rig.faces.numpy())
        >>> density = wanted_density(body, rig, ReinitOptions(face_gain=5.0))
        >>> density.min().round(), density.max().round()  # at most (1 + 2) (1 + 5)
        (np.float64(1.0), np.float64(18.0))
    """
    left, right = rig.joints[EYES].double().numpy()
    apart = np.linalg.norm(left - right)
    centre = (left + right) / 2 - (0, BELOW_EYES * apart, 0)
    face = np.linalg.norm(surface.vertices - centre, axis=1) < FACE_RADIUS * apart
    curved = 1 + CURVATURE_GAIN * curvature(surface)
    return curved * (1 + options.face_gain * face)


def curvature(surface: SurfaceMesh) -> np.ndarray:
    """Return the root mean square of the principal curvatures, (V,), scaled to [0, 1].

    1 is the 95th percentile. Source: pymeshlab's discrete curvature (Meyer et al., "Discrete
    differential-geometry operators for triangulated 2-manifolds", 2003).

    Example:
        >>> from skimage.measure import marching_cubes
        >>> at = np.mgrid[-6:7, -6:7, -6:7] / 20
        >>> vertices, faces, _, _ = marching_cubes(np.linalg.norm(at, axis=0), 0.2)
        >>> ball = SurfaceMesh((vertices - 6) / 20, faces.astype(np.int64))
        >>> curved = curvature(ball)
        >>> curved.shape == (len(ball.vertices),), curved.max()
        (True, np.float64(1.0))
    """
    meshes = surface.meshlab()
    meshes.compute_scalar_by_discrete_curvature_per_vertex(curvaturetype="RMS Curvature")
    curvature = np.nan_to_num(meshes.current_mesh().vertex_scalar_array(), posinf=0, neginf=0)
    largest = np.percentile(curvature, 95)
    return np.clip(curvature / largest, 0, 1) if largest > 0 else np.zeros(len(curvature))


def _regaussian(
    avatar: Avatar,
    sources: Tensor,
    samples: SurfacePoints,
    skin: Skin,
    options: ReinitOptions,
    rng: np.random.Generator,
) -> CanonicalGaussians:
    """Make Gaussians on the samples, with opacity and colour of the old ones around them.

    Opacity and colour are means over the K nearest of ``sources`` (M,) int64, the Gaussians of the
    avatar that lie on the surface, weighted by 1 / distance². ``rng`` draws angles and sizes.
    """
    from scipy.spatial import cKDTree

    old, shape = avatar.canonical, avatar.options.seed
    N, dtype = len(samples.points), old.means.dtype
    tensor = lambda array: torch.from_numpy(np.ascontiguousarray(array)).to(dtype)
    K = min(COLOR_NEIGHBOURS, len(sources))
    tree = cKDTree(old.means.detach()[sources].double().numpy())
    distance, nearest = (x.reshape(N, K) for x in tree.query(samples.points, k=K, workers=-1))
    share = 1 / (distance**2 + COINCIDENT)
    share = tensor(share / share.sum(1, keepdims=True))
    nearest = sources[torch.from_numpy(nearest)]

    opacities = (share * old.opacities.detach()[nearest]).sum(1).clamp(0.01, 0.99)
    sh = (share[:, :, None, None] * old.sh.detach()[nearest]).sum(1)
    jitter = options.scale_jitter * tensor(rng.standard_normal((N, 3)))
    if options.random:
        quats, shape = tensor(rng.standard_normal((N, 4))), replace(shape, flatness=1.0)
    else:
        half = tensor(rng.uniform(0, np.pi, N))  # half the angle about the normal
        quats = _spin(disc_quats(tensor(samples.normals)), half)
    means = tensor(samples.points)
    return CanonicalGaussians(
        means=means,
        quats=quats,
        log_scales=disc_log_scales(tensor(samples.spacing), shape) + jitter,
        logit_opacities=torch.logit(opacities),
        sh=sh,
        **skin.bind(means),
    )


def _filler(rig: Rig, depth: float) -> SurfaceMesh:
    """Return the rest body moved inside by ``depth``; fingers, which are thinner, by less."""
    inwards = depth * (1 - 0.75 * finger_weights(rig.weights))
    shrunk = rig.vertices - inwards[:, None] * vertex_normals(rig.vertices, rig.faces)
    return SurfaceMesh(shrunk.double().numpy(), rig.faces.numpy())


def _spin(quats: Tensor, half: Tensor) -> Tensor:
    """Turn frames (N, 4) wxyz about their own z axis by twice ``half`` (N,)."""
    w, x, y, z = quats.unbind(-1)
    c, s = torch.cos(half), torch.sin(half)
    return torch.stack([w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s], -1)
