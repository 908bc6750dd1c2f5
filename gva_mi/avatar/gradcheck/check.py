"""The comparison of an avatar's gradients, all of one chain and of every link of it.

The loss is L = <w, image>, random weights w on colour, alpha and depth. Of the whole chain, which
is ``Avatar.animate`` and ``render`` as a fit calls them, its gradient by every first input is taken

* by torch's autograd in float64 and in float32,
* by forward-mode AD in both, along a random direction and along single entries,
* by central differences of fourth order in float64, along the same,

and compared with autograd through the slow twins of all links (twins.py and splat/reference.py).
A link alone is compared at the values and with the gradient that reach it in the twins' chain: so
a fault is found where it is, and not in what comes before or after it.

Which link loses digits is told by an experiment: one link computes in float32, all others in
float64. Every number that the chain begins with is one that float32 holds, so only arithmetic is
judged. Differences see how the residual changes with the means, which gradients leave out on
purpose (:meth:`PoseResidual.forward`): there the twins' derivative of the network is added.

The picture's steps are left out as in :mod:`gva_mi.splat.gradcheck.check`; the relu's kinks too,
see chain.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor
from torch.autograd import forward_ad

from gva_mi.avatar.gradcheck.chain import NETWORK, Link, Scene, Values, posed, run
from gva_mi.avatar.gradcheck.verdict import LinkReport, Report
from gva_mi.splat import reference
from gva_mi.splat.gaussians import Image
from gva_mi.splat.gradcheck.directions import Probe, loss
from gva_mi.splat.gradcheck.verdict import Comparison
from gva_mi.threads import one_torch_thread

PRECISIONS = {"f64": torch.float64, "f32": torch.float32}
BAND = 1e-3  # relative distance of an alpha to its cut-off, beyond reach of a difference's steps
STEPS = {  # share of a difference's step, for inputs that move many pixels, or a small part of one
    "rotations": 0.1, "transl": 0.1, "means": 0.1, "expression": 60.0, "light": 30.0,
}  # fmt: skip
NETWORK_STEP = 4.0  # the same for the network's weights; well within chain.py's KINK
FEW = 12  # inputs of so many entries are differentiated by each of them


@dataclass(frozen=True)
class Tolerances:
    """What counts as right: the greatest relative L2 error of a picture, or of a gradient."""

    f64: float = 1e-8  # adjoints, tangents and differences
    f32: float = 1e-5


def gradcheck(
    scene: Scene,
    tolerances: Tolerances = Tolerances(),  # noqa: B008 (frozen)
    *,
    entries: int = 3,
    step: float = 1e-5,
    seed: int = 0,
) -> Report:
    """Compare an avatar's picture and gradients with the slow twins'.

    Args:
        scene: the avatar, its pose and who sees it; some hundred Gaussians take seconds.
        tolerances: what counts as right.
        entries: how many entries of every input to differentiate one by one; of an input of few
            entries all, unless it is 0.
        step: of the differences, in the input's units.
        seed: of the loss's weights and of the choice of entries.
    """
    with one_torch_thread():
        asked = _Asked.of(scene, entries, Generator().manual_seed(seed))
        rows = list(_chain(asked, tolerances, step))
        links = tuple(_link(asked, k, tolerances) for k in range(len(asked.links)))
    count, pixels = len(scene.values["means"]), asked.band.numel()
    return Report(tuple(rows), links, count, pixels, int(asked.band.sum()))


@dataclass(frozen=True)
class _Asked:
    """The question, and the twins' answer."""

    scene: Scene
    links: tuple[Link, ...]  # float64
    links32: tuple[Link, ...]
    band: Tensor  # (H, W) bool, pixels at a step
    weights: Tensor  # (H, W, 5) for colour, alpha and depth; 0 in the band
    values: Values  # of the twins' chain, detached: what reaches each link, and what it makes of it
    gradients: Values  # of the loss by all of these
    slope: Tensor  # (N, 3) of the loss by means through the network, left out on purpose
    probes: dict[str, Probe]  # for the first inputs

    @staticmethod
    def of(scene: Scene, entries: int, generator: Generator) -> _Asked:
        links, leaves = scene.links(), _leaves(scene.values)
        values = run(links, leaves, slow=True)
        band = reference.threshold_band(posed(values), scene.camera, alpha=BAND)
        # Not about zero: a gradient that cancels to a thousandth of its terms loses three digits,
        # and nobody erred.
        weights = 1 + torch.randn(*band.shape, 5, generator=generator).double()
        weights[band] = 0
        total = loss(_image(values), weights)
        gradients = _gradients([total], values)
        values = {k: v.detach() for k, v in values.items()}
        count = lambda g: g.numel() if entries and g.numel() <= FEW else entries
        probes = {
            k: Probe.among(gradients[k], count(gradients[k]), generator) for k in scene.values
        }
        slope = scene.slope(values, gradients["residual"])
        links32 = scene.links(torch.float32)
        return _Asked(scene, links, links32, band, weights, values, gradients, slope, probes)

    def shown(self, x: Tensor) -> Tensor:
        """An image with zeros at the picture's steps; any other tensor as it is."""
        if x.shape[:2] != self.band.shape:
            return x
        return x * ~self.band.view(*self.band.shape, *[1] * (x.ndim - 2))

    def picture(self, values: Values) -> Image:
        """The picture of the avatar, as a fit draws it."""
        return self.scene.animated(values)


def _chain(asked: _Asked, tolerances: Tolerances, step: float) -> Iterator[Comparison]:
    """The rows of the whole chain."""
    names = list(asked.scene.values)
    for label, dtype in PRECISIONS.items():
        allowed = getattr(tolerances, label)
        leaves = _leaves(asked.scene.values, dtype)
        image = asked.picture(leaves)
        for name in ("color", "alpha", "depth"):
            found = asked.shown(getattr(image, name).detach().double())
            truth = asked.shown(asked.values[name])
            yield Comparison.of(f"adjoint {label}", name, found, truth, allowed)
        found = _gradients([loss(image, asked.weights)], leaves)
        for name in names:
            g = found[name].double()
            yield Comparison.of(f"adjoint {label}", name, g, asked.gradients[name], allowed)
        for name in names:
            along = lambda v, name=name, leaves=leaves: _tangent(asked, leaves, name, v)
            yield _probed(asked, f"tangent {label}", name, along, allowed)
    for name in names:
        share = NETWORK_STEP if name.startswith(NETWORK) else STEPS.get(name, 1.0)
        along = lambda v, name=name, h=share * step: _difference(asked, name, v, h)
        yield _probed(asked, "differences", name, along, tolerances.f64)


def _probed(
    asked: _Asked, method: str, name: str, along: Callable[[Tensor], float], tolerance: float
) -> Comparison:
    """<w, J v> against <J^T w, v> for every direction v of a probe."""
    probe = asked.probes[name]
    found = torch.tensor([along(v) for v in probe.directions()], dtype=torch.float64)
    gradient = asked.gradients[name]
    if method == "differences" and name == "means":
        gradient = gradient + asked.slope
    truth = probe.along(gradient)
    row = Comparison.of(method, name, found, truth, tolerance)
    return replace(row, where=((), *probe.entries)[row.where[0]])


def _tangent(asked: _Asked, leaves: Values, name: str, direction: Tensor) -> float:
    """<w, J v> by forward-mode AD."""
    values = {k: v.detach() for k, v in leaves.items()}
    with forward_ad.dual_level():
        values[name] = forward_ad.make_dual(values[name], direction.to(values[name].dtype))
        image = asked.picture(values)
        parts = [forward_ad.unpack_dual(x) for x in (image.color, image.alpha, image.depth)]
        still = lambda p: torch.zeros_like(p.primal) if p.tangent is None else p.tangent
        return float(loss(Image(*map(still, parts)), asked.weights))


def _difference(asked: _Asked, name: str, direction: Tensor, h: float) -> float:
    """<w, J v> by (8 (L(h) - L(-h)) - (L(2 h) - L(-2 h))) / 12 h, of fourth order."""
    at = lambda x: asked.picture(
        asked.scene.values | {name: asked.scene.values[name] + x * direction}
    )
    with torch.no_grad():
        images = [at(x) for x in (h, -h, 2 * h, -2 * h)]
        # pictures are subtracted before they are added up, where their digits still agree
        moved = lambda k: (
            (
                8 * (getattr(images[0], k) - getattr(images[1], k))
                - (getattr(images[2], k) - getattr(images[3], k))
            )
            / (12 * h)
        )
        return float(loss(Image(moved("color"), moved("alpha"), moved("depth")), asked.weights))


def _link(asked: _Asked, k: int, tolerances: Tolerances) -> LinkReport:
    """One link against its twin, its float32 against its float64, and what that costs the chain."""
    link = asked.links[k]
    outputs = [asked.gradients[name] for name in link.outputs]
    values = {name: asked.values[name] for name in link.inputs}
    made, truth = _by_adjoint(link.slow, values, outputs)
    found_made, found = _by_adjoint(link.fast, values, outputs)
    values32 = {name: v.float() for name, v in values.items()}
    _, exact = _by_adjoint(link.fast, {n: v.double() for n, v in values32.items()}, outputs)
    _, coarse = _by_adjoint(asked.links32[k].fast, values32, outputs)

    rows = []
    for name, a, b in zip(link.outputs, found_made, made, strict=True):
        label, a, b = f"{link.name}: {name}", asked.shown(a), asked.shown(b)
        rows.append(Comparison.of("value f64", label, a, b, tolerances.f64))
    for name in link.inputs:
        label = f"{link.name}: {name.removeprefix(NETWORK)}"
        add = lambda *row, label=label: rows.append(Comparison.of(row[0], label, *row[1:]))
        add("adjoint f64", found[name], truth[name], tolerances.f64)
        v = _direction(values[name])
        slope = _link_tangent(link, values, name, v, outputs)
        add("tangent f64", slope, (truth[name] * v).sum(), tolerances.f64)
        add("adjoint f32", coarse[name].double(), exact[name], tolerances.f32)
    return LinkReport(link.name, tuple(rows), *_alone(asked, k))


def _alone(asked: _Asked, k: int) -> tuple[float, str]:
    """The greatest error of the chain's gradients with link k alone in float32, and whose it is."""
    fast, coarse = asked.links[k].fast, asked.links32[k].fast

    def rounded(values: Values) -> tuple[Tensor, ...]:
        return tuple(x.double() for x in coarse({n: v.float() for n, v in values.items()}))

    gradients = []
    for function in (fast, rounded):
        links = list(asked.links)
        links[k] = replace(links[k], fast=function)
        leaves = _leaves(asked.scene.values)
        total = loss(_image(run(tuple(links), leaves)), asked.weights)
        gradients.append(_gradients([total], leaves))
    exact, found = gradients
    off = {k: Comparison.of("", k, found[k], exact[k], 0.0).error for k in exact}
    worst = max(off, key=off.__getitem__)
    return off[worst], worst


def _by_adjoint(
    function: Callable[[Values], tuple[Tensor, ...]],
    values: Values,
    grad_outputs: list[Tensor],
) -> tuple[list[Tensor], Values]:
    """What a link makes of values, and the gradients of its inputs."""
    leaves = _leaves(values, next(iter(values.values())).dtype)
    made = function(leaves)
    grads = [g.to(x.dtype) for g, x in zip(grad_outputs, made, strict=True)]
    return [x.detach() for x in made], _gradients(made, leaves, grads)


def _link_tangent(
    link: Link, values: Values, name: str, direction: Tensor, grad_outputs: list[Tensor]
) -> Tensor:
    """<grad_outputs, J v> of a link by forward-mode AD, where one input moves along v."""
    with forward_ad.dual_level():
        moving = values | {name: forward_ad.make_dual(values[name], direction)}
        tangents = [forward_ad.unpack_dual(x).tangent for x in link.fast(moving)]
    pairs = zip(grad_outputs, tangents, strict=True)
    return sum((g * t).sum() for g, t in pairs if t is not None) + direction.new_zeros(())


def _gradients(made: Sequence[Tensor], leaves: Values, grads: list[Tensor] | None = None) -> Values:
    """The gradients of what was made of leaves, by their names; zero where one is not used."""
    found = torch.autograd.grad(made, list(leaves.values()), grads, allow_unused=True)
    zero = lambda g, v: torch.zeros_like(v) if g is None else g
    return {k: zero(g, v) for (k, v), g in zip(leaves.items(), found, strict=True)}


def _direction(like: Tensor) -> Tensor:
    generator = Generator().manual_seed(like.numel())
    return torch.randn(like.shape, generator=generator, dtype=torch.float64)


def _leaves(values: Values, dtype: torch.dtype = torch.float64) -> Values:
    return {k: v.detach().to(dtype).clone().requires_grad_() for k, v in values.items()}


def _image(values: Values) -> Image:
    return Image(values["color"], values["alpha"], values["depth"])
