"""``meta`` of ``rasterization``: its rows, and means2d as a node of the graph."""

import gc
import weakref

import pytest
import torch

from gva_mi.splat import Screen, rasterization, render
from gva_mi.splat.gaussians import Gaussians

W, H, N, C = 24, 17, 30, 2  # of the arguments


def test_means2d_is_a_node_of_the_graph(arguments, camera_of):
    a = arguments()
    colors, _, meta = rasterization(**a, absgrad=True, packed=False)
    assert (meta["width"], meta["height"], meta["n_cameras"]) == (W, H, C)
    meta["means2d"].retain_grad()
    w = torch.randn(colors.shape, generator=torch.Generator().manual_seed(2)).double()
    (colors * w).sum().backward()
    for c in range(C):
        screen = Screen(absolute=True)
        g = Gaussians(*(a[k].detach().requires_grad_() for k in list(a)[:5]))
        (render(g, camera_of(a, c), screen=screen).color * w[c]).sum().backward()
        torch.testing.assert_close(meta["means2d"].grad[c], screen.grad)
        torch.testing.assert_close(meta["means2d"].absgrad[c], screen.absgrad)


def test_the_absolute_gradient_sums_the_absolute_gradients_of_pixels(arguments, camera_of):
    a = arguments()
    g = Gaussians(*(a[k] for k in list(a)[:5]))
    camera = camera_of(a, 0)
    screen = Screen(absolute=True)
    image = render(g, camera, screen=screen)
    total = 0
    for y in range(H):
        for x in range(W):
            loss = image.color[y, x].sum() + image.depth[y, x]
            torch.autograd.grad(loss, a["means"], retain_graph=True)
            torch.testing.assert_close(screen.absgrad, screen.grad.abs())
            total = total + screen.absgrad
    torch.autograd.grad(image.color.sum() + image.depth.sum(), a["means"])
    torch.testing.assert_close(screen.absgrad, total)


def test_packed_rows_are_those_of_the_gaussians_in_the_pictures(arguments):
    a = arguments(degree=None)
    a["means"] = (a["means"] + torch.tensor([0.7, 0, 0])).detach().requires_grad_()
    w = torch.randn(C, H, W, 3, generator=torch.Generator().manual_seed(2)).double()
    found = {}
    for packed in (True, False):
        for x in a.values():
            if isinstance(x, torch.Tensor):
                x.grad = None
        colors, _, meta = rasterization(**a, packed=packed, absgrad=True)
        meta["means2d"].retain_grad()
        (colors * w).sum().backward()
        found[packed] = {k: v.grad for k, v in a.items() if isinstance(v, torch.Tensor)}, meta
    (packed_by, packed), (by, whole) = found[True], found[False]
    for name, grad in by.items():
        assert torch.equal(grad, packed_by[name]), name
    seen = (whole["radii"] > 0).all(dim=-1)
    assert seen.any() and not seen.all()
    assert torch.equal(
        torch.stack([packed["camera_ids"], packed["gaussian_ids"]]).T, seen.nonzero()
    )
    assert (packed["batch_ids"] == 0).all() and whole["gaussian_ids"] is None
    for name in ("means2d", "depths", "radii", "conics", "opacities"):
        assert torch.equal(packed[name], whole[name][seen]), name
    for name in ("grad", "absgrad"):
        mine, theirs = (getattr(meta["means2d"], name) for meta in (packed, whole))
        assert torch.equal(mine, theirs[seen]), name


def test_hooks_and_losses_on_means2d_change_the_gradients(arguments, gradients):
    """Each part of the gradient reaches the means exactly once."""
    a = arguments()
    w = torch.randn(C, H, W, 3, generator=torch.Generator().manual_seed(2)).double()
    parts = {}
    for name, by_picture, by_node in (("picture", 1, 0), ("node", 0, 1), ("both", 1, 3)):
        colors, _, meta = rasterization(**a, packed=False)
        node = meta["means2d"].sin().sum() + meta["depths"].sum()
        loss = by_picture * (colors * w).sum() + by_node * node
        parts[name] = gradients(loss, a)
    colors, _, meta = rasterization(**a, packed=False)
    meta["means2d"].register_hook(lambda grad: 0 * grad)
    parts["cut"] = gradients((colors * w).sum(), a)
    for name in ("means", "viewmats", "Ks"):
        total = parts["picture"][name] + 3 * parts["node"][name]
        torch.testing.assert_close(parts["both"][name], total, rtol=1e-9, atol=1e-9)
        assert (parts["cut"][name] - parts["picture"][name]).abs().max() > 1e-3


@pytest.mark.parametrize("packed", [True, False])
def test_means2d_has_a_gradient_where_means_and_cameras_are_frozen(arguments, packed):
    a = arguments()
    a = {k: v.detach() if isinstance(v, torch.Tensor) else v for k, v in a.items()}
    a["colors"].requires_grad_()
    colors, _, meta = rasterization(**a, packed=packed)
    meta["means2d"].retain_grad()
    colors.sum().backward()
    assert meta["means2d"].grad.abs().sum() > 0 and a["colors"].grad.abs().sum() > 0
    assert not rasterization(**(a | {"colors": a["colors"].detach()}))[2]["means2d"].requires_grad


@pytest.mark.parametrize("packed", [True, False])
def test_memory_is_freed_with_the_results(arguments, packed):
    a = arguments()
    a["viewmats"], a["Ks"] = (a[name].detach()[:1] for name in ("viewmats", "Ks"))
    colors, _, meta = rasterization(**a, packed=packed, absgrad=True)
    meta["means2d"].retain_grad()
    colors.sum().backward()
    alive = weakref.ref(meta["means2d"])
    assert alive().absgrad is not None
    del colors, meta, _
    gc.collect()
    assert alive() is None
