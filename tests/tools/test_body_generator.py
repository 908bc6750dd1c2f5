"""The generator of the built-in body makes the file that the package holds."""

import numpy as np
import pytest
import torch

from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import load_body
from tools.body_generator import generate
from tools.body_generator.anatomy import joint_positions


def test_the_file_has_the_joints_of_the_anatomy():
    rest = load_body(dtype=torch.float64).rest(Shape(torch.zeros(10, dtype=torch.float64)))
    np.testing.assert_allclose(rest.joints.numpy(), joint_positions(), atol=1e-6)


@pytest.mark.slow
def test_the_generator_makes_the_file():
    """To the bit, but for the regressor: its pseudo-inverse rounds as LAPACK does on a machine."""
    made = generate()
    with np.load(BUILT_IN_BODY) as file:
        assert set(file.files) == set(made)
        for key in set(made) - {"J_regressor"}:
            np.testing.assert_array_equal(file[key], made[key], err_msg=key)
        found, stored = made["J_regressor"], file["J_regressor"]
    np.testing.assert_array_equal(found != 0, stored != 0)
    np.testing.assert_allclose(found, stored, rtol=0, atol=np.finfo(np.float32).eps)
