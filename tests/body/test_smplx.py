"""SMPL-X: Eq. 4 against a reference implementation, and body files."""

import pickle

import numpy as np
import pytest
import torch

from gva_mi.body.body_file import BUILT_IN_BODY, SMPLX
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.core.errors import InputError

F64 = torch.float64


@pytest.fixture
def body(random_file):
    return load_body(random_file, F64)


@pytest.fixture
def person():
    g = torch.Generator().manual_seed(3)
    normal = lambda *size: torch.randn(*size, generator=g, dtype=F64)
    pose = Pose(0.4 * normal(3, 55, 3), normal(3, 3), normal(3, 8))
    return pose, Shape(normal(10)), 0.02 * normal(90, 3)


def test_agrees_with_the_reference_implementation(body, person, random_arrays, reference):
    pose, shape, offsets = person
    posed = body(pose, shape, offsets)
    directions = random_arrays["shapedirs"]
    for t in range(3):
        shaped = random_arrays["v_template"] + directions[..., :10] @ shape.betas.numpy()
        shaped = shaped + directions[..., 10:] @ pose.expression[t].numpy()
        vertices, joints = reference(random_arrays, SMPLX, pose.rotations[t].numpy(),
            pose.transl[t].numpy(), shaped, offsets.numpy())  # fmt: skip
        np.testing.assert_allclose(posed.vertices[t], vertices, atol=1e-12)
        np.testing.assert_allclose(posed.joints[t], joints, atol=1e-12)


def test_gradients_against_differences(body, person):
    pose, shape, offsets = person
    values = (pose.rotations[:1], pose.transl[:1], pose.expression[:1], shape.betas, offsets)
    leaves = [value.clone().requires_grad_() for value in values]

    def run(rotations, transl, expression, betas, offsets):
        posed = body(Pose(rotations, transl, expression), Shape(betas), offsets)
        return posed.vertices, posed.joints

    assert torch.autograd.gradcheck(run, leaves, fast_mode=True)


def test_coefficients_beyond_the_file_must_be_zero(body):
    body(Pose.rest(expressions=20, dtype=F64), Shape(torch.zeros(16, dtype=F64)))
    with pytest.raises(InputError, match="16 betas, but the body file has 10"):
        body.rest(Shape(torch.ones(16, dtype=F64)))


@pytest.mark.parametrize(
    "columns, betas, expressions", [(400, 300, 100), (20, 10, 10), (16, 10, 6), (10, 10, 0)]
)
def test_shapes_are_split_as_in_the_files(random_arrays, tmp_path, columns, betas, expressions):
    directions = np.broadcast_to(np.arange(columns, dtype=np.float32), (90, 3, columns))
    path = tmp_path / "body.npz"
    np.savez(path, **(random_arrays | {"shapedirs": directions}))
    body = load_body(path)
    assert (body.num_betas, body.num_expressions) == (betas, expressions)
    assert body.shape_directions[:, 0].tolist() == list(range(betas))
    assert body.expression_directions[:, 0].tolist() == list(range(betas, betas + expressions))


def test_a_missing_file_is_explained(tmp_path):
    with pytest.raises(InputError, match="no such file.*smpl-x.is.tue.mpg.de.*built-in"):
        load_body(tmp_path / "SMPLX_NEUTRAL.npz")


def test_a_pickled_body_is_the_same_body(tmp_path):
    """Like SMPL's files: sparse regressor, unsigned integers, protocol of Python 2."""
    sparse = pytest.importorskip("scipy.sparse")
    arrays = dict(np.load(BUILT_IN_BODY))
    path = tmp_path / "SMPLX_NEUTRAL.pkl"
    arrays["J_regressor"] = sparse.csc_matrix(arrays["J_regressor"])
    arrays["f"] = arrays["f"].astype(np.uint32)
    path.write_bytes(pickle.dumps(arrays | {"bs_style": "lbs"}, protocol=2))
    found = dict(load_body(path).named_buffers())
    for name, value in load_body().named_buffers():
        assert torch.allclose(value, found[name], atol=1e-6), name


def test_a_pickle_without_a_body_is_named(tmp_path):
    path = tmp_path / "SMPLX_NEUTRAL.pkl"
    path.write_bytes(b"")
    with pytest.raises(InputError, match="SMPLX_NEUTRAL.pkl: damaged.*expected a body in SMPL-X"):
        load_body(path)
    path.write_bytes(pickle.dumps({"v_template": np.zeros((3, 3))}))
    with pytest.raises(InputError, match="SMPLX_NEUTRAL.pkl: key 'f' is missing; found: v_templ"):
        load_body(path)


@pytest.mark.parametrize("key, value, sentence", [
    ("hands_meanr", None, "body.npz: key 'hands_meanr' is missing; found: .*weights"),
    ("f", np.zeros((9, 3)), "'f' must be whole numbers, got float64"),
    ("v_template", np.zeros((90, 3)), "'v_template' is 0 x 0 x 0 metres in size"),
    ("f", np.full((9, 3), 90), "'f' names vertex 90, but there are 90"),
    ("shapedirs", np.full((90, 3, 18), 1e308), r"'shapedirs' holds 1e\+308 at \[0, 0, 0\]"),
    ("f", np.arange(90).reshape(30, 3), "'f' is no surface, 0% of its edges belong to two"),
    ("weights", np.full((90, 55), 0.5), "'weights' must have rows that sum to 1"),
    ("kintree_table", np.zeros((2, 55), int), "'kintree_table' is not the tree"),
    ("weights", np.array([{}]), "'weights': pickled objects"),
])  # fmt: skip
def test_a_wrong_array_is_named(random_arrays, tmp_path, key, value, sentence):
    path = tmp_path / "body.npz"
    changed = random_arrays | {key: value}
    np.savez(path, **{k: v for k, v in changed.items() if v is not None})
    with pytest.raises(InputError, match=sentence):
        load_body(path)
