import gva_mi  # noqa: F401, I001  (first: it chooses the libLLVM)

import numpy as np
import pytest
import torch

from gva_mi.body import Pose, load_body
from gva_mi.body.hands import with_hands
from gva_mi.errors import InputError

F64 = torch.float64


@pytest.fixture
def spaces(random_file):
    return load_body(random_file, F64).hand_spaces


@pytest.fixture
def coefficients():
    return torch.randn(4, 45, generator=torch.Generator().manual_seed(1), dtype=F64)


def test_zero_is_the_mean_hand_or_the_flat_one(spaces, random_arrays):
    zero = torch.zeros(2, 6, dtype=F64)
    for space, side in zip(spaces, "lr", strict=True):
        np.testing.assert_array_equal(space.pose(zero)[1], random_arrays[f"hands_mean{side}"])
        assert (space.pose(zero, flat_is_zero=True) == 0).all()


def test_a_coefficient_moves_along_its_component(spaces, random_arrays):
    one = torch.zeros(1, 6, dtype=F64)
    one[0, 4] = 2.0
    for space, side in zip(spaces, "lr", strict=True):
        moved = space.pose(one) - space.mean
        np.testing.assert_allclose(moved[0], 2 * random_arrays[f"hands_components{side}"][4])


@pytest.mark.parametrize("flat_is_zero", [False, True])
@pytest.mark.parametrize("count", [1, 6, 45])
def test_out_and_in_gives_the_coefficients_back(spaces, coefficients, count, flat_is_zero):
    for space in spaces:
        pose = space.pose(coefficients[:, :count], flat_is_zero=flat_is_zero)
        back = space.coefficients(pose, count, flat_is_zero=flat_is_zero)
        torch.testing.assert_close(back, coefficients[:, :count], rtol=0, atol=1e-10)


def test_all_components_hold_every_hand(spaces, coefficients):
    left = spaces[0]
    torch.testing.assert_close(left.pose(left.coefficients(coefficients, 45)), coefficients)


def test_few_components_come_as_close_as_they_can(spaces, coefficients):
    left = spaces[0]
    rest = coefficients - left.pose(left.coefficients(coefficients, 12))
    torch.testing.assert_close(rest @ left.components[:12].T, torch.zeros(4, 12, dtype=F64))


def test_more_coefficients_than_the_file_has_are_refused(spaces):
    with pytest.raises(InputError, match="46 PCA coefficients, but the body file has 45"):
        spaces[0].pose(torch.zeros(1, 46, dtype=F64))


def test_a_file_without_components_says_so(random_arrays, tmp_path):
    path = tmp_path / "body.npz"
    np.savez(path, **{k: v for k, v in random_arrays.items() if "components" not in k})
    left, _ = load_body(path).hand_spaces
    with pytest.raises(InputError, match="0 components.*'hands_componentsl'"):
        left.pose(torch.zeros(1, 6))


def test_new_hands_leave_the_rest_of_the_pose(coefficients):
    pose = Pose.rest(4, dtype=F64)
    changed = with_hands(pose, coefficients, -coefficients)
    assert torch.equal(changed.rotations[:, 25:40].flatten(1), coefficients)
    assert torch.equal(changed.rotations[:, 40:].flatten(1), -coefficients)
    assert torch.equal(changed.rotations[:, :25], pose.rotations[:, :25])
