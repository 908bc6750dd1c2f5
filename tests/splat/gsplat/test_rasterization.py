"""``rasterization``: shapes, modes and batches, against the reference implementation."""

import inspect
from types import SimpleNamespace

import pytest
import torch

from gva_mi.splat import rasterization, reference
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.scene import random_scene

W, H, N, C = 24, 17, 30, 2  # of the arguments


def test_parameters_are_gsplats():
    expected = (
        "means quats scales opacities colors viewmats Ks width height near_plane far_plane "
        "radius_clip eps2d sh_degree packed tile_size backgrounds render_mode sparse_grad absgrad "
        "rasterize_mode channel_chunk distributed camera_model segmented covars with_ut "
        "with_eval3d radial_coeffs tangential_coeffs thin_prism_coeffs ftheta_coeffs "
        "rolling_shutter viewmats_rs"
    )
    assert list(inspect.signature(rasterization).parameters) == expected.split()


@pytest.mark.parametrize("sh_degree, camera_model, rasterize_mode", [
    (None, "pinhole", "classic"), (1, "pinhole", "antialiased"), (1, "ortho", "classic"),
    (None, "fisheye", "antialiased"),
])  # fmt: skip
def test_pictures_match_the_reference(
    arguments, gradients, sh_degree, camera_model, rasterize_mode
):
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
    by_reference = gradients((expected * w).sum(), a)
    for name, grad in gradients((found * w).sum(), a).items():
        other = by_reference[name]
        assert (grad - other).norm() <= 1e-10 * other.norm(), name


@pytest.mark.parametrize("camera_model", ["pinhole", "fisheye"])
def test_torchs_gradcheck_agrees_in_both_modes(camera_model):
    """For every differentiable input, through the node ``meta["means2d"]`` too."""
    g = random_scene(torch.Generator().manual_seed(3), 2, 5, 4).gaussians
    view = torch.tensor(look_at((0, 0, 2.9), (0, 0, 0)))[None]
    K = torch.tensor([[[6.0, 0, 2.7], [0, 7, 2.1], [0, 0, 1]]]).double()
    leaves = (g.means, g.quats, g.scales, g.opacities, g.colors, view, K)

    def images(*tensors):
        modes = {"render_mode": "RGB+ED", "camera_model": camera_model, "packed": False}
        colors, alphas, meta = rasterization(*tensors, 5, 4, **modes)
        visible = (meta["radii"] > 0).all(dim=-1, keepdim=True)
        return colors * (alphas > 0.02), alphas, torch.where(visible, meta["means2d"], 0)

    inputs = [leaf.clone().requires_grad_() for leaf in leaves]
    assert torch.autograd.gradcheck(images, inputs, check_forward_ad=True, fast_mode=True)


def test_render_modes(arguments):
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


@pytest.mark.parametrize("dtype, rtol", [(torch.float32, 1e-5), (torch.float64, 1e-11)])
def test_gaussians_on_the_near_and_far_plane_are_drawn(dtype, rtol):
    """As in gsplat; 0.3 and 0.7 are no float32 numbers, and are rounded as the depths are."""
    z = torch.tensor([0.3, 0.7, 0.3, 0.7], dtype=dtype)
    z[2:] = torch.nextafter(z[2:], torch.tensor([0.0, 1.0], dtype=dtype))
    means = torch.stack([0.1 * z, -0.05 * z, z], dim=-1).requires_grad_()
    quats = torch.tensor([[1.0, 0, 0, 0]], dtype=dtype).expand(4, 4)
    others = (quats, 0.02 + 0 * means.detach(), 0.8 + 0 * z, 0.5 + 0 * means.detach())
    camera = Camera(20.0, 22.0, 12.3, 8.1, torch.eye(4).numpy(), W, H)
    Ks, view = (torch.tensor(m, dtype=dtype)[None] for m in (camera.K, camera.T_camera_world))
    found, _, meta = rasterization(
        means, *others, view, Ks, W, H, near_plane=0.3, far_plane=0.7, packed=False
    )
    assert (meta["radii"][0] > 0).all(dim=-1).tolist() == [True, True, False, False]
    options = SplatOptions(near=0.3, far=0.7)
    expected = reference.render(Gaussians(means, *others), camera, options).color
    assert (found[0] - expected).norm() <= rtol * expected.norm()
    by_kernels, by_reference = (
        torch.autograd.grad(x.square().sum(), means)[0] for x in (found, expected)
    )
    assert (by_kernels - by_reference).norm() <= rtol * by_reference.norm()


def test_a_trainer_may_write_into_its_pictures(arguments, gradients):
    """``renders[~masks] = 0``, as trainers do: the same as a product with the mask."""
    a, found = arguments(), []
    mask = torch.arange(H)[:, None] * torch.arange(W) % 3 > 0
    for in_place in (True, False):
        colors, alphas, _ = rasterization(**a, render_mode="RGB+D")
        if in_place:
            colors[:, ~mask] = 0
        else:
            colors = colors * mask[..., None]
        found.append(gradients(colors.square().sum() + alphas.sum(), a))
    for name, grad in found[0].items():
        assert torch.equal(grad, found[1][name]), name


def test_unsupported_arguments_raise(arguments):
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


def test_errors_use_the_names_of_the_callers_arguments(arguments):
    a = arguments()
    bad = a["means"].detach().clone()
    bad[7, 1] = float("nan")
    coefficients = torch.zeros(N, 4, 3).double()
    wrong = {
        r"quats must be \(1, 30, 4\), got \(30, 4\)": {"means": a["means"][None]},
        r"viewmats must be \(..., C, 4, 4\)": {"viewmats": a["viewmats"][0, 0]},
        r"viewmats must be \(2, 4, 4\), got \(2, 3, 4\)": {"viewmats": a["viewmats"][:, :3]},
        r"Ks must be \(2, 3, 3\), got \(1, 3, 3\)": {"Ks": a["Ks"][:1]},
        r"colors must be \(..., N, D\)": {"colors": a["colors"][1:]},
        r"got \(3, 30, 3\) where N is 30 and C 2": {"colors": a["colors"].expand(3, N, 3)},
        r"backgrounds must be \(..., C, D\)": {"backgrounds": torch.zeros(3).double()},
        "sh_degree must be 0 to 4, got 5": {"colors": coefficients, "sh_degree": 5},
        "sh_degree 2 needs 9 coefficients": {"colors": coefficients, "sh_degree": 2},
        "viewmats must be rigid": {"viewmats": 1.1 * a["viewmats"]},
        "Ks must be torch.float64, as means is, got torch.float32": {"Ks": a["Ks"].float()},
        "the numbers of Ks must be finite": {"Ks": a["Ks"] * float("inf")},
        r"means\[7, 1\] is nan, must be finite": {"means": bad},
        "width and height must be 1x1 to": {"width": 0},
        "near_plane must be above 0 and at most .*, got 0": {"near_plane": 0.0},
        "near_plane < far_plane is needed, got 2.0, 1.0": {"near_plane": 2.0, "far_plane": 1.0},
        "scales must be a torch tensor, got ndarray": {"scales": a["scales"].detach().numpy()},
    }
    for message, changed in wrong.items():
        with pytest.raises(ValueError, match=rf"^rasterization\(\): .*{message}"):
            rasterization(**(a | changed))


@pytest.mark.parametrize("packed", [True, False])
def test_leading_dimensions_are_a_batch(arguments, packed):
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


def test_colors_may_differ_from_camera_to_camera(arguments):
    a = arguments()
    twice = torch.stack([a["colors"], 1 - a["colors"]]).detach()
    found = rasterization(**(a | {"colors": twice}))[0]
    for c in range(C):
        assert torch.equal(found[c], rasterization(**(a | {"colors": twice[c]}))[0][c])


def test_radius_clip_leaves_out_the_small(arguments):
    a = arguments()
    radii = rasterization(**a, packed=False)[2]["radii"]
    clipped, _, meta = rasterization(**a, packed=False, radius_clip=4.0)
    kept = (radii > 4).any(dim=-1)
    assert kept.any() and not kept.all()
    assert ((meta["radii"] > 0).all(dim=-1) == (kept & (radii > 0).all(dim=-1))).all()
    for c in range(C):
        few = {k: a[k][kept[c]] for k in ("means", "quats", "scales", "opacities", "colors")}
        assert torch.equal(rasterization(**(a | few))[0][c], clipped[c])


@pytest.mark.parametrize("packed", [True, False])
def test_no_gaussians_give_an_empty_picture(arguments, packed):
    none = {k: arguments()[k].detach()[:0] for k in "means quats scales opacities colors".split()}
    colors, _, meta = rasterization(**(arguments() | none), packed=packed)
    assert colors.shape == (C, H, W, 3) and (colors == 0).all()
    assert all(meta[k].numel() == 0 for k in ("means2d", "depths", "radii", "conics", "opacities"))
