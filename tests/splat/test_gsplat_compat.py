"""gsplat's call: its shapes and modes, on batches of cameras, and what it refuses."""

import gc
import inspect
import weakref
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gva_mi.splat import Screen, rasterization, reference, render
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.gradcheck import random_scene
from gva_mi.splat.options import SplatOptions

W, H, N, C = 24, 17, 30, 2


def arguments(dtype=torch.float64, **kwargs):
    """Of rasterization(), by name, all float ones leaves; two cameras."""
    g = random_scene(torch.Generator().manual_seed(3), N, W, H, **kwargs).gaussians
    views = [look_at((0.6, 0.4, 2.9), (0.0, 0.0, 0.0)), look_at((-0.9, 0.2, 2.5), (0.0, 0.1, 0.0))]
    K = np.array([[40.0, 0, 12.3], [0, 42, 8.1], [0, 0, 1]])
    out = {"means": g.means, "quats": g.quats, "scales": g.scales, "opacities": g.opacities}
    out |= {"colors": g.colors if g.sh is None else g.sh, "viewmats": np.stack(views)}
    out |= {"Ks": np.stack([K, K + [[3, 0, 0], [0, 2, 0], [0, 0, 0]]])}
    out = {k: torch.as_tensor(v).to(dtype).clone().requires_grad_() for k, v in out.items()}
    return out | {"width": W, "height": H}


def camera_of(a, c, model="pinhole"):
    K, T = (a[name][c].detach().double().numpy() for name in ("Ks", "viewmats"))
    return Camera.from_matrices(K, T, W, H, model)


def gradients(loss, a):
    leaves = {k: v for k, v in a.items() if isinstance(v, torch.Tensor)}
    found = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
    return dict(zip(leaves, found, strict=True))


def test_parameters_are_gsplats():
    expected = (
        "means quats scales opacities colors viewmats Ks width height near_plane far_plane "
        "radius_clip eps2d sh_degree packed tile_size backgrounds render_mode sparse_grad absgrad "
        "rasterize_mode channel_chunk distributed camera_model segmented covars with_ut "
        "with_eval3d radial_coeffs tangential_coeffs thin_prism_coeffs ftheta_coeffs "
        "rolling_shutter viewmats_rs"
    )
    assert list(inspect.signature(rasterization).parameters) == expected.split()


@pytest.mark.parametrize("rasterize_mode", ["classic", "antialiased"])
@pytest.mark.parametrize("camera_model", ["pinhole", "ortho", "fisheye"])
@pytest.mark.parametrize("sh_degree", [None, 1])
def test_pictures_and_gradients_are_the_twins(sh_degree, camera_model, rasterize_mode):
    a = arguments(degree=None if sh_degree is None else 2)  # more coefficients than are used
    modes = {"rasterize_mode": rasterize_mode, "camera_model": camera_model}
    backgrounds = torch.rand(C, 3, generator=torch.Generator().manual_seed(1)).double()
    colors, alphas, _ = rasterization(
        **a, sh_degree=sh_degree, backgrounds=backgrounds, render_mode="RGB+D", **modes
    )
    kind = "colors" if sh_degree is None else "sh"
    features = a["colors"] if sh_degree is None else a["colors"][:, :4]
    expected = []
    for c in range(C):
        g = Gaussians(a["means"], a["quats"], a["scales"], a["opacities"], **{kind: features})
        image = reference.render(
            g,
            Camera.from_matrices(a["Ks"][c], a["viewmats"][c], W, H, camera_model),
            SplatOptions(antialiased=rasterize_mode == "antialiased"),
            backgrounds[c],
        )
        picture = [image.color, image.depth[..., None], image.alpha[..., None]]
        expected.append(torch.cat(picture, dim=-1))
    expected, found = torch.stack(expected), torch.cat([colors, alphas], dim=-1)
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=0)
    w = torch.randn(found.shape, generator=torch.Generator().manual_seed(2)).double()
    truth = gradients((expected * w).sum(), a)
    for name, grad in gradients((found * w).sum(), a).items():
        assert (grad - truth[name]).norm() <= 1e-10 * truth[name].norm(), name


@pytest.mark.parametrize("camera_model", ["pinhole", "ortho", "fisheye"])
def test_torch_agrees_in_both_directions(camera_model):
    """By every differentiable input, through the node of meta["means2d"] too."""
    g = random_scene(torch.Generator().manual_seed(3), 2, 5, 4).gaussians
    view = torch.tensor(look_at((0, 0, 2.9), (0, 0, 0)))[None]
    K = torch.tensor([[[6.0, 0, 2.7], [0, 7, 2.1], [0, 0, 1]]]).double()
    if camera_model == "ortho":
        K = K * torch.tensor([0.4, 0.4, 1]).double()[:, None]
    leaves = (g.means, g.quats, g.scales, g.opacities, g.colors, view, K)

    def images(*tensors):
        modes = {"render_mode": "RGB+ED", "camera_model": camera_model, "packed": False}
        colors, alphas, meta = rasterization(*tensors, 5, 4, **modes)
        visible = (meta["radii"] > 0).all(dim=-1, keepdim=True)
        return colors * (alphas > 0.02), alphas, torch.where(visible, meta["means2d"], 0)

    inputs = [leaf.clone().requires_grad_() for leaf in leaves]
    assert torch.autograd.gradcheck(images, inputs, check_forward_ad=True, fast_mode=True)


def test_render_modes():
    a = arguments()
    pictures = {m: rasterization(**a, render_mode=m) for m in "RGB D ED RGB+D RGB+ED".split()}
    rgb, alphas, _ = pictures["RGB"]
    depth = pictures["D"][0]
    assert rgb.shape == (C, H, W, 3) and depth.shape == alphas.shape == (C, H, W, 1)
    expected = depth / alphas.clamp(min=1e-10)
    torch.testing.assert_close(pictures["ED"][0], expected, atol=0, rtol=0)
    for mode, last in (("RGB+D", depth), ("RGB+ED", expected)):
        torch.testing.assert_close(
            pictures[mode][0], torch.cat([rgb, last], dim=-1), atol=0, rtol=0
        )
    seen = alphas > 0.01
    assert expected[seen].min() > 1.5 and expected[seen].max() < 4


def test_expected_depth_has_a_gradient():
    a = arguments()
    g = gradients(rasterization(**a, render_mode="ED")[0].sum(), a)
    for name in ("means", "quats", "scales", "opacities", "viewmats", "Ks"):
        assert torch.isfinite(g[name]).all() and g[name].abs().sum() > 0, name


def test_colors_of_each_camera():
    a = arguments()
    twice = torch.stack([a["colors"], 1 - a["colors"]]).detach()
    found = rasterization(**(a | {"colors": twice}))[0]
    for c in range(C):
        alone = rasterization(**(a | {"colors": twice[c]}))[0]
        torch.testing.assert_close(found[c], alone[c], atol=0, rtol=0)


def test_meta():
    a = arguments()
    _, _, meta = rasterization(**a, packed=False)
    assert (meta["width"], meta["height"], meta["n_cameras"]) == (W, H, C)
    assert meta["radii"].shape == (C, N, 2) and meta["radii"].dtype == torch.int32
    for c in range(C):
        camera = camera_of(a, c)
        x = a["means"].detach().numpy() @ camera.T_camera_world[:3, :3].T
        x += camera.T_camera_world[:3, 3]
        np.testing.assert_allclose(meta["depths"][c].detach(), x[:, 2], rtol=1e-12)
        projected = camera.project(a["means"].detach().numpy())
        np.testing.assert_allclose(meta["means2d"][c].detach(), projected, rtol=1e-11)
        screen = Screen()
        g = Gaussians(a["means"], a["quats"], a["scales"], a["opacities"], a["colors"])
        render(g, camera, screen=screen)
        assert ((meta["radii"][c] > 0).all(dim=1) | ~screen.visible).all()
        R = torch.tensor(camera.T_camera_world[:3, :3])
        for i in torch.nonzero(screen.visible)[:, 0].tolist():
            parts = (torch.tensor(x[i]), reference._covariances(g)[i], R, camera)
            C2 = reference._project(*parts, torch.tensor(camera.K))[1].detach()
            C2 = C2 + 0.3 * torch.eye(2, dtype=torch.float64)
            conic = torch.linalg.inv(C2)[[0, 0, 1], [0, 1, 1]]
            torch.testing.assert_close(meta["conics"][c, i], conic, rtol=1e-9, atol=1e-12)
            reach = torch.sqrt(2 * torch.log(255 * a["opacities"][i]) * torch.diagonal(C2))
            assert (meta["radii"][c, i] == torch.ceil(reach)).all()
    torch.testing.assert_close(meta["opacities"], a["opacities"].expand(C, N))
    faded = rasterization(**a, rasterize_mode="antialiased", packed=False)[2]["opacities"]
    assert (faded <= meta["opacities"] * (1 + 1e-12)).all() and (faded > 0).all()


def test_means2d_is_a_node_of_the_graph():
    a = arguments()
    colors, _, meta = rasterization(**a, absgrad=True, packed=False)
    meta["means2d"].retain_grad()
    w = torch.randn(colors.shape, generator=torch.Generator().manual_seed(2)).double()
    (colors * w).sum().backward()
    for c in range(C):
        screen = Screen(absolute=True)
        g = Gaussians(*(a[k].detach().requires_grad_() for k in list(a)[:5]))
        (render(g, camera_of(a, c), screen=screen).color * w[c]).sum().backward()
        torch.testing.assert_close(meta["means2d"].grad[c], screen.grad)
        torch.testing.assert_close(meta["means2d"].absgrad[c], screen.absgrad)


def test_a_loss_on_means2d_and_depths_reaches_means_and_cameras():
    a = arguments()
    for name in ("means2d", "depths"):
        g = gradients(rasterization(**a, packed=False)[2][name].square().sum(), a)
        assert g["means"].abs().min() > 0 and (g["viewmats"][:, 2].abs() > 0).all()


def test_absolute_gradient_of_one_pixel_is_the_gradients_absolute():
    """And that of a picture is the sum over its pixels."""
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


def test_radius_clip_leaves_out_the_small():
    a = arguments()
    radii = rasterization(**a, packed=False)[2]["radii"]
    clipped, _, meta = rasterization(**a, packed=False, radius_clip=4.0)
    kept = (radii > 4).any(dim=-1)
    assert kept.any() and not kept.all()
    assert ((meta["radii"] > 0).all(dim=-1) == (kept & (radii > 0).all(dim=-1))).all()
    for c in range(C):
        few = {k: a[k][kept[c]] for k in ("means", "quats", "scales", "opacities", "colors")}
        torch.testing.assert_close(rasterization(**(a | few))[0][c], clipped[c], atol=0, rtol=0)


def test_what_means_nothing_on_a_cpu_changes_nothing():
    a = arguments()
    idle = {"packed": False, "tile_size": 8, "sparse_grad": True, "channel_chunk": 4}
    idle |= {"segmented": True, "rolling_shutter": SimpleNamespace(name="GLOBAL")}
    assert torch.equal(rasterization(**a)[0], rasterization(**a, **idle)[0])


@pytest.mark.parametrize("threads", [1, 2])
def test_same_bits_with_any_torch_threads(threads):
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        found = many_bits()
    finally:
        torch.set_num_threads(before)
    assert found == many_bits()


def many_bits():
    a = arguments(torch.float32, degree=1)
    copies = 200  # enough for torch to share work among threads
    for name in ("means", "quats", "scales", "opacities", "colors"):
        whole = a[name].detach().repeat(copies, *[1] * (a[name].dim() - 1))
        a[name] = whole.requires_grad_()
    with torch.no_grad():
        noise = torch.randn(a["means"].shape, generator=torch.Generator().manual_seed(0))
        a["means"] += 0.3 * noise
    colors, alphas, _ = rasterization(**a, sh_degree=1, render_mode="RGB+ED", absgrad=True)
    (colors.square().sum() + alphas.sum()).backward()
    leaves = [a[k] for k in list(a)[:7]]
    parts = [colors, alphas, *(leaf.grad for leaf in leaves)]
    return [p.detach().numpy().tobytes() for p in parts]


def test_unsupported_arguments_raise():
    a = arguments()
    wrong = {"distributed": True, "with_ut": True}
    wrong |= {"with_eval3d": True, "radial_coeffs": torch.zeros(C, 6), "viewmats_rs": a["viewmats"]}
    wrong |= {"rolling_shutter": SimpleNamespace(name="ROLLING_TOP_TO_BOTTOM")}
    for name, value in wrong.items():
        with pytest.raises(ValueError, match=f"{name} is not supported"):
            rasterization(**a, **{name: value})
    for name in ("render_mode", "rasterize_mode", "camera_model"):
        with pytest.raises(ValueError, match=f"{name} must be one of .*, got 'ftheta'"):
            rasterization(**a, **{name: "ftheta"})


def test_wrong_shapes_and_kinds_are_named_as_the_caller_named_them():
    a = arguments()
    bad = a["means"].detach().clone()
    bad[7, 1] = float("nan")
    wrong = {
        r"quats must be \(1, 30, 4\), got \(30, 4\)": {"means": a["means"][None]},
        r"viewmats must be \(..., C, 4, 4\)": {"viewmats": a["viewmats"][0, 0]},
        r"viewmats must be \(2, 4, 4\), got \(2, 3, 4\)": {"viewmats": a["viewmats"][:, :3]},
        r"Ks must be \(2, 3, 3\), got \(1, 3, 3\)": {"Ks": a["Ks"][:1]},
        r"colors must be \(..., N, D\)": {"colors": a["colors"][1:]},
        r"got \(3, 30, 3\) where N is 30 and C 2": {"colors": a["colors"].expand(3, N, 3)},
        r"backgrounds must be \(..., C, D\)": {"backgrounds": torch.zeros(3).double()},
        "sh_degree 2 needs 9 coefficients": {
            "colors": torch.zeros(N, 4, 3).double(),
            "sh_degree": 2,
        },
        "viewmats must be rigid": {"viewmats": 1.1 * a["viewmats"]},
        "Ks must be torch.float64 on the CPU, got torch.float32": {"Ks": a["Ks"].float()},
        "the numbers of Ks must be finite": {"Ks": a["Ks"] * float("inf")},
        "focal lengths of Ks must be positive": {"Ks": -a["Ks"]},
        r"means\[7, 1\] is nan, must be finite": {"means": bad},
        "viewmats must be float32 or float64 on the CPU, got .* on meta": {
            "viewmats": a["viewmats"].to("meta")
        },
        "width and height must be 1x1 to": {"width": 0},
        "scales must be a torch tensor, got ndarray": {"scales": a["scales"].detach().numpy()},
    }
    for message, changed in wrong.items():
        with pytest.raises(ValueError, match=rf"^rasterization\(\): .*{message}"):
            rasterization(**(a | changed))


def test_packed_meta_has_the_rows_of_those_in_the_pictures():
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


def test_hooks_and_losses_on_means2d_are_heard():
    """Each part of its gradient reaches the means once, whatever else is added or taken."""
    a = arguments()
    w = torch.randn(C, H, W, 3, generator=torch.Generator().manual_seed(2)).double()
    parts = {}
    for name, by_picture, by_node in (("picture", 1, 0), ("node", 0, 1), ("both", 1, 3)):
        colors, _, meta = rasterization(**a, packed=False)
        loss = by_picture * (colors * w).sum() + by_node * meta["means2d"].sin().sum()
        parts[name] = gradients(loss, a)
    colors, _, meta = rasterization(**a, packed=False)
    meta["means2d"].register_hook(lambda grad: 0 * grad)
    parts["cut"] = gradients((colors * w).sum(), a)
    for name in ("means", "viewmats", "Ks"):
        total = parts["picture"][name] + 3 * parts["node"][name]
        torch.testing.assert_close(parts["both"][name], total, rtol=1e-9, atol=1e-9)
        assert (parts["cut"][name] - parts["picture"][name]).abs().max() > 1e-3


@pytest.mark.parametrize("packed", [True, False])
def test_one_thread_copies_the_gradient_that_is_kept_and_then_all_come_back(packed):
    a, before, seen = arguments(), torch.get_num_threads(), []

    def called(hook=lambda _: seen.append(torch.get_num_threads()), keep=True):
        colors, _, meta = rasterization(**a, packed=packed)
        meta["means2d"].register_hook(hook)
        if keep:
            meta["means2d"].retain_grad()
        return colors.sum(), meta["means2d"]

    def refuse(_):
        raise ZeroDivisionError

    torch.set_num_threads(3)
    try:
        for keep in (True, False):
            loss, node = called(keep=keep)  # who holds the node has its gradient kept
            loss.backward()
        assert seen == [1, 3] and torch.get_num_threads() == 3
        torch.autograd.grad(*called())  # nothing comes after the node
        assert torch.get_num_threads() == 3
        loss, node = called(refuse)
        with pytest.raises(ZeroDivisionError):
            loss.backward()
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize("packed", [True, False])
def test_means2d_has_a_gradient_where_means_and_cameras_are_frozen(packed):
    a = arguments()
    a = {k: v.detach() if isinstance(v, torch.Tensor) else v for k, v in a.items()}
    a["colors"].requires_grad_()
    colors, _, meta = rasterization(**a, packed=packed)
    meta["means2d"].retain_grad()
    colors.sum().backward()
    assert meta["means2d"].grad.abs().sum() > 0 and a["colors"].grad.abs().sum() > 0
    assert not rasterization(**(a | {"colors": a["colors"].detach()}))[2]["means2d"].requires_grad


@pytest.mark.parametrize("packed", [True, False])
def test_leading_dimensions_are_a_batch(packed):
    a = arguments()
    few = {k: v.detach() for k, v in a.items() if isinstance(v, torch.Tensor)}
    moved = few | {"means": 0.9 * few["means"], "opacities": 0.5 * few["opacities"]}
    both = {k: torch.stack([few[k], moved[k]])[:, None] for k in few}
    colors, alphas, meta = rasterization(**both, width=W, height=H, packed=packed, tile_size=8)
    assert colors.shape == (2, 1, C, H, W, 3) and alphas.shape == (2, 1, C, H, W, 1)
    assert meta["n_batches"] == 2
    parts = []
    for b, one in enumerate((few, moved)):
        alone = rasterization(**one, width=W, height=H, packed=packed, tile_size=8)
        assert torch.equal(colors[b, 0], alone[0]) and torch.equal(alphas[b, 0], alone[1])
        parts.append(alone[2])
    for name in ("means2d", "depths", "radii", "conics", "opacities"):
        joined = [part[name] for part in parts]
        joined = torch.cat(joined) if packed else torch.stack(joined)[:, None]
        assert torch.equal(meta[name], joined), name
    assert meta["isect_offsets"].shape == (2, 1, C, 3, 3)


def test_tiles_list_who_touches_them_front_to_back():
    """gsplat's lists, against a loop over all tiles and Gaussians."""
    a, size = arguments(), 8
    _, _, meta = rasterization(**a, packed=False, tile_size=size)
    columns, rows = meta["tile_width"], meta["tile_height"]
    assert (columns, rows) == (3, 3)
    ids, k = meta["flatten_ids"].tolist(), 0
    u, radii, depths = (meta[name].detach() for name in ("means2d", "radii", "depths"))
    touched = torch.zeros(C, N, dtype=torch.int32)
    for c in range(C):
        for y in range(rows):
            for x in range(columns):
                low = torch.tensor([x, y]) * size
                inside = (u[c] + radii[c] > low) & (u[c] - radii[c] < low + size)
                here = (inside & (radii[c] > 0)).all(dim=1).nonzero()[:, 0]
                here = here[torch.sort(depths[c][here].float(), stable=True).indices]
                touched[c, here] += 1
                assert meta["isect_offsets"][c, y, x] == k
                assert ids[k : k + len(here)] == (here + c * N).tolist()
                k += len(here)
    assert k == len(ids) == len(meta["isect_ids"]) and k > N
    assert torch.equal(meta["tiles_per_gauss"], touched)
    assert (meta["isect_ids"].diff() >= 0).all()


def test_meta_is_a_dictionary():
    meta = rasterization(**arguments())[2]
    assert {"radii", "isect_ids", "means2d"} <= set(meta) and len(meta) == len(dict(meta))
    assert meta["radii"] is meta["radii"] and meta.get("nothing") is None
    meta["radii"] = 1
    del meta["conics"]
    assert meta["radii"] == 1 and "conics" not in meta
    with pytest.raises(KeyError):
        meta["conics"]


def test_nothing_is_a_picture_too():
    a = {
        k: v.detach()[:0] if k in "means quats scales opacities colors".split() else v
        for k, v in arguments().items()
    }
    for packed in (True, False):
        colors, alphas, meta = rasterization(**a, packed=packed)
        assert colors.shape == (C, H, W, 3) and (colors == 0).all() and (alphas == 0).all()
        for name in ("means2d", "depths", "radii", "conics", "opacities", "tiles_per_gauss"):
            assert meta[name].numel() == 0, name
        assert (meta["isect_offsets"] == 0).all()


@pytest.mark.parametrize("name", ["means", "colors", "viewmats"])
def test_torch_func_goes_through(name):
    a = arguments()
    loss = lambda x: rasterization(**(a | {name: x}))[0].square().sum()
    expected = gradients(loss(a[name]), a)[name]
    fixed = {k: v.detach() if isinstance(v, torch.Tensor) else v for k, v in a.items()}
    loss = lambda x: rasterization(**(fixed | {name: x}))[0].square().sum()
    assert torch.equal(torch.func.grad(loss)(fixed[name]), expected)


@pytest.mark.parametrize("packed", [True, False])
def test_nothing_stays_in_memory_when_the_caller_lets_go(packed):
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
