"""SMPL and SMPL+H lifted to SMPL-X's joints."""

import numpy as np
import pytest
import torch

from gva_mi.body.body_file import SMPL, SMPLH
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.core.errors import InputError

F64 = torch.float64
PARENTS_OF_SMPL = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)


def load(arrays, tmp_path):
    path = tmp_path / "older.npz"
    np.savez(path, **arrays)
    return load_body(path, F64)


def test_smpl_has_the_published_tree():
    assert SMPL.parents == PARENTS_OF_SMPL
    assert SMPLH.parents[:22] == PARENTS_OF_SMPL[:22]
    assert SMPLH.parents[22:] == (
        20, 22, 23, 20, 25, 26, 20, 28, 29, 20, 31, 32, 20, 34, 35,
        21, 37, 38, 21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50,
    )  # fmt: skip


@pytest.mark.parametrize("form", [SMPL, SMPLH], ids=["SMPL", "SMPL+H"])
def test_a_lifted_body_is_exactly_the_old_one(form, random_body, reference, tmp_path):
    arrays, rng = random_body(form, 16), np.random.default_rng(2)
    poses, transl = 0.5 * rng.normal(size=(2, len(form.joints), 3)), rng.normal(size=(2, 3))
    betas = rng.normal(size=16)
    body = load(arrays, tmp_path)
    assert (body.num_betas, body.num_expressions) == (16, 0)
    rotations = torch.zeros(2, 55, 3, dtype=F64)
    rotations[:, form.joints] = torch.from_numpy(poses)
    pose = Pose(rotations, torch.from_numpy(transl), torch.zeros(2, 0, dtype=F64))
    posed = body(pose, Shape(torch.from_numpy(betas)))
    for t in range(2):
        shaped = arrays["v_template"] + arrays["shapedirs"] @ betas
        vertices, joints = reference(arrays, form, poses[t], transl[t], shaped)
        np.testing.assert_allclose(posed.vertices[t], vertices, atol=1e-12)
        np.testing.assert_allclose(posed.joints[t, list(form.joints)], joints, atol=1e-12)


def test_an_unknown_tree_is_named(random_body, tmp_path):
    arrays = random_body(SMPL, 16) | {"kintree_table": np.zeros((2, 30), np.int64)}
    with pytest.raises(InputError, match=r"one of \(2, 24\) SMPL.*found \(2, 30\)"):
        load(arrays, tmp_path)
