"""Perceptual distances of images, in the features of a convolutional network.

* ``VGG16``: the paper's perceptual term, features of the pre-trained network. Its weights are not
  shipped: they are read from the user's state dict, with keys ``features.N.weight``.
* ``rand_vgg``: the layout of VGG16 with random weights from a fixed seed. Untrained features see
  edges and textures at several scales too, so they order blur and noise sensibly. It replaces
  missing weights; its values compare only with each other.
* ``LPIPS`` (Zhang et al. 2018): a metric only; needs a trained network and its linear heads.

For features ``f_l`` (D_l, H_l, W_l) of tap ``l`` = 1..L, and ``u_l = f_l / |f_l|`` along channels:

    |VGG(C) - VGG(I)| = 1/L Σ_l mean |f_l(C) - f_l(I)|                          the loss      (P1)
    d(C, I) = Σ_l mean_hw Σ_d w_ld (u_ld(C) - u_ld(I))²                         the metrics   (P2)

with the linear heads w of LPIPS, and w = 1/L for ``rand_vgg``.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils import skip_init

from gva_mi.core.cpu import core_for_torch, in_torch_thread, sqrt
from gva_mi.core.errors import InputError, reason_of

VGG16_WIDTHS = ((64, 64), (128, 128), (256,) * 3, (512,) * 3, (512,) * 3)  # a pool after each group
VGG16_TAPS = (3, 8, 15, 22, 29)  # the last ReLU of each group, as an index into the layers
ALEXNET_TAPS = (1, 4, 7, 9, 11)  # each of its ReLUs
RAND_SEED = 0  # part of the definition of rand_vgg
RAND_WIDTH = 0.25  # share of VGG16's channels: a tenth of its time on a CPU


def _conv(*arguments: int, **options: int) -> nn.Conv2d:
    """Make a convolution without weights; torch's default would draw from the global seed."""
    return skip_init(nn.Conv2d, *arguments, **options)


def vgg16(width: float = 1.0) -> nn.Sequential:
    """Make VGG16's convolutions, with layers indexed as in the keys ``features.N``."""
    layers, channels = [], 3
    for group in VGG16_WIDTHS:
        for full in group:
            wanted = round(full * width)
            layers += [_conv(channels, wanted, 3, padding=1), nn.ReLU()]
            channels = wanted
        layers.append(nn.MaxPool2d(2))
    return nn.Sequential(*layers)


def alexnet() -> nn.Sequential:
    """Make AlexNet's convolutions, with layers indexed as in the keys ``features.N``."""
    return nn.Sequential(
        *(_conv(3, 64, 11, stride=4, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(_conv(64, 192, 5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(_conv(192, 384, 3, padding=1), nn.ReLU()),
        *(_conv(384, 256, 3, padding=1), nn.ReLU()),
        *(_conv(256, 256, 3, padding=1), nn.ReLU()),
    )


def random_vgg() -> nn.Sequential:
    """Make a quarter of VGG16's width with He et al.'s random weights, which keep the scale."""
    layers = vgg16(RAND_WIDTH)
    generator = torch.Generator().manual_seed(RAND_SEED)
    for layer in layers:
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu", generator=generator)
            nn.init.zeros_(layer.bias)
    return layers


def load_layers(layers: nn.Sequential, path: Path, name: str) -> nn.Sequential:
    """Fill layers with the weights of a file; an InputError unless it holds those of ``name``."""
    state = _load_state(path)
    found = {key.removeprefix("features."): x for key, x in state.items() if "features." in key}
    for key, wanted in layers.state_dict().items():
        if key not in found or found[key].shape != wanted.shape:
            got = f"{tuple(found[key].shape)}" if key in found else "nothing"
            raise InputError(
                f"{path}: not weights of {name}: 'features.{key}' must be "
                f"{tuple(wanted.shape)}, found {got}"
            )
    layers.load_state_dict({key: found[key] for key in layers.state_dict()})
    return layers


def load_heads(path: Path, layers: nn.Sequential, taps: Sequence[int]) -> list[Tensor]:
    """Read the linear heads of LPIPS, one (D_l,) for each tap; an InputError unless they fit."""
    state, heads = _load_state(path), []
    for k, tap in enumerate(taps):
        key, channels = f"lin{k}.model.1.weight", layers[tap - 1].out_channels
        if key not in state or state[key].numel() != channels:
            raise InputError(f"{path}: not LPIPS heads: '{key}' must hold {channels} numbers")
        heads.append(state[key].flatten().float())
    return heads


def _load_state(path: Path) -> dict[str, Tensor]:
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected a torch state dict") from None
    except Exception as error:
        raise InputError(f"{path}: not a torch state dict ({reason_of(error)})") from None
    if not isinstance(state, dict) or not all(isinstance(x, Tensor) for x in state.values()):
        raise InputError(f"{path}: not a torch state dict of tensors")
    return state


LOSS_TAPS = VGG16_TAPS[:3]  # deeper layers see more than a training window holds
LpipsNetwork = Literal["alex", "vgg"]  # under the names of the package lpips

BETA = 1e-12  # differences of features that count as none

# Input of the trained networks: ImageNet's mean and standard deviation per channel.
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class LpipsParts(NamedTuple):
    """A network that LPIPS may use."""

    name: str  # as reports give it
    make: Callable[[], nn.Sequential]
    taps: Sequence[int]
    files: tuple[str, str]  # fields of Weights: the network's and its linear heads'


LPIPS: Mapping[LpipsNetwork, LpipsParts] = {  # the first that is found is used
    "alex": LpipsParts("AlexNet", alexnet, ALEXNET_TAPS, ("alexnet", "lpips_alex")),
    "vgg": LpipsParts("VGG16", vgg16, VGG16_TAPS, ("vgg16", "lpips_vgg")),
}


class FeatureDistance(nn.Module):
    """Eq. P1: the perceptual loss of two images (H, W, 3), in the features of a fixed network."""

    def __init__(self, layers: nn.Sequential, taps: Sequence[int]) -> None:
        super().__init__()
        self.layers = layers[: max(taps) + 1].requires_grad_(False).eval()
        # Channels last, as in pictures: a quarter less time on a CPU.
        self.layers.to(memory_format=torch.channels_last)
        self.taps = tuple(taps)
        self.register_buffer("mean", torch.tensor(MEAN).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor(STD).view(1, 3, 1, 1))

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

    def __init__(
        self, layers: nn.Sequential, taps: Sequence[int], heads: Sequence[Tensor] | None = None
    ) -> None:
        super().__init__(layers, taps)
        self.heads = heads  # one (D_l,) per tap; None: all weights 1/L

    @torch.no_grad()
    def forward(self, image: Tensor, target: Tensor, size: Sequence[int] | None = None) -> Tensor:
        """Return the distance, without gradients.

        Args:
            image, target: two pictures (H, W, 3), or the same part of them.
            size: (H, W) of pictures that are equal outside of this part; None: the part is all.
        """
        total = torch.zeros(())
        counts = self._positions(np.array(size or image.shape[:2]))
        seen = zip(self.features(image), self.features(target), counts, strict=True)
        for k, (f, g, count) in enumerate(seen):
            difference = (_unit(f) - _unit(g)).square()
            weight = self.heads[k].view(1, -1, 1, 1) if self.heads else 1 / len(self.taps)
            total = total + (weight * difference).sum() / count
        return total

    def _positions(self, sides: np.ndarray) -> Iterator[int]:
        """Yield the number of positions of features at each tap, for a picture's (H, W)."""
        for k, layer in enumerate(self.layers):
            if not isinstance(layer, nn.ReLU):
                size, step, edge = map(np.max, (layer.kernel_size, layer.stride, layer.padding))
                sides = (sides + 2 * edge - size) // step + 1
            if k in self.taps:
                yield int(sides.prod())


def rand_vgg_loss() -> FeatureDistance:
    """Return the perceptual loss in random features."""
    return FeatureDistance(random_vgg(), LOSS_TAPS)


def vgg16_loss(weights: Path) -> FeatureDistance:
    """Return the paper's perceptual loss, with the user's weights of VGG16.

    Raises:
        InputError: the file does not hold them.
    """
    return FeatureDistance(load_layers(vgg16(), weights, "VGG16"), LOSS_TAPS)


def rand_vgg() -> FeatureMetric:
    """Return the metric ``rand_vgg``."""
    return FeatureMetric(random_vgg(), VGG16_TAPS)


def lpips(weights: Weights) -> FeatureMetric | None:
    """Return LPIPS if a network and its linear heads were found (AlexNet, else VGG16), else None.

    Raises:
        InputError: a file does not hold what its name says.
    """
    found = weights.lpips_network
    if found is None:
        return None
    of_layers, of_heads = weights.lpips_files
    layers = load_layers(found.make(), of_layers, found.name)
    return FeatureMetric(layers, found.taps, load_heads(of_heads, layers, found.taps))


@dataclass(frozen=True)
class Weights:
    """Files of weights found on this machine, or None."""

    vgg16: Path | None = None  # state dict, features.N.weight and .bias
    alexnet: Path | None = None  # state dict likewise
    lpips_vgg: Path | None = None  # linear heads, linK.model.1.weight
    lpips_alex: Path | None = None  # linear heads likewise

    @property
    def lpips_network(self) -> LpipsParts | None:
        """The network that :func:`lpips` would use."""
        return next((parts for parts in LPIPS.values() if all(self._files(parts))), None)

    @property
    def lpips_files(self) -> list[Path]:
        """The files of that network and of its linear heads; empty without them."""
        return self._files(self.lpips_network) if self.lpips_network else []

    def _files(self, parts: LpipsParts) -> list[Path | None]:
        return [getattr(self, name) for name in parts.files]

    def of_lpips(self, network: LpipsNetwork | None) -> Weights:
        """Return the files of LPIPS on one network alone; all of them if ``network`` is None.

        LPIPS on one network cannot be compared with LPIPS on the other.

        Raises:
            InputError: files of the network were not found.
        """
        if network is None:
            return self
        needed = LPIPS[network].files
        if missing := [f"{name}*.pth" for name in needed if getattr(self, name) is None]:
            raise InputError(
                f"--lpips {network}: found no {' and no '.join(missing)} in torch's cache of "
                "weights (hub/checkpoints in TORCH_HOME) or in an installed package lpips"
            )
        return Weights(**{name: getattr(self, name) for name in needed})


def find_weights() -> Weights:
    """Look for weights in torch's cache, and in an installed ``lpips``.

    Files are ``vgg16*.pth``, ``alexnet*.pth``, ``lpips_vgg.pth`` and ``lpips_alex.pth``.
    """
    cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
    torch_home = Path(os.environ.get("TORCH_HOME", str(Path(cache) / "torch")))
    checkpoints = torch_home / "hub" / "checkpoints"
    package = importlib.util.find_spec("lpips")  # importing it requires torchvision
    heads = Path(package.origin).parent / "weights" / "v0.1" if package else None

    def first(*paths: Path) -> Path | None:
        return next((p for p in paths if p.is_file()), None)

    def named(pattern: str) -> Path | None:
        return first(*sorted(checkpoints.glob(pattern)))

    return Weights(
        vgg16=named("vgg16*.pth"),
        alexnet=named("alexnet*.pth"),
        lpips_vgg=named("lpips_vgg.pth") or (first(heads / "vgg.pth") if heads else None),
        lpips_alex=named("lpips_alex.pth") or (first(heads / "alex.pth") if heads else None),
    )


def mean_absolute(f: Tensor, g: Tensor) -> Tensor:
    """Return ``mean |f - g|``, differentiable in f.

    The smooth norm is the same function beyond its ``beta``, and has its gradient in one pass over
    memory, where ``(f - g).abs().mean()`` takes four.
    """
    # In the order of memory: in another one the gradient takes four times as long.
    f, g = f.permute(0, 2, 3, 1), g.permute(0, 2, 3, 1)
    return torch.nn.functional.smooth_l1_loss(f, g, beta=BETA)


def _unit(features: Tensor) -> Tensor:
    """Normalise feature vectors (1, D, H, W) along the channels."""
    return features / (sqrt(features.square().sum(1, keepdim=True)) + 1e-10)
