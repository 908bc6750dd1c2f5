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
from functools import partial

import torch
from torch import Generator, Tensor

from gva_mi.core.threads import one_torch_thread
from gva_mi.gradcheck.chain import NETWORK, STILL_MEANS, Link, PosedAvatar, posed_gaussians, run
from gva_mi.gradcheck.engine import Check, Comparison, Report
from gva_mi.gradcheck.probes import IMAGES, Probe, Tensors, differences, gradients, leaves, tangents
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
    band = check.whole.band
    left_out = f"{int(band.sum())} at a step left out"
    subject = f"{len(posed.values['means'])} Gaussians, {band.numel()} pixels, {left_out}"
    return AvatarReport(tuple(rows), subject)


@dataclass(frozen=True)
class _AvatarCheck:
    """An avatar and a loss, all values of its chain, and the loss's gradients by them."""

    posed: PosedAvatar
    links: tuple[Link, ...]  # float64
    values: Tensors  # of the chain, detached
    whole: Check  # of the chain; its gradients and probes are those of all values
    tolerances: tuple[float, float]  # float64, float32

    @staticmethod
    def of(
        posed: PosedAvatar, entries: int, tolerances: tuple[float, float], generator: Generator
    ) -> _AvatarCheck:
        links = posed.links()
        values = run(links, leaves(posed.values))
        band = reference.threshold_band(posed_gaussians(values), posed.camera, alpha=BAND)
        # Not about zero: a gradient whose terms cancel to a thousandth loses three digits, and
        # no code is to blame.
        w = 1 + torch.randn(*band.shape, 5, generator=generator).double()
        w[band] = 0
        weights = dict(zip(IMAGES, (w[..., :3], w[..., 3], w[..., 4]), strict=True))
        seen = {k: v for k, v in values.items() if v.requires_grad}
        found = gradients([values[name] for name in IMAGES], seen, weights.values())
        count = lambda g: g.numel() if g.numel() <= FEW * entries else entries
        probes = {k: Probe.among(g, count(g), generator) for k, g in found.items()}
        values = {k: v.detach() for k, v in values.items()}
        images = {name: values[name] for name in IMAGES}
        whole = Check(posed.values, images, weights, found, probes, band, CHAIN)
        return _AvatarCheck(posed, links, values, whole, tolerances)

    def chain(self) -> Iterator[Comparison]:
        """Compare the whole chain, and the avatar's own code with the composed links."""
        f64, f32 = self.tolerances
        yield from self.whole.methods(self._images, "f64", f64, f64, f64)
        yield from self.whole.methods(self._images, "f32", f32, f32, f32)
        for name in self.posed.values:
            yield self.whole.along("differences", name, partial(self._composed, name), f64)

    def _composed(self, name: str, direction: Tensor) -> list[Tensor]:
        """Return J v of the composed links' images as one input moves."""
        images = lambda values: [run(self.links, values, name)[image] for image in IMAGES]
        return differences(images, self.values, name, direction, _step(name, CHAIN))

    def link(self, link: Link, coarse: Link) -> Iterator[Comparison]:
        """Check one link alone, and its float32 form against its float64 form."""
        f64, f32 = self.tolerances
        inputs = {name: self.values[name] for name in link.inputs}
        still = {STILL_MEANS: self.values[STILL_MEANS]}
        grads = [(self.whole.truth | self.whole.weights)[name] for name in link.outputs]
        alone = lambda values: link.function(still | values)
        exact_at = leaves({name: v.float() for name, v in inputs.items()})
        lost_at = leaves(inputs, torch.float32)
        own_at = leaves(inputs)
        own = gradients(alone(own_at), own_at, grads)
        exact = gradients(alone(exact_at), exact_at, grads)
        few = coarse.function({STILL_MEANS: still[STILL_MEANS].float()} | lost_at)
        lost = gradients(few, lost_at, [g.float() for g in grads])
        for name in link.inputs:
            probe, short = self.whole.probes[name], name.removeprefix(NETWORK)
            step = _step(name, link.name)
            for method, moves in (
                ("tangent f64", partial(tangents, alone, inputs, name)),
                ("differences", partial(differences, alone, inputs, name, step=step)),
            ):
                row = method, short, probe, moves, grads, own[name], f64, link.name
                yield Comparison.along(*row)
            found = lost[name].double()
            yield Comparison.of("adjoint f32", short, found, exact[name], f32, link.name)

    def _images(self, values: Tensors) -> list[Tensor]:
        image = self.posed.render(values)
        return [image.color, image.alpha, image.depth]


def _step(name: str, group: str) -> float:
    """Return the step of an input's differences in a link, or in the chain."""
    share = NETWORK_STEP if name.startswith(NETWORK) else STEPS.get(name, 1.0)
    return share * LINEAR.get(group, 1.0) * STEP
