"""Small random bodies without zeros, so that every term of Eq. 4 matters, and their reference."""

from pathlib import Path

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.body_file import SMPL, SMPLX, BodyFormat
from gva_mi.body.pose import JOINTS

VERTICES = 90


def _random_body(form: BodyFormat, directions: int, seed: int = 7) -> dict[str, np.ndarray]:
    """Return the arrays of a random body file of a format."""
    rng, joints = np.random.default_rng(seed), len(form.joints)
    a, b, c, d = ((np.arange(VERTICES) + k) % VERTICES for k in (0, 1, 9, 10))
    weights = rng.uniform(size=(VERTICES, joints)) ** 12
    regressor = rng.uniform(size=(joints, VERTICES))
    parents = np.array([4294967295, *form.parents[1:]], np.int64)
    arrays = {
        "v_template": rng.normal(size=(VERTICES, 3)),
        "f": np.stack([a, b, d, a, d, c], axis=1).reshape(-1, 3).astype(np.uint32),  # a torus
        "shapedirs": 0.05 * rng.normal(size=(VERTICES, 3, directions)),
        "posedirs": 0.02 * rng.normal(size=(VERTICES, 3, 9 * (joints - 1))),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.stack([parents, np.arange(joints)]),
    }
    hands = {f"hands_mean{side}": 0.1 * rng.normal(size=45) for side in "lr"}
    return arrays if form is SMPL else arrays | hands


def _reference(arrays, form, rotations, transl, shaped, offsets=0.0):
    """Eq. 4 for one frame, joint by joint, from rotations (J, 3) and the shaped vertices (V, 3)."""
    joints = arrays["J_regressor"] @ shaped
    R = roma.rotvec_to_rotmat(torch.from_numpy(rotations)).numpy()
    rest = shaped + offsets + arrays["posedirs"] @ (R[1:] - np.eye(3)).ravel()
    G, vertices = [], np.zeros_like(rest)
    for j, parent in enumerate(form.parents):
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = R[j], joints[j] - (joints[parent] if j else 0)
        G.append(G[parent] @ local if j else local)
        moved = (rest - joints[j]) @ G[j][:3, :3].T + G[j][:3, 3]
        vertices += arrays["weights"][:, j, None] * moved
    return vertices + transl, np.stack([g[:3, 3] for g in G]) + transl


@pytest.fixture(scope="session")
def random_body():
    return _random_body


@pytest.fixture(scope="session")
def reference():
    return _reference


@pytest.fixture(scope="session")
def random_arrays() -> dict[str, np.ndarray]:
    return _random_body(SMPLX, 18) | {"joint_names": np.array(JOINTS)}


@pytest.fixture
def random_file(random_arrays, tmp_path) -> Path:
    path = tmp_path / "body.npz"
    np.savez(path, **random_arrays)
    return path
