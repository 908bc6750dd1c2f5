"""A small random body in SMPL-X's format without zeros, so that every term of Eq. 4 matters."""

from pathlib import Path

import numpy as np
import pytest

from gva_mi.body.pose import JOINTS, PARENTS

VERTICES = 90


@pytest.fixture(scope="session")
def random_arrays() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(7)
    a, b, c, d = ((np.arange(VERTICES) + k) % VERTICES for k in (0, 1, 9, 10))
    weights = rng.uniform(size=(VERTICES, 55)) ** 12
    regressor = rng.uniform(size=(55, VERTICES))
    parents = np.array([4294967295, *PARENTS[1:]], np.int64)
    return {
        "v_template": rng.normal(size=(VERTICES, 3)),
        "f": np.stack([a, b, d, a, d, c], axis=1).reshape(-1, 3).astype(np.uint32),  # a torus
        "shapedirs": 0.05 * rng.normal(size=(VERTICES, 3, 18)),
        "posedirs": 0.02 * rng.normal(size=(VERTICES, 3, 486)),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.stack([parents, np.arange(55)]),
        "hands_meanl": 0.1 * rng.normal(size=45),
        "hands_meanr": 0.1 * rng.normal(size=45),
        "hands_componentsl": np.linalg.qr(rng.normal(size=(45, 45)))[0],
        "hands_componentsr": np.linalg.qr(rng.normal(size=(45, 45)))[0],
        "joint_names": np.array(JOINTS),
    }


@pytest.fixture
def random_file(random_arrays, tmp_path) -> Path:
    path = tmp_path / "body.npz"
    np.savez(path, **random_arrays)
    return path
