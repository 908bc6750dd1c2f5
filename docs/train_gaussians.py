"""Train Gaussians on pictures, with gsplat's names and 3DGS's density control, in a minute.

    python docs/train_gaussians.py [--scene FILE] [--steps 400] [--size 64] [--out FILE.ply]

It needs only the bare install. The target scene is a .ply, a .glb, or random Gaussians. Its
pictures are rendered first, from cameras on a ring. Density control follows gsplat's
DefaultStrategy. It has no reset of opacities, which is for runs of thousands of steps. Thresholds
are chosen for small pictures. To use your own data, replace ``Views``.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.core.errors import InputError
from gva_mi.splat import Gaussians, look_at, rasterization
from gva_mi.splat.axes import half_turned
from gva_mi.splat.formats.ply import save_ply
from gva_mi.splat.scene import Scene, random_scene

RATES = {"means": 5e-3, "scales": 2e-2, "quats": 1e-2, "opacities": 5e-2, "sh0": 2e-2}
Params = dict[str, torch.nn.Parameter]  # log scales, logit opacities, as gsplat has them


@dataclass(frozen=True)
class Views:
    """Cameras and their pictures."""

    viewmats: Tensor  # (C, 4, 4)
    Ks: Tensor  # (C, 3, 3)
    images: Tensor  # (C, H, W, 3)

    @staticmethod
    def around(scene: Scene, count: int, size: int, start: float = 0.0) -> Views:
        """Render a scene from a ring of cameras about its middle, y up."""
        g, camera = scene.gaussians, scene.camera.resized(size, size)
        middle = g.means.median(dim=0).values.numpy()
        distance = np.linalg.norm(camera.position - middle)
        turns = start + 2 * math.pi * np.arange(count) / count
        places = [middle + distance * np.array([math.sin(a), 0.2, math.cos(a)]) for a in turns]
        viewmats = torch.tensor(np.stack([look_at(place, middle) for place in places])).float()
        Ks = torch.tensor(camera.K).float().expand(count, 3, 3)
        values = {k: v.float() for k, v in g.arrays().items() if k != "sh"}
        values["colors"] = g.colors.float() if g.sh is None else g.sh.float()
        degree = None if g.sh is None else math.isqrt(g.sh.shape[1]) - 1
        images, _, _ = rasterization(
            **values, viewmats=viewmats, Ks=Ks, width=size, height=size, sh_degree=degree
        )
        return Views(viewmats, Ks, images)


@dataclass
class Density:
    """Adds and removes Gaussians; the fields have DefaultStrategy's names."""

    scene_scale: float  # m
    grow_grad2d: float = 2e-3  # of the loss, by means2d in halves of the picture
    grow_scale3d: float = 0.05  # of scene_scale: smaller ones are duplicated, larger ones split
    prune_opa: float = 0.005
    refine_every: int = 50
    most: int = 2000  # Gaussians, above which none are added
    grad2d: Tensor | float = 0.0
    count: Tensor | float = 0.0

    def accumulate(self, meta: dict) -> None:
        """After backward, accumulate the gradient of each Gaussian's mean in the picture."""
        N = meta["means2d"].grad.new_zeros(meta["n_gaussians"])
        half = torch.tensor([meta["width"], meta["height"]]) / 2 * meta["n_cameras"]
        moved = (meta["means2d"].grad * half).norm(dim=-1)
        self.grad2d = self.grad2d + N.index_add(0, meta["gaussian_ids"], moved)
        self.count = self.count + N.index_add(0, meta["gaussian_ids"], torch.ones_like(moved))

    @torch.no_grad()
    def refine(self, params: Params, adam: torch.optim.Adam, generator: torch.Generator) -> None:
        """Duplicate, split and prune, then reset the accumulated gradients."""
        scales, opaque = params["scales"].exp(), params["opacities"].sigmoid() > self.prune_opa
        grown = (self.grad2d / self.count.clamp(min=1) > self.grow_grad2d) & opaque
        grown &= torch.tensor(len(scales) < self.most)
        large = scales.max(dim=1).values > self.grow_scale3d * self.scene_scale
        split, copied = (grown & large).nonzero()[:, 0].repeat(2), (grown & ~large).nonzero()[:, 0]
        new = {name: p[torch.cat([copied, split])] for name, p in params.items()}
        normal = torch.randn(len(split), 3, generator=generator)
        new["means"][len(copied) :] += _rotate(params["quats"][split], scales[split] * normal)
        new["scales"][len(copied) :] -= math.log(1.6)
        _replace_rows(params, adam, opaque & ~(grown & large), new)
        self.grad2d = self.count = 0.0


def _rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors (N, 3) by quaternions wxyz (N, 4) of any length."""
    unit = torch.nn.functional.normalize(quats, dim=1)
    w, axis = unit[:, :1], unit[:, 1:]
    cross = torch.linalg.cross(axis, vectors)
    return vectors + 2 * (w * cross + torch.linalg.cross(axis, cross))


def _replace_rows(
    params: Params, adam: torch.optim.Adam, kept: Tensor, new: dict[str, Tensor]
) -> None:
    """Keep some Gaussians and append new ones, whose moments in Adam are zero."""
    for group in adam.param_groups:
        name = group["name"]
        old, rows = params[name], new[name]
        state = adam.state.pop(old)
        for moment in ("exp_avg", "exp_avg_sq"):
            state[moment] = torch.cat([state[moment][kept], torch.zeros_like(rows)])
        params[name] = torch.nn.Parameter(torch.cat([old.detach()[kept], rows]))
        group["params"], adam.state[params[name]] = [params[name]], state


def start(scene: Scene, count: int, generator: torch.Generator) -> Params:
    """Spread grey Gaussians over the volume of the scene."""
    means = scene.gaussians.means.float()
    low, high = means.quantile(0.05, dim=0), means.quantile(0.95, dim=0)
    places = low + (high - low) * torch.rand(count, 3, generator=generator)
    spacing = ((high - low).clamp(min=1e-3).prod() / count) ** (1 / 3)
    values = {
        "means": places,
        "scales": torch.full((count, 3), float(spacing.log()) - 0.7),
        "quats": torch.randn(count, 4, generator=generator),
        "opacities": torch.full((count,), -1.0),
        "sh0": torch.zeros(count, 1, 3),
    }
    return {name: torch.nn.Parameter(value) for name, value in values.items()}


def draw(params: Params, viewmats: Tensor, Ks: Tensor, size: int) -> tuple[Tensor, dict]:
    """Render pictures (C, size, size, 3); also return gsplat's ``meta``."""
    colors, _, meta = rasterization(
        params["means"],
        params["quats"],
        params["scales"].exp(),
        params["opacities"].sigmoid(),
        params["sh0"],
        viewmats,
        Ks,
        size,
        size,
        sh_degree=0,
    )
    meta["n_gaussians"] = len(params["means"])
    return colors, meta


@torch.no_grad()
def psnr(params: Params, views: Views) -> float:
    """Return the PSNR of the pictures, dB."""
    size = views.images.shape[1]
    error = draw(params, views.viewmats, views.Ks, size)[0] - views.images
    return -10 * math.log10(error.square().mean().item())


def train(scene: Scene, views: Views, steps: int, count: int = 100, seed: int = 0) -> Params:
    """Fit Gaussians to ``views``; one view a step, in random order."""
    generator = torch.Generator().manual_seed(seed)
    params = start(scene, count, generator)
    groups = [{"params": [p], "name": k, "lr": RATES[k]} for k, p in params.items()]
    adam = torch.optim.Adam(groups, eps=1e-15)
    extent = float(params["means"].detach().std(dim=0).norm())
    density, size = Density(scene_scale=extent), views.images.shape[1]
    for step in range(1, steps + 1):
        v = torch.randint(len(views.images), (1,), generator=generator)
        image, meta = draw(params, views.viewmats[v], views.Ks[v], size)
        meta["means2d"].retain_grad()
        (image - views.images[v]).abs().mean().backward()
        density.accumulate(meta)
        adam.step()
        adam.zero_grad()
        if step % density.refine_every == 0 and step <= 0.7 * steps:
            density.refine(params, adam, generator)
    return params


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", type=Path, help=".ply or .glb; else random Gaussians")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--size", type=int, default=64, help="of the pictures, px")
    parser.add_argument("--out", type=Path, help="a .ply of the fitted Gaussians")
    given = parser.parse_args(arguments)
    scene = random_scene(torch.Generator().manual_seed(0), gaussians=60)
    if given.scene is not None:
        try:
            scene = Scene.load(given.scene)
        except InputError as error:
            parser.error(str(error))
    seen, unseen = (Views.around(scene, n, given.size, at) for n, at in ((12, 0.0), (3, 0.4)))
    for steps in (0, given.steps):
        params = train(scene, seen, steps)
        found = f"{len(params['means'])} Gaussians, {psnr(params, unseen):.2f} dB in new views"
        print(f"after {steps} steps: {found}")
    if given.out is not None:
        p = {name: value.detach() for name, value in params.items()}
        scales, opacities = p["scales"].exp(), p["opacities"].sigmoid()
        found = Gaussians(p["means"], p["quats"], scales, opacities, sh=p["sh0"])
        save_ply(given.out, half_turned(found))  # from the world, y up, to a .ply, y down


if __name__ == "__main__":
    main()
