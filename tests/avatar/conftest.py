"""A body small enough for tests: an ellipsoid of 642 vertices on SMPL-X's 55 joints."""

import numpy as np
import pytest
import torch
import trimesh

from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
from gva_mi.avatar.residual import ResidualOptions
from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel

WITH_RESIDUAL = AvatarOptions(residual=ResidualOptions(enabled=True))
RADII = np.array([0.8, 0.9, 0.3])  # metres


def small_body(dtype=torch.float32):
    """Skinned softly to joints around its middle; rough shapes, some pose correctives."""
    rng = np.random.default_rng(0)
    sphere = trimesh.creation.icosphere(subdivisions=3)
    vertices, V, J = sphere.vertices * RADII, len(sphere.vertices), len(JOINTS)
    regressor = np.zeros((J, V))
    np.put_along_axis(regressor, np.argsort(rng.random((J, V)), axis=1)[:, :4], 0.25, axis=1)
    distance = np.linalg.norm(vertices[:, None] - regressor @ vertices, axis=2)
    weights = np.exp(-((distance / 0.15) ** 2)) + 1e-12
    bulges = np.zeros((V, 3, 486))
    bulges[..., 3:486:40] = 0.01 * rng.normal(size=(V, 3, 13))
    arrays = {
        "v_template": vertices,
        "f": sphere.faces,
        "J_regressor": regressor,
        "weights": weights / weights.sum(1, keepdims=True),
        "shapedirs": 0.01 * rng.normal(size=(V, 3, 20)),  # ten betas, ten expressions
        "posedirs": bulges,
        "hands_meanl": np.zeros(45),
        "hands_meanr": np.zeros(45),
    }
    return BodyModel(arrays, dtype)


@pytest.fixture(scope="session")
def body():
    return small_body()


@pytest.fixture
def random_pose():
    """``random_pose(seed)``: one frame, every joint turned, root and translation included."""

    def draw(seed, angle=0.3, dtype=torch.float32):
        generator = torch.Generator().manual_seed(seed)
        normal = lambda *size: torch.randn(*size, generator=generator).to(dtype)
        return Pose(angle * normal(1, 55, 3), normal(1, 3), torch.zeros(1, 10, dtype=dtype))

    return draw


@pytest.fixture
def make_avatar():
    """``make_avatar(options)``: on the small body; residual and linear colours are not zero."""

    def make(options=WITH_RESIDUAL, dtype=torch.float32, trained=True):  # noqa: B008 (frozen)
        generator = torch.Generator().manual_seed(1)
        shape = Shape(torch.linspace(-1, 1, 10, dtype=dtype))
        avatar = seed_avatar(small_body(dtype), shape, None, options, generator)
        if trained:
            with torch.no_grad():
                avatar.residual.offset.weight.normal_(generator=generator)
                avatar.canonical.sh[:, 1:].normal_(std=0.2, generator=generator)
        return avatar

    return make
