"""Perceptual distances: of a random network, and of the user's weights."""

import pytest
import torch
from scipy.ndimage import gaussian_filter

from gva_mi.core.errors import InputError
from gva_mi.fit import perceptual
from gva_mi.fit.perceptual import (
    Weights,
    find_weights,
    lpips,
    mean_absolute,
    rand_vgg,
    rand_vgg_loss,
    vgg16_loss,
)

SIZE = 48


@pytest.fixture
def picture():
    """Discs of several sizes and colours: edges at several scales."""
    generator = torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    image = torch.ones(SIZE, SIZE, 3)
    for _ in range(25):
        cx, cy, radius = (torch.rand(3, generator=generator) * torch.tensor([48, 48, 8])).tolist()
        image[(x - cx) ** 2 + (y - cy) ** 2 < radius**2] = torch.rand(3, generator=generator)
    return image


def blurred(image, sigma):
    return torch.from_numpy(gaussian_filter(image.numpy(), (sigma, sigma, 0)))


def test_the_loss_is_the_mean_absolute_difference_with_its_gradient():
    f, g = torch.randn(2, 1, 4, 6, 5, generator=torch.Generator().manual_seed(0)).unbind()
    f[0, 0] = g[0, 0]  # equal features pull nowhere
    f.requires_grad_(True)
    loss = mean_absolute(f, g)
    loss.backward()
    difference = (f - g).detach()
    torch.testing.assert_close(loss.detach(), difference.abs().mean())
    torch.testing.assert_close(f.grad, difference.sign() / difference.numel())


@pytest.mark.parametrize("distance", [rand_vgg, rand_vgg_loss])
def test_more_blur_is_farther(distance, picture):
    measure = distance()
    far = [float(measure(blurred(picture, sigma), picture)) for sigma in (0.5, 1, 2, 4)]
    assert far == sorted(far) and far[0] > 0


def test_the_loss_trains_the_image_and_not_the_network(picture):
    distance = rand_vgg_loss()
    image = blurred(picture, 1).requires_grad_()
    target = picture.clone().requires_grad_()
    distance(image, target).backward()
    assert image.grad.isfinite().all() and (image.grad != 0).any()
    assert target.grad is None
    assert not any(p.requires_grad for p in distance.parameters())


@pytest.fixture
def weights(tmp_path, monkeypatch):
    """Files in the form of the trained networks', with random numbers in them."""
    generator = torch.Generator().manual_seed(1)
    noise = lambda state: {
        f"features.{k}": 0.1 * torch.randn(x.shape, generator=generator) for k, x in state.items()
    }
    monkeypatch.setattr(perceptual, "VGG16_WIDTHS", ((4, 4), (8, 8), (8,) * 3, (8,) * 3, (8,) * 3))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    folder = tmp_path / "hub" / "checkpoints"
    folder.mkdir(parents=True)
    torch.save(noise(perceptual.vgg16().state_dict()), folder / "vgg16-0.pth")
    widths = (4, 8, 8, 8, 8)
    heads = {f"lin{k}.model.1.weight": torch.rand(1, w, 1, 1) for k, w in enumerate(widths)}
    torch.save(heads, folder / "lpips_vgg.pth")
    return find_weights()


def test_the_users_weights_are_found_and_used(weights, picture):
    assert [path.name for path in weights.of_lpips] == ["vgg16-0.pth", "lpips_vgg.pth"]
    assert vgg16_loss(weights.vgg16)(blurred(picture, 1), picture) > 0
    metric = lpips(weights)
    assert metric(picture, picture) == 0 and metric(blurred(picture, 1), picture) > 0
    assert lpips(Weights()) is None and not Weights().of_lpips


def test_files_that_are_no_weights_are_refused(tmp_path):
    path = tmp_path / "vgg16.pth"
    with pytest.raises(InputError, match="no such file"):
        vgg16_loss(path)
    path.write_bytes(b"not a state dict")
    with pytest.raises(InputError, match="not a torch state dict"):
        vgg16_loss(path)
    torch.save({"features.0.weight": torch.zeros(4, 3, 3, 3)}, path)
    with pytest.raises(InputError, match="'features.0.weight' must be"):
        vgg16_loss(path)
