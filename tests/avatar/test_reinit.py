"""Re-initialisation: from a noisy cloud with floaters back to an even layer on the surface."""

import copy

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import CanonicalGaussians, SeedOptions
from gva_mi.avatar.reinit import ReinitOptions, reinitialise
from gva_mi.body.pose import JOINTS, Shape
from gva_mi.core.errors import InputError
from gva_mi.splat.kernels.sh import C0

# For 8,000 points, not 20,000, on a large body without a face.
COARSE = ReinitOptions(alpha=0.05, filler_depth=0.04, face_gain=0.0)
RED, BLUE, MAGENTA = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9), (0.9, 0.1, 0.9)
LIMBS = [
    JOINTS.index(f"{side}_{name}")
    for side in ("left", "right")
    for name in ("hip", "knee", "ankle", "foot", "shoulder", "elbow", "wrist")
]
FLOATERS = np.array([[1.5, 0, 0], [0, 1.6, 0.2], [-1, -1, 0.9], [0.5, 0.3, 1.2]])


def avatar_of(body, points, colors, opacities=None):
    """An avatar whose Gaussians lie at given points, with ragged rotations and sizes."""
    avatar = seed_avatar(body, Shape(torch.zeros(10)), None, AvatarOptions())
    rng = np.random.default_rng(1)
    tensor = lambda array: torch.tensor(np.asarray(array), dtype=torch.float32)
    N, points = len(points), tensor(points)
    sh = torch.zeros(N, 4, 3)
    sh[:, 0] = (tensor(colors) - 0.5) / C0
    avatar.canonical = CanonicalGaussians(means=points, quats=tensor(rng.normal(size=(N, 4))),
        log_scales=tensor(rng.uniform(0.005, 0.05, (N, 3))).log(),
        logit_opacities=torch.logit(tensor(np.full(N, 0.8) if opacities is None else opacities)),
        sh=sh, **avatar.skin.bind(points))  # fmt: skip
    return avatar


def noisy_cloud(body, count=8000, noise=0.005, out=0.0):
    """Points along the surface, ``out`` metres outside: red on the left, blue on the right."""
    mesh = trimesh.Trimesh(body.v_template.numpy(), body.faces.numpy(), process=False)
    points, face = trimesh.sample.sample_surface(mesh, count, seed=0)
    shift = out + noise * np.random.default_rng(0).normal(size=(count, 1))
    colors = np.where(points[:, :1] < 0, RED, BLUE)
    share = trimesh.triangles.points_to_barycentric(mesh.triangles[face], points)
    normals = (mesh.vertex_normals[mesh.faces[face]] * share[:, :, None]).sum(1)
    return points + shift * normals, colors


def distance_to(body, points):
    """Distance to the body's surface, to 2 mm on the small body, by dense samples of it."""
    return cKDTree(noisy_cloud(body, 200_000, noise=0)[0]).query(points)[0]


@pytest.fixture(scope="module")
def plain_body(body):
    """The small body without fingers and limbs: as an egg, it has none to be spread."""
    body = copy.deepcopy(body)
    body.weights[:, 25:] = body.weights[:, LIMBS] = 0
    body.weights.div_(body.weights.sum(1, keepdim=True))
    return body


@pytest.fixture(scope="module")
def result(plain_body):
    """A noisy cloud with floaters, re-initialised."""
    points, colors = noisy_cloud(plain_body)
    points = np.vstack([points, FLOATERS])
    colors = np.vstack([colors, [MAGENTA] * len(FLOATERS)])
    avatar = avatar_of(plain_body, points, colors)
    return avatar, reinitialise(avatar, COARSE, torch.Generator().manual_seed(0))


def test_colors_and_opacities_are_inherited(result):
    G = result[1].canonical
    colors, x = G.sh[:, 0].detach() * C0 + 0.5, G.means[:, 0]
    assert torch.allclose(colors[x < -0.15], torch.tensor(RED), atol=1e-5)
    assert torch.allclose(colors[x > 0.15], torch.tensor(BLUE), atol=1e-5)
    assert torch.allclose(G.opacities, torch.tensor(0.8), atol=1e-5)


def test_the_same_seed_gives_the_same_bits(plain_body):
    avatar = avatar_of(plain_body, *noisy_cloud(plain_body, 1000))
    runs = [
        reinitialise(avatar, COARSE, torch.Generator().manual_seed(seed)).canonical.state_dict()
        for seed in (5, 5, 6)
    ]
    assert all(torch.equal(runs[0][name], runs[1][name]) for name in runs[0])
    assert not torch.equal(runs[0]["means"][:100], runs[2]["means"][:100])


def test_a_hole_does_not_let_the_surface_inside(plain_body):
    points, colors = noisy_cloud(plain_body)
    kept = np.linalg.norm(points - [0, 0, 0.3], axis=1) > 0.2
    surface = reinitialise(avatar_of(plain_body, points[kept], colors[kept]), COARSE).surface
    volume = trimesh.Trimesh(surface.vertices, surface.faces, process=False).volume
    assert volume == pytest.approx(4 / 3 * np.pi * 0.8 * 0.9 * 0.3, rel=0.06)


def test_fingers_follow_the_body(plain_body):
    """Where skinning says finger, Gaussians lie on the body, whatever the cloud says."""
    body = copy.deepcopy(plain_body)
    finger = body.v_template[:, 0] > 0.5
    body.weights[finger] = torch.nn.functional.one_hot(torch.tensor(30), 55).float()
    points, colors = noisy_cloud(body, out=0.06)
    G = reinitialise(avatar_of(body, points, colors), COARSE).canonical
    distance = distance_to(body, G.means.detach().numpy())
    on_finger = G.weights[:, 30].numpy() > 0.5
    assert on_finger.any() and np.percentile(distance[on_finger], 80) < 0.01
    assert np.median(distance[~on_finger]) > 0.045


def test_too_few_opaque_gaussians_are_refused(plain_body):
    points, colors = noisy_cloud(plain_body, 100)
    avatar = avatar_of(plain_body, points, colors, np.full(100, 0.1))
    assert reinitialise(avatar) is None
    with pytest.raises(ValueError, match="alpha must be from 0.004 to 1"):
        ReinitOptions(alpha=0.001)
    for options in (ReinitOptions, SeedOptions):  # one Gaussian has no neighbours, and no size
        with pytest.raises(InputError, match="count must be 0, or at least 100, got 1$"):
            options(count=1)


def test_an_even_layer_of_discs_replaces_the_cloud_without_its_floaters(result):
    before, after = (avatar.canonical for avatar in result)
    means = after.means.detach()
    assert cKDTree(FLOATERS).query(means.numpy())[0].min() > 0.2
    assert len(after) == pytest.approx(len(before), rel=0.05)
    spread = []
    for points in (before.means.detach().numpy(), means.numpy()):
        nearest = cKDTree(points).query(points, k=2)[0][:, 1]
        spread.append(nearest.std() / nearest.mean())
    assert spread[0] > 0.5 > 0.25 > spread[1]
    assert (after.scales.argmin(1) == 2).all()
    for name, value in result[1].skin.bind(after.means).items():
        assert torch.equal(getattr(after, name), value), name
