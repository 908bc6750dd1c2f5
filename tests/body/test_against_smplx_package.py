"""Opt-in: the numbers of the package ``smplx``, where it is installed.

Its licence is non-commercial, so nothing depends on it. The body file is random.
"""

import numpy as np
import pytest
import roma
import torch

from gva_mi.body import Pose, Shape, load_body

smplx = pytest.importorskip("smplx")  # noqa: TID251
F64 = torch.float64


@pytest.mark.slow
@pytest.mark.parametrize("directions", [20, 400], ids=["1.0", "1.1"])
def test_vertices_joints_and_gradients_agree(random_arrays, tmp_path, directions, monkeypatch):
    numbers = smplx.vertex_ids.vertex_ids  # of toes and finger tips, far beyond our few vertices
    monkeypatch.setitem(numbers, "smplx", dict.fromkeys(numbers["smplx"], 0))
    rng, vertices = np.random.default_rng(4), len(random_arrays["v_template"])
    # smplx adds the translation after skinning: the same if weights sum to 1 to the bit.
    steps = np.floor(random_arrays["weights"] * 2**16)
    steps[np.arange(vertices), steps.argmax(1)] += 2**16 - steps.sum(1)
    arrays = random_arrays | {
        "shapedirs": 0.01 * rng.normal(size=(vertices, 3, directions)), "weights": steps / 2**16,
        "lmk_faces_idx": rng.integers(0, 150, 51), "lmk_bary_coords": np.full((51, 3), 1 / 3),
        "dynamic_lmk_faces_idx": np.zeros((79, 17), np.int64),
        "dynamic_lmk_bary_coords": np.full((79, 17, 3), 1 / 3),
    }  # fmt: skip
    rounded = {k: a.astype(np.float32) if a.dtype == np.float64 else a for k, a in arrays.items()}
    path = tmp_path / "SMPLX_NEUTRAL.npz"
    np.savez(path, **rounded)  # smplx rounds what it reads to float32
    layer = smplx.SMPLXLayer(
        str(path), num_betas=10, num_expression_coeffs=10, dtype=F64, ext="npz"
    )  # fmt: skip
    g = torch.Generator().manual_seed(3)
    normal = lambda *size: 0.3 * torch.randn(*size, generator=g, dtype=F64)
    inputs = [
        x.requires_grad_() for x in (normal(3, 55, 3), normal(3, 3), normal(3, 10), normal(10))
    ]
    rotations, transl, psi, betas = inputs
    ours = load_body(path, F64)(Pose(rotations, transl, psi), Shape(betas))
    R = roma.rotvec_to_rotmat(rotations)
    theirs = layer(
        betas=betas.expand(3, -1), expression=psi, transl=transl, global_orient=R[:, :1],
        body_pose=R[:, 1:22], jaw_pose=R[:, 22:23], leye_pose=R[:, 23:24], reye_pose=R[:, 24:25],
        left_hand_pose=R[:, 25:40], right_hand_pose=R[:, 40:],
    )  # fmt: skip
    torch.testing.assert_close(ours.vertices, theirs.vertices, rtol=0, atol=1e-7)  # metres
    torch.testing.assert_close(ours.joints, theirs.joints[:, :55], rtol=0, atol=1e-7)
    loss = lambda v, j: v.sin().sum() + j.square().sum()
    found = torch.autograd.grad(loss(ours.vertices, ours.joints), inputs)
    wanted = torch.autograd.grad(loss(theirs.vertices, theirs.joints[:, :55]), inputs)
    for x, y in zip(found, wanted, strict=True):
        assert (x - y).norm() <= 1e-5 * y.norm()
