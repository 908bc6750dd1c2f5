"""Arguments of ``rasterization``: one cloud of Gaussians, seen by two cameras."""

import numpy as np
import pytest
import torch

from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.scene import random_scene

W, H, N = 24, 17, 30


@pytest.fixture
def arguments():
    """Make the arguments by name; all float tensors are leaves."""

    def made(dtype=torch.float64, **kwargs):
        g = random_scene(torch.Generator().manual_seed(3), N, W, H, **kwargs).gaussians
        views = [look_at((0.6, 0.4, 2.9), (0.0, 0.0, 0.0)),
            look_at((-0.9, 0.2, 2.5), (0.0, 0.1, 0.0))]  # fmt: skip
        K = np.array([[40.0, 0, 12.3], [0, 42, 8.1], [0, 0, 1]])
        out = {"means": g.means, "quats": g.quats, "scales": g.scales, "opacities": g.opacities}
        out |= {"colors": g.colors if g.sh is None else g.sh, "viewmats": np.stack(views)}
        out |= {"Ks": np.stack([K, K + [[3, 0, 0], [0, 2, 0], [0, 0, 0]]])}
        out = {k: torch.as_tensor(v).to(dtype).clone().requires_grad_() for k, v in out.items()}
        return out | {"width": W, "height": H}

    return made


@pytest.fixture
def camera_of():
    """Make the camera that some arguments describe."""

    def made(a, c, model="pinhole"):
        K, T = (a[name][c].detach().double().numpy() for name in ("Ks", "viewmats"))
        return Camera.from_matrices(K, T, a["width"], a["height"], model)

    return made


@pytest.fixture
def gradients():
    """Return a loss's gradients by argument name; None if it does not depend on an argument."""

    def found(loss, a):
        leaves = {k: v for k, v in a.items() if isinstance(v, torch.Tensor)}
        grads = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
        return dict(zip(leaves, grads, strict=True))

    return found
