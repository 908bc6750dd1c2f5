"""Spacing and bias are what their equations say, on surfaces whose answer is known."""

import json

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from gva_mi.avatar.avatar import seed_avatar
from gva_mi.body.pose import Shape
from gva_mi.evaluate.surface import (
    PARTS,
    SURFACE_BAND,
    TrueSurface,
    bias_mm,
    spacing,
    stray_mm,
    surface_figures,
)
from gva_mi.subject.fingerprint import fingerprint
from gva_mi.subject.folder import SYNTH
from gva_mi.synthetic import SynthOptions, remake_subject


@pytest.fixture
def square():
    """One square metre of the plane z = 0, with hair where x > 0.5."""
    side = (np.arange(200) + 0.5) / 200
    points = np.stack([*np.meshgrid(side, side, indexing="ij"), np.zeros((200, 200))], -1)
    points = points.reshape(-1, 3)
    right = points[:, 0] > 0.5
    part = np.where(right, PARTS.index("hair"), PARTS.index("rest"))
    beneath = points - (0, 0, 0.1)  # an inner side
    everywhere = np.concatenate([points, beneath])
    return TrueSurface(points, np.tile([0.0, 0, 1], (len(points), 1)), part, everywhere)


def lattice(count, height=0.0):
    side = (np.arange(count) + 0.5) / count
    x, y = np.meshgrid(side, side, indexing="ij")
    return np.stack([x, y, np.full_like(x, height)], -1).reshape(-1, 3)


def test_spacing_is_0_on_a_lattice_and_0_52_for_random_points(square):
    assert spacing(lattice(50), square) == pytest.approx(0)
    scattered = np.random.default_rng(0).random((40_000, 3)) * (1, 1, 0)
    assert spacing(scattered, square) == pytest.approx(0.523, abs=0.01)


def test_floaters_do_not_count_and_few_gaussians_have_no_figure(square):
    floaters = np.random.default_rng(3).random((300, 3)) + (0, 0, 2 * SURFACE_BAND)
    assert spacing(np.vstack([lattice(50), floaters]), square) == pytest.approx(0)
    assert spacing(lattice(5), square) is None


def test_bias_is_the_distance_to_a_surface_that_gaussians_do_not_reach(square):
    """Gaussians 30 mm below the hair: 30 mm but for the spacing, sqrt(30² + 5²) at most."""
    low = lattice(100)
    low[low[:, 0] > 0.5, 2] = -0.030
    found = bias_mm(low, square)
    assert set(found) == {"hair", "rest"}
    assert found["rest"] < 10 / np.sqrt(2) and 30 < found["hair"] < 31


def test_stray_is_the_distance_of_floaters(square):
    lying = square.points[:300] + np.array([0, 0, 1e-4])
    assert stray_mm(lying, square) == pytest.approx(0.1, rel=1e-6)
    away = np.concatenate([lying, square.points[:10] + np.array([0, 0, 0.2])])
    assert stray_mm(away, square) == pytest.approx(200, rel=0.05)
    within = np.concatenate([lying, square.everywhere[-10:]])
    assert stray_mm(within, square) == pytest.approx(0.1, rel=1e-6)


def test_a_folder_that_synth_did_not_make_has_no_figures(tmp_path, known, body):
    assert not list(surface_figures(tmp_path, known, tmp_path, body))


def drawn(folder, body, options):
    """What ``synth`` says of a person, without any picture."""
    about = {"options": options.recorded(), "body": fingerprint(body)}
    (folder / SYNTH).write_text(json.dumps(about))
    return folder


@pytest.fixture(scope="module")
def bare(tmp_path_factory, body):
    options = SynthOptions(seed=3, bare=True)
    return drawn(tmp_path_factory.mktemp("bare"), body, options)


def test_the_surface_of_a_bare_subject_is_transferred_to_the_avatars_body(bare, body):
    """Carried over to an avatar of other betas, it lies on that avatar's own rest surface."""
    betas = torch.tensor([2.0, -1.5, *[0.0] * 8])
    avatar = seed_avatar(body, Shape(betas))
    truth = TrueSurface.of(bare, body, avatar.rig)
    assert set(truth.part) == {PARTS.index("rest")}
    rig = avatar.rig
    mesh = trimesh.Trimesh(rig.vertices.numpy(), rig.faces.numpy(), process=False)
    assert trimesh.proximity.closest_point_naive(mesh, truth.points[::200])[1].max() < 1e-5
    person, _ = remake_subject(bare, body)
    own = body.rest(person.shape).vertices.detach().numpy()
    assert np.linalg.norm(own - rig.vertices.numpy(), axis=1).max() > 0.01


@pytest.mark.slow
def test_hair_is_on_the_head_and_shorts_have_inner_sides(body, tmp_path):
    folder = drawn(tmp_path, body, SynthOptions(subject="edgar"))
    truth = TrueSurface.of(folder, body, seed_avatar(body, Shape(torch.zeros(10))).rig)
    hair = truth.points[truth.part == PARTS.index("hair")]
    assert len(hair) > 200 and hair[:, 1].min() > truth.points[:, 1].max() - 0.35
    hidden = cKDTree(truth.points).query(truth.everywhere)[0] > 0.03
    assert 0.02 < hidden.mean() < 0.5
