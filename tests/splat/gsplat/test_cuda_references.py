"""``rasterization`` against the numbers of gsplat 1.5.3's own CUDA kernels.

gsplat computes in float32: each bound below allows for its roundings. The bounds hold for our
float32 and float64 alike, because most of each difference is gsplat's. ``cuda_references.npz`` was
made on an H100 with ``NO_FAST_MATH=1``, gsplat's own switch; only numbers are stored:

=============================  =====================================================================
``cases``                      JSON: the scene and the arguments of each case, and who made the file
``scene/NAME/ARRAY``           the inputs, float32
``case/NAME/weights``          (..., C, H, W, D+1) int8: the loss is the sum of colours and alphas
                               times weights / 32; 0 in pixels at a cut-off
``case/NAME/loss``             the loss, summed in float64
``case/NAME/pixels``           (P, D+1) colours and alpha of every eleventh pixel of all pictures
``case/NAME/grad/ARRAY``       the loss's gradient with respect to an input, and ``means2d``
``case/NAME/meta/ARRAY``       of ``meta``: rows where ``radii`` are 0 hold 0, gsplat leaves them
                               uninitialised
=============================  =====================================================================
"""

import json
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gva_mi.splat import rasterization

FILE = np.load(Path(__file__).with_name("cuda_references.npz"))
ABOUT = json.loads(str(FILE["cases"]))
ROUNDING = 2.0**-24
PIXELS = 3e-5  # of a colour, an alpha, a depth: gsplat rounds a mean at 60 px to 4e-6 px
GRADIENT = 5e-5  # of a gradient's norm: a needle's determinant has 800 times the rounding of C
# gsplat takes a pixel's last T from 1 - alpha, where alpha is rounded to 3e-8. Where T is 1e-4,
# the weights of all Gaussians in front are wrong by up to 3e-4.
OPAQUE = 3e-4


@cache
def stored(folder):
    """Read the arrays of a scene or of a case, by name."""
    return {
        name.removeprefix(f"{folder}/"): FILE[name]
        for name in FILE.files
        if name.startswith(f"{folder}/")
    }


@cache
def drawn(case, dtype):
    """Run a case as its file says, and its loss backward."""
    scene, arguments = ABOUT["cases"][case]
    given = {k: torch.tensor(v, dtype=dtype) for k, v in stored(f"scene/{scene}").items()}
    leaves = {k: v.requires_grad_() for k, v in given.items() if k not in {*arguments, "Ks"}}
    absent = {} if "quats" in given else {"quats": None, "scales": None}
    width, height = ABOUT["size"]
    colors, alphas, meta = rasterization(
        **{**given, **absent, **arguments}, width=width, height=height
    )
    meta["means2d"].retain_grad()
    pixels = torch.cat([colors, alphas], dim=-1)
    loss = (pixels.double() * torch.tensor(stored(f"case/{case}")["weights"]) / 32).sum()
    loss.backward()
    return SimpleNamespace(meta=meta, pixels=pixels.detach(), loss=loss.item(), leaves=leaves)


@pytest.fixture(params=[torch.float32, torch.float64], ids=["float32", "float64"])
def dtype(request):
    return request.param


def rows(meta, array):
    """Keep the rows of the Gaussians in a picture: the others mean nothing."""
    return np.asarray(array)[(np.asarray(meta["radii"]) > 0).all(axis=-1)]


def conditions(conics):
    """c_xx c_yy / det C of each covariance: the roundings of C times this are those of det C."""
    xx, xy, yy = conics.astype(np.float64).T
    return xx * yy / (xx * yy - xy * xy)


@pytest.mark.parametrize("case", ABOUT["cases"])
def test_pictures(case, dtype):
    """Every eleventh pixel one by one, and by the loss all pixels that no cut-off is near."""
    mine, theirs = drawn(case, dtype), stored(f"case/{case}")
    counted = torch.tensor(theirs["weights"] != 0).any(dim=-1)
    assert counted.double().mean() > (0.85 if "ED" in str(ABOUT["cases"][case]) else 0.99)
    pixels = mine.pixels.flatten(0, -2)[:: ABOUT["stride"]]
    off = (pixels.double() - torch.tensor(theirs["pixels"])).abs()
    assert off[counted.flatten()[:: ABOUT["stride"]]].max() < PIXELS
    total = (mine.pixels.abs() * torch.tensor(theirs["weights"]).abs()).sum() / 32
    assert abs(mine.loss - theirs["loss"]) < 1e-7 * total


@pytest.mark.parametrize("case", ABOUT["cases"])
def test_gradients(case, dtype):
    mine, theirs = drawn(case, dtype), stored(f"case/{case}")
    means2d, packed = mine.meta["means2d"], "meta/gaussian_ids" in theirs
    found = {name: leaf.grad for name, leaf in mine.leaves.items() if leaf.grad is not None}
    found |= {"means2d": means2d.grad}
    if ABOUT["cases"][case][1].get("absgrad"):
        found["absgrad"] = means2d.absgrad
    expected = {k.removeprefix("grad/"): v for k, v in theirs.items() if k.startswith("grad/")}
    assert found.keys() == expected.keys()  # no gradient where gsplat has none
    for name, grad in expected.items():
        grad, other = torch.tensor(grad).double(), found[name].double()
        if name == "viewmats":  # torch.inverse gives the last row of gsplat's a gradient too
            grad, other = grad[..., :3, :], other[..., :3, :]
        if name in ("means2d", "absgrad") and not packed:
            other = torch.where((mine.meta["radii"] > 0).all(dim=-1, keepdim=True), other, 0)
        bound = OPAQUE if case == "opaque" else GRADIENT
        assert (other - grad).norm() < bound * grad.norm(), name


@pytest.mark.parametrize("case", ABOUT["cases"])
def test_meta(case, dtype):
    """Radii and ids to the last digit; conics and opacities as far as a determinant allows."""
    meta, theirs = drawn(case, dtype).meta, stored(f"case/{case}")
    theirs = {k.removeprefix("meta/"): v for k, v in theirs.items() if k.startswith("meta/")}
    for name in {"radii", "batch_ids", "camera_ids", "gaussian_ids"} & theirs.keys():
        assert (meta[name].numpy() == theirs[name]).all(), name
    mine = {k: rows(meta, meta[k].detach()).astype(np.float64) for k in theirs}
    theirs = {k: rows(theirs, v) for k, v in theirs.items()}
    np.testing.assert_allclose(mine["depths"], theirs["depths"], rtol=32 * ROUNDING)
    np.testing.assert_allclose(mine["means2d"], theirs["means2d"], rtol=2e-6, atol=2e-5)
    condition = conditions(theirs["conics"])
    off = np.abs(mine["conics"] - theirs["conics"]).max(axis=1)
    assert (off < 32 * ROUNDING * condition * theirs["conics"].max(axis=1)).all()
    off = np.abs(mine["opacities"] / theirs["opacities"] - 1)
    if ABOUT["cases"][case][1].get("rasterize_mode") != "antialiased":
        assert off.max() < ROUNDING
        return
    given = stored(f"scene/{ABOUT['cases'][case][0]}")["opacities"]
    ids = meta["gaussian_ids"]
    given = rows(meta, np.broadcast_to(given, meta["depths"].shape)) if ids is None else given[ids]
    sharp = condition * (given / theirs["opacities"]) ** 2  # of the covariance without the blur
    assert (off < 16 * ROUNDING * sharp).all()
