"""A tile's list holds exactly the Gaussians that one of its pixels shows, in depth order."""

import numpy as np
import pytest
import torch
from drjit.llvm import Float64

from gva_mi.splat import reference
from gva_mi.splat.kernels import tiles
from gva_mi.splat.kernels.inputs import Inputs
from gva_mi.splat.kernels.passes import render_forward
from gva_mi.splat.scene import random_scene


def forward(scene):
    g = scene.gaussians
    flat = {k: Float64(a.reshape(-1).numpy()) for k, a in g.arrays().items()}
    return render_forward(
        Inputs.of_named(flat), False, scene.camera, scene.options, [0.0] * g.channels
    )


def lists_of(saved) -> dict[int, list[int]]:
    real = saved.lists.real.numpy()
    ids = saved.lists.ids.numpy()
    columns = (saved.lists.tile, saved.lists.start, saved.lists.end)
    lanes = zip(*(column.numpy()[real] for column in columns), strict=True)
    return {int(tile): ids[start:end].tolist() for tile, start, end in lanes}


@pytest.mark.parametrize(("width", "height"), [(32, 32), (37, 11), (5, 3)])
def test_lists_are_exact_and_in_depth_order(width, height):
    generator = torch.Generator().manual_seed(5)
    scene = random_scene(generator, gaussians=60, width=width, height=height)
    camera, options, g = scene.camera, scene.options, scene.gaussians
    R, t = torch.tensor(camera.T_camera_world[:3, :3]), torch.tensor(camera.T_camera_world[:3, 3])
    x = g.means @ R.T + t
    lists = lists_of(forward(scene))
    layout = tiles.Layout(width, height)
    assert sorted(lists) == list(range(layout.tiles))

    v, u = np.mgrid[:height, :width] + 0.5
    tile = (v.astype(int) // tiles.HEIGHT) * layout.columns + u.astype(int) // tiles.WIDTH
    expected, covariances = {k: [] for k in lists}, reference.covariances_of(g)
    for i in torch.argsort(x[:, 2]).tolist():
        K = torch.tensor(camera.K)
        mean, sharp = reference.project(x[i], covariances[i], R, camera, K)
        covariance = sharp + options.blur * torch.eye(2)
        d = np.stack([u, v], axis=-1) - mean.numpy()
        power = np.einsum("hwi,ij,hwj->hw", d, np.linalg.inv(covariance.numpy()), d)
        seen = g.opacities[i].item() * np.exp(-power / 2) >= options.alpha_min
        for k in np.unique(tile[seen]):
            expected[k].append(i)
    assert lists == expected


def test_equal_depths_keep_their_order():
    scene = random_scene(torch.Generator().manual_seed(0), gaussians=20)
    inputs = scene.inputs()
    inputs["means"] = torch.zeros(20, 3, dtype=torch.float64)
    for ids in lists_of(forward(scene.with_inputs(inputs))).values():
        assert ids == sorted(ids)


def test_lists_scheduled_again_are_the_same_lists_up_to_where_they_stopped(monkeypatch):
    scene = random_scene(torch.Generator().manual_seed(0), gaussians=300)
    opaque = scene.inputs() | {"opacities": torch.full((300,), 0.98, dtype=torch.float64)}
    saved = forward(scene.with_inputs(opaque))
    by_tile = lambda lists, end: {
        int(tile): (int(start), int(stop))
        for tile, start, stop, real in zip(
            *(x.numpy() for x in (lists.tile, lists.start, end, lists.real)), strict=True
        )
        if real
    }
    short = tiles.composited(saved.lists, saved.stop)
    monkeypatch.setattr(tiles, "RESCHEDULED_PAIRS", 0)
    again = tiles.composited(saved.lists, saved.stop)
    assert by_tile(again, again.end) == by_tile(short, short.end)
    assert by_tile(again, again.end) == by_tile(saved.lists, saved.stop)
    assert (again.tile.numpy() != saved.lists.tile.numpy()).any()
