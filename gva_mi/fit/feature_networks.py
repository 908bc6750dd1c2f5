"""The networks whose features perceptual distances compare: VGG16, AlexNet, and a random VGG16.

Trained weights are read from torch's state dicts, with keys ``features.N.weight``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.utils import skip_init

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
