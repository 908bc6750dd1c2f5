"""Make ``cuda_references.npz``: what gsplat's own CUDA kernels compute for the cases.

    NO_FAST_MATH=1 python tests/splat/gsplat/make_cuda_references.py OUT.npz

It needs an NVIDIA GPU, torch, numpy and gsplat 1.5.3, not gva_mi. ``NO_FAST_MATH`` is gsplat's own
switch, read when its kernels are compiled. Without it, pixels differed by up to 3e-6, and gradients
by up to 1e-5 of their norm. gsplat's licence is Apache-2.0; only numbers are stored here.

=============================  =====================================================================
``cases``                      JSON: the scene and the arguments of each case, and who made the file
``scene/NAME/ARRAY``           the inputs, float32
``case/NAME/weights``          (..., C, H, W, D+1) int8: the loss is the sum of colours and alphas
                               times weights / 32; 0 in pixels at a cut-off (``steady``)
``case/NAME/loss``             the loss, summed in float64
``case/NAME/pixels``           (P, D+1) colours and alpha of every eleventh pixel of all pictures
``case/NAME/grad/ARRAY``       the loss's gradient by an input, and by ``means2d``
``case/NAME/meta/ARRAY``       of ``meta``: rows where ``radii`` are 0 hold 0, gsplat leaves them
                               uninitialised
=============================  =====================================================================
"""

import json
import os
import sys

import gsplat
import numpy as np
import torch
from cuda_scenes import CASES, SIZE, scenes

STRIDE = 11  # coprime to the pictures' size
ALPHA_MIN, ALPHA_MAX, T_MIN = 1 / 255, 0.999, 1e-4  # gsplat's cut-offs
META = ["radii", "means2d", "depths", "conics", "opacities"]
IDS = ["batch_ids", "camera_ids", "gaussian_ids"]


def rows_by_picture(meta, pictures):
    """Yield the drawn Gaussians of each picture: means2d, depths, conics, opacities, float64."""
    tables = [meta[name].detach().double() for name in ("means2d", "depths", "conics", "opacities")]
    if meta["gaussian_ids"] is None:
        drawn = (meta["radii"] > 0).all(dim=-1).reshape(pictures, -1)
        tables = [
            table.reshape(*drawn.shape, *table.shape[meta["depths"].dim() :]) for table in tables
        ]
        for k in range(pictures):
            yield [table[k][drawn[k]] for table in tables]
    else:
        picture = meta["batch_ids"] * meta["n_cameras"] + meta["camera_ids"]
        for k in range(pictures):
            yield [table[picture == k] for table in tables]


def steady(meta, pictures, render_mode="RGB"):
    """Find the pixels (pictures, H, W) that rounding cannot change by a step.

    Left out is a pixel where an alpha lies within 2e-4 of a cut-off, relatively, where T comes
    within 3 % of the one at which a pixel stops, and, for an expected depth, where alpha is small.
    """
    x = torch.arange(SIZE[0], device=meta["depths"].device) + 0.5
    y = torch.arange(SIZE[1], device=meta["depths"].device) + 0.5
    found = []
    for means2d, depths, conics, opacities in rows_by_picture(meta, pictures):
        order = torch.argsort(depths, stable=True)
        gaps = depths[order].diff() / depths[order][1:]
        if ((gaps > 0) & (gaps < 2**-18)).any():
            raise ValueError("two depths are too similar: take another seed")
        dx = means2d[order, 0, None, None] - x[None, None, :]
        dy = means2d[order, 1, None, None] - y[None, :, None]
        a, b, c = (conics[order, k, None, None] for k in range(3))
        alpha = opacities[order, None, None] * torch.exp(
            -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy
        )
        drawn = torch.where(alpha < ALPHA_MIN, 0, alpha.clamp(max=ALPHA_MAX))
        T = torch.cumprod(1 - drawn, dim=0)
        off = lambda value, cut: ((value / cut - 1).abs()).amin(dim=0)
        good = (off(alpha, ALPHA_MIN) > 2e-4) & (off(alpha, ALPHA_MAX) > 2e-4)
        good &= off(T, T_MIN) > 0.03
        if "ED" in render_mode:
            good &= (T[-1] == 1) | (T[-1] < 0.98)
        found.append(good)
    return torch.stack(found)


def weights_of(shape):
    """Return whole numbers from -30 to 30 that no two neighbours share."""
    return (torch.arange(int(np.prod(shape))) * 37 % 61 - 30).reshape(shape)


def reference(scene, arguments, rasterization, device):
    """Run one case, and return the arrays to store."""
    used = {name: array for name, array in scene.items() if name not in arguments}
    given = {name: torch.tensor(array, device=device) for name, array in used.items()}
    leaves = {k: v.requires_grad_() for k, v in given.items() if k != "Ks"}
    absent = {} if "quats" in given else {"quats": None, "scales": None}
    colors, alphas, meta = rasterization(
        **given, **absent, width=SIZE[0], height=SIZE[1], **arguments
    )
    meta["means2d"].retain_grad()
    pixels = torch.cat([colors, alphas], dim=-1)
    mask = steady(meta, pixels.shape[:-3].numel(), arguments.get("render_mode", "RGB"))
    mask = mask.reshape(*pixels.shape[:-1], 1)
    weights = weights_of(pixels.shape).to(device) * mask
    loss = (pixels.double() * weights / 32).sum()
    loss.backward()
    out = {"weights": weights.to(torch.int8), "loss": loss}
    out["pixels"] = pixels.flatten(0, -2)[::STRIDE]
    out |= {f"grad/{k}": v.grad for k, v in leaves.items() if v.grad is not None}
    packed = meta["gaussian_ids"] is not None
    drawn = (meta["radii"] > 0).all(dim=-1)
    clean = lambda x: torch.where(drawn.reshape(drawn.shape + (1,) * (x.dim() - drawn.dim())), x, 0)
    out |= {f"meta/{k}": clean(meta[k]) for k in META}
    out |= {f"meta/{k}": meta[k] for k in IDS if packed}
    out["grad/means2d"] = clean(meta["means2d"].grad)
    if arguments.get("absgrad"):
        out["grad/absgrad"] = clean(meta["means2d"].absgrad)
    return {k: v.detach().cpu().numpy() for k, v in out.items()}


def made_by():
    """Say what computed the numbers."""
    fast = "without" if os.environ.get("NO_FAST_MATH") == "1" else "with"
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "no GPU"
    return f"gsplat {gsplat.__version__} {fast} -use_fast_math, torch {torch.__version__}, {gpu}"


def main(out, device="cuda"):
    inputs = scenes()
    arrays = {f"scene/{s}/{k}": v for s, scene in inputs.items() for k, v in scene.items()}
    for name, (scene, arguments) in CASES.items():
        found = reference(inputs[scene], arguments, gsplat.rasterization, device)
        arrays |= {f"case/{name}/{k}": v for k, v in found.items()}
    about = {"made by": made_by(), "size": SIZE, "stride": STRIDE, "cases": CASES}
    np.savez_compressed(out, cases=json.dumps(about), **arrays)


if __name__ == "__main__":
    main(*sys.argv[1:])
