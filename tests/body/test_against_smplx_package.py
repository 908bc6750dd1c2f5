"""Opt-in: the same numbers as the package ``smplx``, where someone has installed it.

Its licence is non-commercial, so that it is no dependency, not even of the tests. The file is
random, of the same format.
"""

import gva_mi  # noqa: F401, I001  (first: it chooses the libLLVM)

import numpy as np
import pytest
import torch

from gva_mi.body import Pose, Shape, load_body

smplx = pytest.importorskip("smplx")  # noqa: TID251

TOLERANCE = {torch.float32: 1e-6, torch.float64: 1e-8}  # metres
FRAMES = 3
INPUTS = ("rotations", "transl", "expression", "betas")


@pytest.fixture(params=[20, 400], ids=["1.0", "1.1"])
def directions(request):
    return request.param


@pytest.fixture
def both(random_arrays, tmp_path, directions, monkeypatch):
    """The file loaded by either, as a function of the precision."""
    # It picks toes and finger tips by number, far beyond our few vertices.
    numbers = smplx.vertex_ids.vertex_ids
    monkeypatch.setitem(numbers, "smplx", dict.fromkeys(numbers["smplx"], 0))
    rng = np.random.default_rng(4)
    vertices = len(random_arrays["v_template"])
    path = tmp_path / "SMPLX_NEUTRAL.npz"
    sizes = {  # of a person: float32 is compared in metres
        "v_template": 0.3 * random_arrays["v_template"], "posedirs": 0.3 * random_arrays["posedirs"]
    }  # fmt: skip
    shapedirs = 0.01 * rng.normal(size=(vertices, 3, directions))
    landmarks = {
        "lmk_faces_idx": rng.integers(0, 150, 51), "lmk_bary_coords": np.full((51, 3), 1 / 3),
        "dynamic_lmk_faces_idx": np.zeros((79, 17), np.int64),
        "dynamic_lmk_bary_coords": np.full((79, 17, 3), 1 / 3),
    }  # fmt: skip
    arrays = random_arrays | sizes | landmarks | {"shapedirs": shapedirs}
    # The package rounds what it reads to float32, so that the file must hold such numbers.
    rounded = {k: a.astype(np.float32) if a.dtype == np.float64 else a for k, a in arrays.items()}
    # It adds the translation after skinning; rows that sum to 1 to the bit make that the same.
    steps = np.floor(random_arrays["weights"] * 2**16)
    steps[np.arange(vertices), steps.argmax(1)] += 2**16 - steps.sum(1)
    np.savez(path, **(rounded | {"weights": (steps / 2**16).astype(np.float32)}))

    def load(dtype):
        theirs = smplx.SMPLXLayer(
            str(path),
            num_betas=10,
            num_expression_coeffs=10,
            dtype=dtype,
            ext="npz",
        )
        return load_body(path, dtype), theirs

    return load


def person(dtype):
    g = torch.Generator().manual_seed(3)
    normal = lambda *size: torch.randn(*size, generator=g, dtype=torch.float64).to(dtype)
    return 0.3 * normal(FRAMES, 55, 3), 0.3 * normal(FRAMES, 3), normal(FRAMES, 10), normal(10)


def ours(body, rotations, transl, psi, betas):
    posed = body(Pose(rotations, transl, psi), Shape(betas))
    return posed.vertices, posed.joints


def theirs(layer, rotations, transl, psi, betas):
    import roma

    R = roma.rotvec_to_rotmat(rotations)
    posed = layer(
        betas=betas.expand(FRAMES, -1), expression=psi, transl=transl, global_orient=R[:, :1],
        body_pose=R[:, 1:22], jaw_pose=R[:, 22:23], leye_pose=R[:, 23:24], reye_pose=R[:, 24:25],
        left_hand_pose=R[:, 25:40], right_hand_pose=R[:, 40:],
    )  # fmt: skip
    return posed.vertices, posed.joints[:, :55]


@pytest.mark.parametrize("dtype", TOLERANCE, ids=str)
def test_vertices_and_joints_agree(both, dtype):
    body, layer = both(dtype)
    for x, y in zip(ours(body, *person(dtype)), theirs(layer, *person(dtype)), strict=True):
        torch.testing.assert_close(x, y, rtol=0, atol=TOLERANCE[dtype])


@pytest.mark.parametrize("k, name", list(enumerate(INPUTS)))
def test_gradients_agree(both, k, name):
    body, layer = both(torch.float64)
    found = []
    for run in (lambda *x: ours(body, *x), lambda *x: theirs(layer, *x)):
        inputs = [x.requires_grad_() for x in person(torch.float64)]
        vertices, joints = run(*inputs)
        loss = vertices.sin().sum() + joints.square().sum()
        found.append(torch.autograd.grad(loss, inputs[k])[0])
    assert (found[0] - found[1]).norm() <= 1e-5 * found[1].norm()
