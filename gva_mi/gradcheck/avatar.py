"""Check an avatar's gradients: the whole chain from pose, shape and Gaussians to the picture.

The loss is L = <w, image>, random weights w on colour, alpha and depth. Its gradient by every
input, by ``Avatar.forward`` and ``render`` as a fit calls them, in float64, is compared

* with central differences of fourth order and with tangents, both in float64, along a random
  direction and along single entries,
* with gradients and tangents in float32.

All inputs are float32 numbers, so float32 is blamed for its arithmetic only. Pixels at a step of
the picture are left out as in :mod:`gva_mi.gradcheck.splat`; Gaussians at a kink of the network's
relu too, see posed_avatar.py.
"""

from __future__ import annotations

from functools import partial

import torch
from torch import Generator, Tensor

from gva_mi.core.threads import one_torch_thread
from gva_mi.gradcheck.engine import Check, Report
from gva_mi.gradcheck.posed_avatar import NETWORK, PosedAvatar
from gva_mi.gradcheck.probes import IMAGES, Probe, Tensors, differences, leaves
from gva_mi.splat import reference, render

F64, F32 = 1e-8, 1e-5  # the greatest relative L2 error allowed
BAND = 1e-3  # relative distance of an alpha to its cut-off, beyond reach of a difference's steps
STEP = 1e-5  # of a difference, in the input's units
STEPS = {  # times it: inputs that move many pixels, or a small part of one
    "rotations": 0.1, "transl": 0.1, "means": 0.1, "betas": 20.0, "expression": 60.0,
    "light": 30.0,
}  # fmt: skip
NETWORK_STEP = 4.0  # the same for the network's weights; well within posed_avatar.py's KINK
FEW = 4  # an input of so many times the entries asked for is differentiated by each of its own


def check_avatar(
    posed: PosedAvatar,
    *,
    tolerances: tuple[float, float] = (F64, F32),
    entries: int = 3,
    seed: int = 0,
) -> Report:
    """Check the gradients of an avatar's picture.

    Args:
        posed: the avatar, its pose and its camera; some hundred Gaussians take seconds.
        tolerances: the greatest relative L2 errors allowed in float64 and in float32.
        entries: how many entries of every input to differentiate one by one; of an input of few
            entries (at most 4 times as many) all.
        seed: of the loss's weights and of the choice of entries.
    """
    f64, f32 = tolerances
    with one_torch_thread():
        draw = partial(_images, posed)
        check = _check_of(posed, entries, Generator().manual_seed(seed))
        rows = list(check.tangents(draw, "f64", f64))
        for name in posed.values:
            share = NETWORK_STEP if name.startswith(NETWORK) else STEPS.get(name, 1.0)
            moves = partial(differences, draw, posed.values, name, step=share * STEP)
            rows.append(check.along("differences", name, moves, f64))
        rows += check.methods(draw, "f32", f32, f32, f32)
    left_out = f"{int(check.band.sum())} at a step left out"
    count = len(posed.values["means"])
    return Report(tuple(rows), f"{count} Gaussians, {check.band.numel()} pixels, {left_out}")


def _images(posed: PosedAvatar, values: Tensors) -> list[Tensor]:
    gaussians = posed.gaussians(values)
    background = posed.background.to(gaussians.means.dtype)
    image = render(gaussians, posed.camera, background=background)
    return [image.color, image.alpha, image.depth]


def _check_of(posed: PosedAvatar, entries: int, generator: Generator) -> Check:
    """Draw a loss; return it with the picture and the gradients in float64."""
    inputs = leaves(posed.values)
    band = reference.threshold_band(posed.gaussians(inputs), posed.camera, alpha=BAND)
    # Not about zero: a gradient whose terms cancel to a thousandth loses three digits, and no code
    # is to blame.
    w = 1 + torch.randn(*band.shape, 5, generator=generator).double()
    w[band] = 0
    weights = dict(zip(IMAGES, (w[..., :3], w[..., 3], w[..., 4]), strict=True))
    images = dict(zip(IMAGES, _images(posed, inputs), strict=True))
    count = lambda g: g.numel() if g.numel() <= FEW * entries else entries
    probe = lambda gradient: Probe.among(gradient, count(gradient), generator)
    return Check.of(inputs, images, weights, band, probe)
