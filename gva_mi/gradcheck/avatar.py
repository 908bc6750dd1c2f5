"""Check an avatar's gradients: the whole chain from pose to picture, and every link alone.

The loss is L = <w, image>, random weights w on colour, alpha and depth. Of each link alone, at the
values and with the gradient that reach it in the chain,

* central differences of fourth order and the tangent, both in float64, along a random direction
  and along single entries, are compared with its gradient by every input,
* its float32 gradient is compared with its float64 gradient.

So an error is found in the link where it is. The whole chain is checked likewise by every first
input. ``Avatar.forward`` with ``render``, as a fit calls them, is compared with the composed links:
image, gradients and tangents in both precisions.

The chain's first inputs are float32 numbers, so the check measures only the arithmetic's error.
Pixels at a step of the picture are left out as in :mod:`gva_mi.gradcheck.splat`; Gaussians at a
kink of the relu too, see chain.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from gva_mi.core.threads import one_torch_thread
from gva_mi.gradcheck.chain import NETWORK, STILL_MEANS, Link, PosedAvatar, posed_gaussians, run
from gva_mi.gradcheck.engine import Comparison, Report
from gva_mi.gradcheck.probes import IMAGES, Probe, Tensors, differences, gradients, tangents
from gva_mi.splat import reference

CHAIN = "chain"  # the group of the whole chain's comparisons
F64, F32 = 1e-8, 1e-5  # the greatest relative L2 error allowed
BAND = 1e-3  # relative distance of an alpha to its cut-off, beyond reach of a difference's steps
STEP = 1e-5  # of a difference, in the input's units
STEPS = {  # times it: inputs that move many pixels, or a small part of one
    "rotations": 0.1, "transl": 0.1, "means": 0.1, "betas": 20.0, "expression": 60.0,
    "light": 30.0, "posed_means": 0.1, "covars": 0.01,
}  # fmt: skip
LINEAR = {"shape": 30.0, "blend shapes": 30.0}  # links: times as long, still exact
NETWORK_STEP = 4.0  # the same for the network's weights; well within chain.py's KINK
FEW = 4  # an input of so many times the entries asked for is differentiated by each of its own


@dataclass(frozen=True)
class AvatarReport(Report):
    """The comparisons of an avatar; groups are the links and the whole chain."""

    def finding(self) -> str:
        """The verdict without the scene: the link that is wrong, or loses the most digits."""
        failed = [row for row in self.rows if not row.passed]
        wrong = list(dict.fromkeys(row.group for row in failed if not row.coarse))
        links = [name for name in wrong if name != CHAIN]
        if links:
            return f"WRONG in {', '.join(links)}"
        found = super().finding()
        if wrong:
            reason = "every link is right alone, but not as Avatar.animate puts them together"
            return found.replace("WRONG: ", f"WRONG: {reason}; ", 1)
        if failed:
            coarsest = max(failed, key=lambda row: row.error / row.tolerance).group
            return found.replace("allowed: ", f"allowed, most in {coarsest}: ", 1)
        return found


def check_avatar(
    posed: PosedAvatar,
    *,
    tolerances: tuple[float, float] = (F64, F32),
    entries: int = 3,
    seed: int = 0,
) -> AvatarReport:
    """Check the gradients of an avatar's picture.

    Args:
        posed: the avatar, its pose and its camera; some hundred Gaussians take seconds.
        tolerances: the greatest relative L2 errors allowed in float64 and in float32.
        entries: how many entries of every input to differentiate one by one; of an input of few
            entries (at most 4 times as many) all.
        seed: of the loss's weights and of the choice of entries.
    """
    with one_torch_thread():
        check = _AvatarCheck.of(posed, entries, tolerances, Generator().manual_seed(seed))
        rows = list(check.chain())
        for link, coarse in zip(check.links, posed.links(torch.float32), strict=True):
            rows += check.link(link, coarse)
    left_out = f"{int(check.band.sum())} at a step left out"
    subject = f"{len(posed.values['means'])} Gaussians, {check.band.numel()} pixels, {left_out}"
    return AvatarReport(tuple(rows), subject)


@dataclass(frozen=True)
class _AvatarCheck:
    """An avatar and a loss, all values of its chain, and the loss's gradients by them."""

    posed: PosedAvatar
    links: tuple[Link, ...]  # float64
    band: Tensor  # (H, W) bool, pixels at a step
    weights: tuple[Tensor, ...]  # of colour, alpha and depth; 0 in the band
    values: Tensors  # of the chain, detached
    gradients: Tensors  # by all of them
    probes: dict[str, Probe]
    tolerances: tuple[float, float]  # float64, float32

    @staticmethod
    def of(
        posed: PosedAvatar, entries: int, tolerances: tuple[float, float], generator: Generator
    ) -> _AvatarCheck:
        links = posed.links()
        values = run(links, _leaves(posed.values))
        band = reference.threshold_band(posed_gaussians(values), posed.camera, alpha=BAND)
        # Not about zero: a gradient whose terms cancel to a thousandth loses three digits, and
        # no code is to blame.
        weights = 1 + torch.randn(*band.shape, 5, generator=generator).double()
        weights[band] = 0
        weights = weights[..., :3], weights[..., 3], weights[..., 4]
        seen = {k: v for k, v in values.items() if v.requires_grad}
        found = gradients([values[name] for name in IMAGES], seen, weights)
        count = lambda g: g.numel() if g.numel() <= FEW * entries else entries
        probes = {k: Probe.among(g, count(g), generator) for k, g in found.items()}
        values = {k: v.detach() for k, v in values.items()}
        return _AvatarCheck(posed, links, band, weights, values, found, probes, tolerances)

    def chain(self) -> Iterator[Comparison]:
        """Compare the whole chain, and the avatar's own code with the composed links."""
        names = list(self.posed.values)
        for label, dtype, allowed in zip(
            ("f64", "f32"), (torch.float64, torch.float32), self.tolerances, strict=True
        ):
            add = lambda *row, allowed=allowed: Comparison.of(*row, allowed, CHAIN)
            leaves = _leaves(self.posed.values, dtype)
            images = self._images(leaves)
            for name, image in zip(IMAGES, images, strict=True):
                found, truth = self._shown(image.detach().double()), self._shown(self.values[name])
                yield add(f"adjoint {label}", name, found, truth)
            found = gradients(images, leaves, [w.to(dtype) for w in self.weights])
            for name in names:
                yield add(f"adjoint {label}", name, found[name].double(), self.gradients[name])
            for name in names:
                moves = lambda v, name=name, x=leaves: tangents(self._images, x, name, v)
                yield self._along(f"tangent {label}", name, moves, self.weights, allowed, CHAIN)
        for name in names:
            composed = lambda values, name=name: [
                run(self.links, values, name)[image] for image in IMAGES
            ]
            yield self._differences(composed, self.values, name, self.weights, CHAIN)

    def link(self, link: Link, coarse: Link) -> Iterator[Comparison]:
        """Check one link alone, and its float32 form against its float64 form."""
        f64, f32 = self.tolerances
        inputs = {name: self.values[name] for name in link.inputs}
        still = {STILL_MEANS: self.values[STILL_MEANS]}
        grads = [self._output_gradient(name) for name in link.outputs]
        whole = lambda values: link.function(still | values)
        rounded = {name: v.float() for name, v in inputs.items()}
        leaves = _leaves(inputs), _leaves(rounded), _leaves(rounded, torch.float32)
        own = gradients(whole(leaves[0]), leaves[0], grads)
        exact = gradients(whole(leaves[1]), leaves[1], grads)
        few = coarse.function({STILL_MEANS: still[STILL_MEANS].float()} | leaves[2])
        lost = gradients(few, leaves[2], [g.float() for g in grads])
        for name in link.inputs:
            short = name.removeprefix(NETWORK)
            moves = lambda v, name=name: tangents(whole, inputs, name, v)
            yield self._along("tangent f64", name, moves, grads, f64, link.name, own[name])
            yield self._differences(whole, inputs, name, grads, link.name, own[name])
            found = lost[name].double()
            yield Comparison.of("adjoint f32", short, found, exact[name], f32, link.name)

    def _images(self, values: Tensors) -> list[Tensor]:
        image = self.posed.render(values)
        return [image.color, image.alpha, image.depth]

    def _output_gradient(self, name: str) -> Tensor:
        """The gradient by a link's output: the loss's weights where that is an image."""
        weights = dict(zip(IMAGES, self.weights, strict=True))
        return weights[name] if name in weights else self.gradients[name]

    def _differences(self, fn, values, name, weights, group, truth=None) -> Comparison:  # noqa: ANN001
        share = NETWORK_STEP if name.startswith(NETWORK) else STEPS.get(name, 1.0)
        step = share * LINEAR.get(group, 1.0) * STEP
        moves = lambda v: differences(fn, values, name, v, step)
        return self._along("differences", name, moves, weights, self.tolerances[0], group, truth)

    def _along(self, method, name, moves, weights, allowed, group, truth=None) -> Comparison:  # noqa: ANN001
        """Compare <w, J v> with <J^T w, v> for every direction v of an input's probe."""
        probe = self.probes[name]
        found = [
            sum(float((w * d.double()).sum()) for w, d in zip(weights, moves(v), strict=True))
            for v in probe.directions()
        ]
        truth = self.gradients[name] if truth is None else truth
        short = name.removeprefix(NETWORK)
        return Comparison.along(method, short, probe, found, truth, allowed, group)

    def _shown(self, x: Tensor) -> Tensor:
        """An image with zeros at the picture's steps."""
        return x * ~self.band.view(*self.band.shape, *[1] * (x.ndim - 2))


def _leaves(values: Tensors, dtype: torch.dtype = torch.float64) -> Tensors:
    return {k: v.detach().to(dtype).clone().requires_grad_() for k, v in values.items()}
