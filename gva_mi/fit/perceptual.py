"""Perceptual distances of images, in the features of a convolutional network.

* ``VGG16``: the paper's perceptual term, features of the pre-trained network. Its weights are not
  shipped: they are read from the user's state dict, with keys ``features.N.weight``.
* ``rand_vgg``: the layout of VGG16 with random weights from a fixed seed. Untrained features see
  edges and textures at several scales too, so they order blur and noise sensibly. It replaces
  missing weights; its values compare only with each other.
* ``LPIPS`` (Zhang et al. 2018): a metric only, on VGG16 as in the tables of 3DGS; needs the trained
  network and its linear heads.

For features ``f_l`` (D_l, H_l, W_l) of tap ``l`` = 1..L, and ``u_l = f_l / |f_l|`` along channels:

    |VGG(C) - VGG(I)| = 1/L Σ_l mean |f_l(C) - f_l(I)|                          the loss      (P1)
    d(C, I) = Σ_l mean_hw Σ_d w_ld (u_ld(C) - u_ld(I))²                         the metrics   (P2)

with the linear heads w of LPIPS, and w = 1/L for ``rand_vgg``.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.utils import skip_init

from gva_mi.core.cpu import core_for_torch, in_torch_thread, sqrt
from gva_mi.core.errors import InputError, reason_of
from gva_mi.core.files import require_file

# Channels of VGG16 (Simonyan and Zisserman 2015), with a pool after each group.
VGG16_WIDTHS = ((64, 64), (128, 128), (256,) * 3, (512,) * 3, (512,) * 3)
TAPS = (3, 8, 15, 22, 29)  # the last ReLU of each group, as an index into the layers
LOSS_TAPS = TAPS[:3]  # chosen: deeper layers see more than a training window holds
RAND_SEED = 0  # part of the definition of rand_vgg
RAND_WIDTH = 0.25  # share of VGG16's channels; chosen: a tenth of its time on a CPU
L1_BETA = 1e-12  # differences of features below it count as none; chosen: below any real one

# Input of the trained networks: ImageNet's mean and standard deviation per channel, in [0, 1].
IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class FeatureDistance(nn.Module):
    """Eq. P1: the perceptual loss of two images (H, W, 3), in the features of a fixed network."""

    def __init__(self, layers: nn.Sequential, taps: Sequence[int]) -> None:
        super().__init__()
        self.layers = layers[: max(taps) + 1].requires_grad_(False).eval()
        # Channels last, as in pictures: a quarter less time on a CPU.
        self.layers.to(memory_format=torch.channels_last)
        self.taps = tuple(taps)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(1, 3, 1, 1))

    def features(self, image: Tensor) -> list[Tensor]:
        """Return features of an image (H, W, 3) in [0, 1] at the taps, each (1, D, H', W')."""
        x = (image.permute(2, 0, 1)[None] - self.mean) / self.std
        found = []
        for k, layer in enumerate(self.layers):
            x = layer(x)
            if k in self.taps:
                found.append(x)
        return found

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        """Return the distance, a scalar, differentiable in ``image`` but not in ``target``."""
        with core_for_torch():
            constant = in_torch_thread(torch.no_grad()(self.features), target)
            pairs = zip(self.features(image), constant.result(), strict=True)
        return torch.stack([mean_absolute(f, g) for f, g in pairs]).mean()


class FeatureMetric(FeatureDistance):
    """Eq. P2: the distance of unit feature vectors; LPIPS with heads, ``rand_vgg`` without."""

    def __init__(self, layers: nn.Sequential, heads: Sequence[Tensor] | None = None) -> None:
        super().__init__(layers, TAPS)
        self.heads = heads  # one (D_l,) per tap; None: all weights 1/L

    @torch.no_grad()
    def forward(self, image: Tensor, target: Tensor, size: Sequence[int] | None = None) -> Tensor:
        """Return the distance, without gradients.

        Args:
            image, target: two pictures (H, W, 3), or the same part of them.
            size: (H, W) of pictures that are equal outside of this part; None: the part is all.
        """
        return self.to_features(image, self.features(target), size or image.shape[:2])

    @torch.no_grad()
    def to_features(self, image: Tensor, target: list[Tensor], size: Sequence[int]) -> Tensor:
        """Return the distance to a target with known features; see :meth:`forward`."""
        (height, width), total = size, torch.zeros(())
        for k, (f, g) in enumerate(zip(self.features(image), target, strict=True)):
            difference = (_unit(f) - _unit(g)).square()
            weight = self.heads[k].view(1, -1, 1, 1) if self.heads else 1 / len(TAPS)
            count = (height >> k) * (width >> k)  # positions of features: a pool in each group
            total = total + (weight * difference).sum() / count
        return total


@dataclass(frozen=True)
class Weights:
    """Files of weights found on this machine, or None."""

    vgg16: Path | None = None  # state dict, features.N.weight and .bias
    lpips: Path | None = None  # linear heads of LPIPS on VGG16, linK.model.1.weight

    @property
    def of_lpips(self) -> list[Path]:
        """The two files that LPIPS needs; empty if one was not found."""
        return [self.vgg16, self.lpips] if self.vgg16 and self.lpips else []


def find_weights() -> Weights:
    """Look for ``vgg16*.pth`` and ``lpips_vgg.pth`` in torch's cache, and in an installed lpips."""
    cache = Path(torch.hub.get_dir()) / "checkpoints"
    package = importlib.util.find_spec("lpips")  # importing it requires torchvision
    heads = [cache / "lpips_vgg.pth"]
    if package:
        heads.append(Path(package.origin).parent / "weights/v0.1/vgg.pth")
    first = lambda paths: next((path for path in paths if path.is_file()), None)
    return Weights(first(sorted(cache.glob("vgg16*.pth"))), first(heads))


def rand_vgg_loss() -> FeatureDistance:
    """Return the perceptual loss in random features."""
    return FeatureDistance(random_vgg(), LOSS_TAPS)


def vgg16_loss(weights: Path) -> FeatureDistance:
    """Return the paper's perceptual loss, with the user's weights of VGG16.

    Raises:
        InputError: the file does not hold them.
    """
    return FeatureDistance(load_vgg16(weights), LOSS_TAPS)


def rand_vgg() -> FeatureMetric:
    """Return the metric ``rand_vgg``."""
    return FeatureMetric(random_vgg())


def lpips(weights: Weights) -> FeatureMetric | None:
    """Return LPIPS on VGG16 if the network and its linear heads were found, else None.

    Raises:
        InputError: a file does not hold what its name says.
    """
    if not weights.of_lpips:
        return None
    layers, state, heads = load_vgg16(weights.vgg16), _load_state(weights.lpips), []
    for k, group in enumerate(VGG16_WIDTHS):
        key = f"lin{k}.model.1.weight"
        if key not in state or state[key].numel() != group[-1]:
            raise InputError(
                f"{weights.lpips}: not LPIPS heads: '{key}' must hold {group[-1]} numbers"
            )
        heads.append(state[key].flatten().float())
    return FeatureMetric(layers, heads)


def vgg16(width: float = 1.0) -> nn.Sequential:
    """Make VGG16's convolutions, with layers indexed as in the keys ``features.N``."""
    layers, channels = [], 3
    for group in VGG16_WIDTHS:
        for full in group:
            wanted = round(full * width)
            # without weights; torch's default would draw from the global seed
            layers += [skip_init(nn.Conv2d, channels, wanted, 3, padding=1), nn.ReLU()]
            channels = wanted
        layers.append(nn.MaxPool2d(2))
    return nn.Sequential(*layers)


def random_vgg() -> nn.Sequential:
    """Make a quarter of VGG16's width with He et al.'s random weights, which keep the scale."""
    layers = vgg16(RAND_WIDTH)
    generator = torch.Generator().manual_seed(RAND_SEED)
    for layer in layers:
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu", generator=generator)
            nn.init.zeros_(layer.bias)
    return layers


def load_vgg16(path: Path) -> nn.Sequential:
    """Make VGG16 with the weights of a file; an InputError unless it holds them."""
    layers, state = vgg16(), _load_state(path)
    found = {key.removeprefix("features."): x for key, x in state.items() if "features." in key}
    for key, wanted in layers.state_dict().items():
        if key not in found or found[key].shape != wanted.shape:
            got = f"{tuple(found[key].shape)}" if key in found else "nothing"
            raise InputError(
                f"{path}: not weights of VGG16: 'features.{key}' must be "
                f"{tuple(wanted.shape)}, found {got}"
            )
    layers.load_state_dict({key: found[key] for key in layers.state_dict()})
    return layers


def _load_state(path: Path) -> dict[str, Tensor]:
    require_file(path, "a torch state dict")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise InputError(f"{path}: not a torch state dict ({reason_of(error)})") from None
    if not isinstance(state, dict) or not all(isinstance(x, Tensor) for x in state.values()):
        raise InputError(f"{path}: not a torch state dict of tensors")
    return state


def mean_absolute(f: Tensor, g: Tensor) -> Tensor:
    """Return ``mean |f - g|``, differentiable in f.

    The smooth norm is the same function beyond its ``beta``, and has its gradient in one pass over
    memory, where ``(f - g).abs().mean()`` takes four.
    """
    # In the order of memory: in another one the gradient takes four times as long.
    f, g = f.permute(0, 2, 3, 1), g.permute(0, 2, 3, 1)
    return torch.nn.functional.smooth_l1_loss(f, g, beta=L1_BETA)


def _unit(features: Tensor) -> Tensor:
    """Normalise feature vectors (1, D, H, W) along the channels."""
    return features / (sqrt(features.square().sum(1, keepdim=True)) + 1e-10)
