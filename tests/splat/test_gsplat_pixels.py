"""gsplat's stages one after the other are ``rasterization``, and each keeps to its formula."""

import importlib.util

import pytest
import torch

from gva_mi.splat import (
    fully_fused_projection,
    isect_offset_encode,
    isect_tiles,
    rasterization,
    rasterize_to_pixels,
)

W, H, SIZE = 37, 26, 16  # px; no multiple of a tile
TW, TH = 3, 2
MIN, MAX, LAST = 1 / 255, 0.999, 1e-4  # gsplat's cut-offs


def ellipses(images=2, n=12, channels=3, seed=0):
    """Means, conics, colours, opacities and backgrounds in float64."""
    generator = torch.Generator().manual_seed(seed)
    uniform = lambda *shape: torch.rand(*shape, generator=generator, dtype=torch.float64)
    means = uniform(images, n, 2) * torch.tensor([W + 8.0, H + 8.0]) - 4
    L = torch.randn(images, n, 2, 2, generator=generator, dtype=torch.float64)
    covariances = 6 * L @ L.mT + 2 * torch.eye(2, dtype=torch.float64)
    inverse = torch.linalg.inv(covariances)
    conics = torch.stack([inverse[..., 0, 0], inverse[..., 0, 1], inverse[..., 1, 1]], dim=-1)
    radii = 3.5 * torch.diagonal(covariances, dim1=-2, dim2=-1).sqrt()
    body = (means, conics, uniform(images, n, channels), 0.1 + 0.85 * uniform(images, n))
    return *body, uniform(images, channels), radii.ceil(), uniform(images, n) + 1


def lists(means, radii, depths, size=SIZE):
    tiles = (-(-W // size), -(-H // size))
    _, keys, ids = isect_tiles(means, radii, depths, size, *tiles)
    return isect_offset_encode(keys, len(means), *tiles), ids


def dense(means, conics, colors, opacities, backgrounds, offsets, ids, size=SIZE):
    """gsplat's compositing, pixel by pixel and pair by pair, for torch's autograd."""
    ends = torch.cat([offsets.flatten()[1:], torch.tensor([len(ids)])]).view_as(offsets)
    means, conics, opacities = means.view(-1, 2), conics.view(-1, 3), opacities.view(-1)
    colors = colors.reshape(-1, colors.shape[-1])
    y, x = torch.meshgrid(*(torch.arange(k).double() + 0.5 for k in (H, W)), indexing="ij")
    pictures, alphas = [], []
    for image in range(len(offsets)):
        T = torch.ones(H, W, dtype=torch.float64)
        goes_on = torch.ones(H, W, dtype=torch.bool)
        color = torch.zeros(H, W, colors.shape[1], dtype=torch.float64)
        for row in range(offsets.shape[1]):
            for column in range(offsets.shape[2]):
                inside = (y // size == row) & (x // size == column)
                for i in ids[offsets[image, row, column] : ends[image, row, column]].tolist():
                    dx, dy, (a, b, c) = means[i, 0] - x, means[i, 1] - y, conics[i]
                    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
                    alpha = (opacities[i] * torch.exp(-sigma)).clamp(max=MAX)
                    touched = inside & goes_on & (sigma >= 0) & (alpha >= MIN)
                    goes_on = goes_on & ~(touched & (T * (1 - alpha) <= LAST))
                    alpha = torch.where(touched & goes_on, alpha, 0)
                    color = color + (T * alpha)[..., None] * colors[i]
                    T = T * (1 - alpha)
        pictures.append(color + T[..., None] * backgrounds[image])
        alphas.append(1 - T[..., None])
    return torch.stack(pictures), torch.stack(alphas)


def gradients(outputs, inputs, seed=5):
    generator = torch.Generator().manual_seed(seed)
    weights = [torch.randn(x.shape, generator=generator, dtype=torch.float64) for x in outputs]
    total = sum((x.double() * w).sum() for x, w in zip(outputs, weights, strict=True))
    return torch.autograd.grad(total, inputs)


@pytest.mark.parametrize("channels", [1, 3, 11])
def test_pictures_and_gradients_are_the_formulas(channels):
    *body, radii, depths = ellipses(channels=channels)
    tiles = lists(body[0], radii, depths)
    given = [x.clone().requires_grad_() for x in body]
    *first, behind = given
    found = rasterize_to_pixels(*first, W, H, SIZE, *tiles, backgrounds=behind)
    truth = dense(*given, *tiles)
    for a, b in zip(found, truth, strict=True):
        assert a.shape == b.shape and b.abs().max() > 0.1
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12)
    by_ours, by_formula = gradients(found, given), gradients(truth, given)
    names = ("means2d", "conics", "colors", "opacities", "backgrounds")
    for name, a, b in zip(names, by_ours, by_formula, strict=True):
        assert (a - b).norm() < 1e-11 * b.norm(), name

    single = [x.detach().float().requires_grad_() for x in body]
    *first, behind = single
    found = rasterize_to_pixels(*first, W, H, SIZE, *tiles, backgrounds=behind)
    assert found[0].dtype == torch.float32
    torch.testing.assert_close(found[0].double(), truth[0], rtol=0, atol=1e-5)
    for name, a, b in zip(names, gradients(found, single), by_formula, strict=True):
        assert (a - b).norm() < 1e-5 * b.norm(), name


def test_lists_say_who_is_drawn_and_in_which_order():
    *body, radii, depths = ellipses(images=1)
    *first, behind = body
    offsets, ids = lists(body[0], radii, depths)
    backwards = lists(body[0], radii, -depths + 3)
    few = torch.where(torch.arange(12) % 3 > 0, 1.0, 0.0)[None, :, None] * radii
    for tiles in (backwards, lists(body[0], few, depths), (offsets * 0, ids[:0])):
        found = rasterize_to_pixels(*first, W, H, SIZE, *tiles, backgrounds=behind)
        for a, b in zip(found, dense(*body, *tiles), strict=True):
            torch.testing.assert_close(a, b, rtol=0, atol=1e-12)
    black, alpha = rasterize_to_pixels(*first, W, H, SIZE, offsets, ids)
    torch.testing.assert_close(black, dense(*first, 0 * behind, offsets, ids)[0])
    assert alpha.shape == (1, H, W, 1)


@pytest.mark.parametrize("size", [8, 24, 40])
def test_other_sizes_of_tiles(size):
    *body, radii, depths = ellipses(images=1)
    tiles = lists(body[0], radii, depths, size)
    *first, behind = body
    found = rasterize_to_pixels(*first, W, H, size, *tiles, backgrounds=behind)
    torch.testing.assert_close(found[0], dense(*body, *tiles, size)[0], rtol=0, atol=1e-12)


def test_masked_tiles_show_the_background():
    *body, radii, depths = ellipses()
    tiles, (*first, behind) = lists(body[0], radii, depths), body
    masks = torch.tensor([[[1, 0, 1], [0, 1, 1]], [[0, 0, 0], [0, 0, 0]]]).bool()
    given = [x.clone().requires_grad_() for x in first]
    color, alpha = rasterize_to_pixels(*given, W, H, SIZE, *tiles, backgrounds=behind, masks=masks)
    whole, _ = rasterize_to_pixels(*first, W, H, SIZE, *tiles, backgrounds=behind)
    shown = masks.repeat_interleave(SIZE, 1).repeat_interleave(SIZE, 2)[:, :H, :W, None]
    expected = torch.where(shown, whole, behind[:, None, None])
    torch.testing.assert_close(color, expected, rtol=0, atol=1e-14)
    assert (alpha[~shown] == 0).all()
    by_colors = torch.autograd.grad(color.sum(), given[2])[0]
    assert by_colors[0].abs().sum() > 0 and by_colors[1].abs().sum() == 0


def test_the_stages_are_rasterization():
    """Packed and not, two cameras; absgrad too."""
    generator = torch.Generator().manual_seed(3)
    normal = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)
    n = 30
    means, quats, scales = 0.6 * normal(n, 3), normal(n, 4), 0.05 + 0.1 * normal(n, 3).abs()
    opacities, colors = torch.sigmoid(normal(n)), torch.rand(n, 3, generator=generator).double()
    viewmats = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    viewmats[:, 2, 3], viewmats[1, 0, 3] = 3, 0.4
    Ks = torch.tensor([[40.0, 0, W / 2], [0, 40, H / 2], [0, 0, 1]]).double().repeat(2, 1, 1)
    leaves = lambda: [x.clone().requires_grad_() for x in (means, quats, scales, opacities)]
    for packed in (False, True):
        given = leaves()
        truth, alphas, meta = rasterization(
            *given, colors, viewmats, Ks, W, H, packed=packed, absgrad=True, tile_size=SIZE
        )
        expected = gradients((truth, alphas), [*given, meta["means2d"]])
        mine = leaves()
        m, q, s, o = mine
        seen = fully_fused_projection(m, None, q, s, viewmats, Ks, W, H, packed=packed, opacities=o)
        if packed:
            _, cameras, ids, radii, means2d, depths, conics, _ = seen
            bodies = (colors[ids], o[ids])
            extra = {"packed": True, "n_images": 2, "image_ids": cameras, "gaussian_ids": ids}
        else:
            radii, means2d, depths, conics, _ = seen
            bodies, extra = (colors.expand(2, n, 3), o.expand(2, n)), {}
        _, keys, flat = isect_tiles(means2d, radii, depths, SIZE, TW, TH, **extra)
        offsets = isect_offset_encode(keys, 2, TW, TH)
        found = rasterize_to_pixels(
            means2d, conics, *bodies, W, H, SIZE, offsets, flat, packed=packed, absgrad=True
        )
        for a, b in zip(found, (truth, alphas), strict=True):
            torch.testing.assert_close(a, b, rtol=0, atol=1e-9)
        for a, b in zip(gradients(found, [*mine, means2d]), expected, strict=True):
            assert (a - b).norm() < 1e-8 * b.norm()
        there = meta["means2d"].absgrad
        assert (means2d.absgrad - there).norm() < 1e-8 * there.norm() > 0


def test_ellipses_that_are_none_are_not_drawn():
    *body, radii, depths = ellipses(images=1)
    tiles, (means, conics, colors, opacities, behind) = lists(body[0], radii, depths), body
    conics, opacities = conics.clone(), opacities.clone()
    conics[0, 0], conics[0, 1], opacities[0, 2] = torch.tensor([-1.0, 0, 1]), 0, 0
    given = [x.requires_grad_() for x in (means, conics, colors, opacities)]
    color, _ = rasterize_to_pixels(*given, W, H, SIZE, *tiles, backgrounds=behind)
    radii[0, :3] = 0
    without = lists(means.detach(), radii, depths)
    rest = rasterize_to_pixels(*given, W, H, SIZE, *without, backgrounds=behind)[0]
    torch.testing.assert_close(color, rest, rtol=0, atol=1e-14)
    for found in torch.autograd.grad(color.square().sum(), given):
        assert torch.isfinite(found).all() and (found[0, :3] == 0).all()
        assert found.abs().sum() > 0


def test_what_does_not_fit_is_refused():
    *body, radii, depths = ellipses()
    (offsets, ids), (means, conics, colors, opacities, behind) = lists(body[0], radii, depths), body
    call = lambda *first, size=SIZE, at=offsets, who=ids, **more: rasterize_to_pixels(
        *(first or body[:4]), W, H, size, at, who, **more
    )
    nan = means.clone()
    nan[0, 0, 0] = torch.nan
    for run, message in (
        (lambda: call(means, conics[:, 1:], colors, opacities), r"conics must be \(2, 12, 3\)"),
        (lambda: call(means, conics, colors, opacities.float()), "all tensors must have one dtype"),
        (lambda: call(nan, conics, colors, opacities), "means2d must be finite"),
        (lambda: call(size=12), "tile_size must be a multiple of 8, got 12"),
        (lambda: call(size=8), "isect_offsets must cover the picture, got 3x2 tiles of 8 px"),
        (lambda: call(at=offsets[:1]), "isect_offsets must be .* of .2,. pictures"),
        (lambda: call(at=offsets.flip(0)), "isect_offsets must ascend from 0 to"),
        (lambda: call(who=ids + 24), "flatten_ids must be 0 to 23, got 24 to"),
        (lambda: call(backgrounds=behind[0]), r"backgrounds must be \(2, 3\)"),
        (lambda: call(masks=offsets[0] > 0), r"masks must be \(2, 2, 3\)"),
        (lambda: call(packed=True), r"means2d must be \(nnz, 2\)"),
        (lambda: isect_tiles(means, radii[0], depths, SIZE, TW, TH), "radii must be"),
        (lambda: isect_tiles(means, radii, depths, 0, TW, TH), "tile_size, tile_width"),
        (lambda: isect_tiles(means[0], radii[0], depths[0], SIZE, TW, TH, packed=True), "n_images"),
    ):
        with pytest.raises(ValueError, match=message):
            run()


def test_gradients_are_differentiated_once():
    *body, radii, depths = ellipses(images=1)
    given = [x.clone().requires_grad_() for x in body[:4]]
    color, _ = rasterize_to_pixels(*given, W, H, SIZE, *lists(body[0], radii, depths))
    (by_means,) = torch.autograd.grad(color.square().sum(), given[0], create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        by_means.sum().backward()


def test_tiles_are_those_that_boxes_touch():
    means, *_, radii, depths = ellipses(seed=4)
    radii[0, 3], radii[1, 5, 0] = 0, 0
    counts, keys, ids = isect_tiles(means, radii, depths, SIZE, TW, TH)
    expected = {}
    for image in range(2):
        for i in range(12):
            if (radii[image, i] == 0).any():
                continue
            low, high = means[image, i] - radii[image, i], means[image, i] + radii[image, i]
            for y in range(TH):
                for x in range(TW):
                    corner = torch.tensor([x, y]) * SIZE
                    if (low < corner + SIZE).all() and (high > corner).all():
                        where = (image, y * TW + x, float(depths[image, i].float()))
                        expected[where] = image * 12 + i
    bits = depths.float().view(torch.int32)
    depth_of = dict(zip(bits.flatten().tolist(), depths.float().flatten().tolist(), strict=True))
    found = {
        (key >> 35, (key >> 32) & 7, depth_of[key & 0xFFFFFFFF]): i
        for key, i in zip(keys.tolist(), ids.tolist(), strict=True)
    }
    assert found == expected and list(found) == sorted(found)
    assert counts.shape == (2, 12) and counts.dtype == torch.int32
    assert torch.equal(counts.flatten(), torch.bincount(ids, minlength=24).int())
    offsets = isect_offset_encode(keys, 2, TW, TH)
    assert offsets.flatten().tolist() == [
        sum((image, tile) < here for image, tile, _ in found)
        for here in ((image, tile) for image in range(2) for tile in range(TW * TH))
    ]
    _, unsorted, of = isect_tiles(means, radii, depths, SIZE, TW, TH, sort=False)
    assert (of.diff() >= 0).all() and torch.equal(unsorted.sort()[0], keys)


@pytest.mark.skipif(importlib.util.find_spec("gsplat") is None, reason="gsplat is not installed")
def test_tiles_are_gsplats():
    from gsplat.cuda import _torch_impl as theirs

    means, *_, radii, depths = ellipses(seed=6)
    arguments = (means.float(), radii.float(), depths.float(), SIZE, TW, TH)
    found, expected = isect_tiles(*arguments), theirs._isect_tiles(*arguments)
    for a, b in zip(found, expected, strict=True):
        assert torch.equal(a, b) and a.dtype == b.dtype
    offsets = theirs._isect_offset_encode(expected[1], 2, TW, TH)
    assert torch.equal(isect_offset_encode(found[1], 2, TW, TH), offsets)
