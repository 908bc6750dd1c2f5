"""Guess why a renderer differs from the reference: one line for the picture, one for each input.

The picture is compared with the reference drawn in other ways that renderers have: without its
cut-offs, without the bound of the Jacobian, with other pixel centres (:data:`WAYS`). The ways that
bring it nearest are taken one after the other. If they explain the whole difference, the gradients
are compared with that reference too, so that a missing cut-off does not look like a wrong gradient.

A wrong gradient is compared with what common mistakes make of the true one: zero, a factor, columns
in another order, a quaternion's normalisation left out. Last, *which* inputs are wrong shows where
to look (:data:`PLACES`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import permutations

import torch
from torch import Tensor

from gva_mi.gradcheck.probes import Renderer, Tensors, drawn, gradients, images_of, leaves
from gva_mi.splat import reference
from gva_mi.splat.scene import Scene

# Relative residual below which a guess explains a difference. Chosen: ten times what float32 leaves
# of a picture or a gradient that is right.
EXPLAINED = 1e-4
# A way counts if it leaves less than this share of the difference. Chosen: rounding leaves more.
GAIN = 0.8
# Share of a gradient's error that a mistake which explains it may leave. Chosen: lost digits leave
# more, and are then not called a missing factor.
LEFT = 0.1
MOST_WAYS = 5  # taken together; chosen: more are a guess no longer
FEW_ROWS = 0.2  # share of the Gaussians; chosen: others are then told by name
NAMED_ROWS = 5


def _options(**changed: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, options=replace(scene.options, **changed))


def _inputs(name: str, change: Callable[[Tensor], Tensor]) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        inputs = scene.inputs()
        moved = {name: change(inputs[name])} if name in inputs else {}
        return scene.with_inputs(inputs | moved)

    return changed


def _half_a_pixel(scene: Scene) -> Scene:
    """Put the centre of the first pixel at 0 instead of 0.5."""
    camera = scene.camera
    shift = 0.5 * torch.tensor([[0.0, 0, 1], [0, 0, 1], [0, 0, 0]], dtype=torch.float64)
    T, K = camera.tensors
    if K is None:
        return replace(scene, camera=replace(camera, cx=camera.cx + 0.5, cy=camera.cy + 0.5))
    return replace(scene, camera=camera.with_matrices(T, K + shift))


# What may differ, and the reference drawn so. "SplatOptions" is what a user can give.
WAYS: Mapping[str, Callable[[Scene], Scene]] = {
    "no cut-off where alpha is small: SplatOptions(alpha_min=0)": _options(alpha_min=0.0),
    "alpha is not clamped: SplatOptions(alpha_max=1)": _options(alpha_max=1.0),
    "alpha is clamped as in 3DGS: SplatOptions(alpha_max=0.99)": _options(alpha_max=0.99),
    "pixels do not stop: SplatOptions(transmittance_min=0)": _options(transmittance_min=0.0),
    "no bound of the Jacobian, 15 % beyond the border: SplatOptions(hold_jacobian=False)": _options(
        hold_jacobian=False
    ),
    "no blur of 0.3 square pixels: SplatOptions(blur=0)": _options(blur=0.0),
    "opacities are reduced by the blur: SplatOptions(antialiased=True)": _options(antialiased=True),
    "pixel centres at whole numbers, not at + 0.5": _half_a_pixel,
    "the background is left out": _inputs("background", torch.zeros_like),
    "quaternions are read as xyzw, not wxyz": _inputs("quats", lambda q: q[:, [3, 0, 1, 2]]),
}

# Inputs that are wrong, inputs that are right, and where to look then; the first that fits.
PLACES: tuple[tuple[frozenset[str], frozenset[str], str], ...] = tuple(
    (frozenset(wrong.split()), frozenset(right.split()), text)
    for wrong, right, text in (
        ("colors", "", "weights of compositing, the background"),
        ("sh", "", "the harmonics and their clamp at 0, or weights of compositing"),
        ("background", "", "the transmittance behind the last Gaussian"),
        ("opacities", "", "the part behind a Gaussian (eq. 15), the clamp of alpha"),
        ("quats", "scales", "the matrix of a rotation, and its normalisation"),
        ("scales", "", "the conic and its inverse: the off-diagonal entry counts twice"),
        ("covars", "", "the conic and its inverse: the off-diagonal entry counts twice"),
        ("means", "", "the projection, and the derivative of the Jacobian itself"),
        ("T_camera_world", "means", "the camera's matrix: the view direction, the Jacobian"),
        ("K", "means", "the camera's matrix: the Jacobian too contains the focal length"),
    )
)


def causes(fn: Renderer, scene: Scene, weights: Tensors, wrong: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines for a renderer that failed.

    Args:
        fn: the renderer.
        scene: float64, of numbers that float32 holds.
        weights: of the loss, by image; 0 at pixels that are left out.
        wrong: images and inputs that failed, and the methods by which.

    Example:
        A renderer whose gradient by colours is twice too large.

        >>> from gva_mi.splat.scene import random_scene
        >>> small = random_scene(torch.Generator().manual_seed(0), gaussians=5, width=8, height=6)
        >>> def twice(g, camera, options, background):
        ...     colors = 2 * g.colors - g.colors.detach()
        ...     return reference.render(replace(g, colors=colors), camera, options, background)
        >>> exact = reference.render(small.gaussians, small.camera, small.options)
        >>> weights = {name: torch.ones_like(getattr(exact, name)) for name in images_of(small)}
        >>> print(*causes(twice, small, weights, {"colors": "adjoint f32"}), sep="; ")
        colors: 1e+00 wrong: ...
    """
    known = images_of(scene)
    nearest, like = scene, ""
    if not wrong.keys().isdisjoint(known):
        ways, nearest, left = _explained(fn, scene, weights)
        yield from (f"image: {way}" for way in ways)
        if left > EXPLAINED:
            besides = " besides" if ways else ""
            yield f"image: differs by {left:.0e}{besides}, for a reason that is unknown here"
        else:
            like = ", compared with a reference that draws so"
    inputs = leaves(scene.inputs(), torch.float32)
    pairs = [weights[name].to(torch.float32) for name in known]
    found = gradients(drawn(fn, scene, inputs), inputs, pairs)
    exact = leaves(nearest.inputs())
    truth = gradients(drawn(reference.render, nearest, exact), exact, weights.values())
    off = lambda name: float((found[name] - truth[name]).norm() / truth[name].norm().clamp(1e-30))
    failed = [name for name in truth if off(name) > EXPLAINED]
    for name in failed:
        guess = guess_of(found[name].double(), truth[name].detach(), inputs[name].detach())
        yield f"{name}: {off(name):.0e} wrong{like}" + (f": {guess}" if guess else "")
    if like and not failed:
        yield f"gradients: all right{like}"
    if place := place_of(set(failed)):
        yield f"look at: {place}"
    for name in wrong:
        if name not in (*failed, *known) and "adjoint f32" not in wrong[name]:
            yield f"{name}: right by the float32 adjoint, wrong by: {wrong[name]}"


def _explained(fn: Renderer, scene: Scene, weights: Tensors) -> tuple[list[str], Scene, float]:
    """Return the ways that explain a picture, the scene drawn so, and what is left unexplained."""
    kept = next(iter(weights.values()))[..., :1] != 0
    joined = lambda images: torch.cat([x.reshape(*kept.shape[:2], -1) for x in images], -1) * kept
    with torch.no_grad():
        drawing = lambda by, s, dtype: joined(drawn(by, s, leaves(s.inputs(), dtype))).double()
        found = drawing(fn, scene, torch.float32)
        off = lambda s: float((found - drawing(reference.render, s, torch.float64)).norm())
        left, ways, size = off(scene), [], float(found.norm())
        while left > EXPLAINED * size and len(ways) < MOST_WAYS:
            tried = {way: off(change(scene)) for way, change in WAYS.items() if way not in ways}
            best = min(tried, key=tried.get)
            if tried[best] > GAIN * left:
                break
            scene, left = WAYS[best](scene), tried[best]
            ways.append(best)
    return ways, scene, left / max(size, 1e-30)


def guess_of(found: Tensor, truth: Tensor, value: Tensor) -> str:
    """Guess the mistake that makes a gradient of the true one, at an input's value; or "".

    Example:
        >>> true = torch.tensor([[1.0, 2.0], [3.0, -1.0]])
        >>> guess_of(0.5 * true, true, true)
        '0.5 times the true gradient: a factor is missing'
        >>> guess_of(true[:, [1, 0]], true, true)
        'its columns are in the order [1, 0]'
    """
    left = lambda guess: float((found - guess).norm())
    most = min(10 * EXPLAINED * float(found.norm()), LEFT * left(truth))
    explains = lambda guess: left(guess) < most
    if not found.any():
        return "zero: is it detached?"
    factor = float((found * truth).sum() / truth.square().sum().clamp(min=1e-300))
    if explains(factor * truth):
        return f"{factor:.3g} times the true gradient: a factor is missing"
    if truth.ndim != 2:
        return ""
    columns = (found * truth).sum(0) / truth.square().sum(0).clamp(min=1e-300)
    if explains(columns * truth):
        return f"its columns are {[round(float(c), 3) for c in columns]} times the true ones"
    if truth.shape[1] <= 4:
        for order in permutations(range(truth.shape[1])):
            if explains(truth[:, order]):
                return f"its columns are in the order {list(order)}"
    if truth.shape[1] == 4 and value.shape == truth.shape:  # quaternions
        q = torch.nn.functional.normalize(value.double(), dim=1)
        across = lambda g: g - (g * q).sum(1, keepdim=True) * q
        if explains(found - across(found) + across(truth)):
            return "it differs along the quaternion: the normalisation is not differentiated"
    rows = torch.nonzero((found - truth).norm(dim=1) > EXPLAINED * truth.norm(dim=1))[:, 0].tolist()
    if rows and len(rows) <= FEW_ROWS * len(truth):
        named = ", ".join(map(str, rows[:NAMED_ROWS]))
        return f"only {len(rows)} of {len(truth)} Gaussians, such as {named}"
    return ""


def place_of(wrong: set[str]) -> str:
    """Return where to look if these inputs are wrong and all others right; or "".

    Example:
        >>> place_of({"means", "quats", "scales"})
        'the conic and its inverse: the off-diagonal entry counts twice'
    """
    fits = lambda need, right: need <= wrong and right.isdisjoint(wrong)
    return next((text for need, right, text in PLACES if fits(need, right)), "")
