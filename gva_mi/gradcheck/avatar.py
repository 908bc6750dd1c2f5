"""Check an avatar's gradients: the whole chain from pose, shape and Gaussians to the picture.

The loss is L = <w, image> with random weights w on colour, alpha and depth. Its gradient
with respect to every input, through ``Avatar.forward`` and ``render`` as a fit calls them, in
float64, is compared

* with central differences of fourth order and with tangents, both in float64, along a random
  direction and along single entries,
* with gradients and tangents in float32.

All inputs are float32 numbers, so an error of float32 is an error of its arithmetic. Pixels at a
step of the picture are left out as in :mod:`gva_mi.gradcheck.splat`, and so are Gaussians at a kink
of the network's relu.

A picture is a function of the pose (``rotations``, ``transl``, ``expression``), the shape
(``betas``), the ``light``, the canonical Gaussians and the weights of the residual's network. The
method omits the network's derivative with respect to the means (:class:`PoseResidual`). Therefore
the network reads constant means here.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Generator, Tensor, nn
from torch.func import functional_call
from torch.overrides import TorchFunctionMode

from gva_mi.avatar.avatar import Avatar, AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import BINDING, PARAMETERS, CanonicalGaussians, SeedOptions
from gva_mi.avatar.residual import PoseResidual, ResidualOptions
from gva_mi.body.pose import JAW, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.core.cpu import one_torch_thread
from gva_mi.gradcheck.engine import Check, Report
from gva_mi.gradcheck.probes import IMAGES, Probe, Tensors, differences, leaves
from gva_mi.splat import Camera, Gaussians, look_at, reference, render

NETWORK = "residual.network."  # prefix of the names of the network's weights
# Gaussians for which a relu's input is closer to zero are left out. Chosen: beyond the reach of the
# differences' steps, DIFFERENCE_STEP times NETWORK_STEP_FACTOR.
KINK_DISTANCE = 3e-4
# Radians, standard deviations: limbs; hands and jaw. Chosen: poses that people take.
LIMB_ANGLE, HAND_ANGLE = 0.35, 0.15


@dataclass(frozen=True)
class PosedAvatar:
    """An avatar in one pose before a camera, in both precisions.

    Example:
        >>> posed = PosedAvatar.random(gaussians=100, size=16)
        >>> posed.gaussians(posed.values).means.shape  # without two Gaussians at a kink
        torch.Size([98, 3])
    """

    models: Mapping[torch.dtype, tuple[BodyModel, Avatar]]
    values: Tensors  # what the picture depends on, float64, of numbers that float32 holds
    camera: Camera
    background: Tensor  # (3,)

    @staticmethod
    def random(
        seed: int = 0, gaussians: int = 400, size: int = 40, body: Path | None = None
    ) -> PosedAvatar:
        """Make an avatar in a random pose, seen whole from 3 m; none of its parameters is zero.

        Args:
            seed: of all random numbers.
            gaussians: about how many, at least 100.
            size: width and height of the picture, px.
            body: a body in SMPL-X's .npz format; the built-in body where None.
        """
        generator = Generator().manual_seed(seed)
        normal = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)
        bodies = {dtype: load_body(body, dtype) for dtype in (torch.float64, torch.float32)}
        betas = 0.5 * normal(bodies[torch.float64].num_betas)
        seeds = SeedOptions(count=gaussians, opacity=0.6)
        options = AvatarOptions(seed=seeds, residual=ResidualOptions(enabled=True))
        # The network has a generator of its own: its size does not change the pose.
        of_network = Generator().manual_seed(seed)
        rest = bodies[torch.float32], Shape(betas.float())
        avatar = seed_avatar(*rest, None, options, of_network).double()
        with torch.no_grad():
            G = avatar.canonical
            G.quats += 0.2 * normal(*G.quats.shape)
            G.log_scales += 0.2 * normal(*G.log_scales.shape)
            G.logit_opacities += 0.5 * normal(*G.logit_opacities.shape)
            G.sh += 0.3 * torch.rand(G.sh.shape, generator=generator).double() - 0.15
            avatar.residual.offset.weight += 0.3 * normal(*avatar.residual.offset.weight.shape)
        psi = 0.7 * normal(1, bodies[torch.float64].num_expressions)
        pose = Pose(LIMB_ANGLE * normal(1, 55, 3), 0.1 * normal(1, 3), psi)
        for part in (JAW, LEFT_HAND, RIGHT_HAND):
            pose.rotations[:, part] *= HAND_ANGLE / LIMB_ANGLE
        camera = Camera(
            1.3 * size, 1.35 * size, size / 2 + 0.3, size / 2 - 0.2,
            look_at((0.4, 0.3, 3.2), (0.0, -0.2, 0.0)), size, size,
        )  # fmt: skip
        background = torch.rand(3, generator=generator).double()
        values = {field: getattr(pose, field)[0] for field in ("rotations", "transl", "expression")}
        values |= {"betas": betas, "light": avatar.light}
        values |= {name: getattr(avatar.canonical, name) for name in PARAMETERS}
        values |= {NETWORK + k: v for k, v in avatar.residual.named_parameters()}
        values = {k: v.detach().float().double() for k, v in values.items()}
        avatar, values = _away_from_kinks(avatar, values)
        models = {k: (b, copy.deepcopy(avatar).to(k)) for k, b in bodies.items()}
        return PosedAvatar(models, values, camera, background)

    def gaussians(self, values: Tensors) -> Gaussians:
        """Return the posed Gaussians as a fit computes them, in the precision of the values.

        The joints of the shape are computed here, because an avatar holds them as constants.
        """
        body, avatar = self.models[values["means"].dtype]
        state = {k: v for k, v in values.items() if k.startswith(NETWORK)}
        state |= {f"canonical.{name}": values[name] for name in PARAMETERS}
        state |= {"rest_joints": body.rest(Shape(values["betas"])).joints, "light": values["light"]}
        pose = Pose(*(values[name][None] for name in ("rotations", "transl", "expression")))
        return functional_call(avatar, state, (pose,))


class _ResidualOfMeans(nn.Module):
    """A residual that always reads the same means."""

    def __init__(self, network: PoseResidual, means: Tensor) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("means", means)

    def forward(self, _: Tensor, weights: Tensor, rotations: Tensor) -> Tensor:
        return self.network(self.means, weights, rotations)


class _ReluInputs(TorchFunctionMode):
    """Recorder of the rows for which all inputs of all relus are away from zero."""

    away: Tensor | bool = True

    def __torch_function__(self, function, types, args=(), kwargs=None):  # noqa: ANN001, ANN204
        if function is torch.relu:
            self.away = self.away & (args[0].abs() > KINK_DISTANCE).all(1)
        return function(*args, **(kwargs or {}))


def _away_from_kinks(avatar: Avatar, values: Tensors) -> tuple[Avatar, Tensors]:
    """Return an avatar and its values without the Gaussians at a kink of the network's relu."""
    weights = {k.removeprefix(NETWORK): v for k, v in values.items() if k.startswith(NETWORK)}
    place = values["means"], avatar.canonical.weights, values["rotations"]
    with _ReluInputs() as relus:
        functional_call(avatar.residual, weights, place)
    away = {name: values[name][relus.away] for name in PARAMETERS}
    binding = {name: getattr(avatar.canonical, name)[relus.away] for name in BINDING}
    residual = _ResidualOfMeans(avatar.residual, away["means"])
    canonical = CanonicalGaussians(**away, **binding)
    return Avatar(canonical, residual, avatar.rig, avatar.skin, avatar.options), values | away


# Greatest relative L2 errors allowed. Chosen: float32 as in gradcheck/splat.py; in float64
# rounding leaves 1e-16 / 1e-5 of a difference, and sums over the picture add many such.
TOLERANCE_F64, TOLERANCE_F32 = 1e-8, 1e-5
# Relative distance of an alpha to its cut-off up to which its pixel is left out. Chosen: beyond the
# reach of a difference's steps.
CUT_OFF_BAND = 1e-3
DIFFERENCE_STEP = 1e-5  # in the input's units; chosen: see TOLERANCE_F64
# Factors of the step, 1 for others. Chosen: short for inputs that move many pixels, long for inputs
# that move a small part of one.
STEP_FACTORS = {
    "rotations": 0.1, "transl": 0.1, "means": 0.1, "betas": 20.0, "expression": 60.0,
    "light": 30.0,
}  # fmt: skip
NETWORK_STEP_FACTOR = 4.0  # the same factor for the network's weights; well within KINK_DISTANCE
# Each entry is checked if an input has at most this many times the requested number of entries.
ALL_ENTRIES_FACTOR = 4


def check_avatar(
    posed: PosedAvatar,
    *,
    tolerances: tuple[float, float] = (TOLERANCE_F64, TOLERANCE_F32),
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

    Example:
        >>> posed = PosedAvatar.random(gaussians=100, size=16)
        >>> check_avatar(posed, entries=1).verdict  # doctest: +SKIP
        'all 71 comparisons pass (98 Gaussians, 256 pixels, 0 at a step left out)'
    """
    f64, f32 = tolerances
    with one_torch_thread():
        draw = partial(_images, posed)
        check = _check_of(posed, entries, Generator().manual_seed(seed))
        rows = list(check.tangents(draw, "f64", f64))
        for name in posed.values:
            share = NETWORK_STEP_FACTOR if name.startswith(NETWORK) else STEP_FACTORS.get(name, 1.0)
            moves = partial(differences, draw, posed.values, name, step=share * DIFFERENCE_STEP)
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
    band = reference.threshold_band(posed.gaussians(inputs), posed.camera, alpha=CUT_OFF_BAND)
    # Not about zero: a gradient whose terms cancel to a thousandth loses three digits in any code.
    w = 1 + torch.randn(*band.shape, 5, generator=generator).double()
    w[band] = 0
    weights = dict(zip(IMAGES, (w[..., :3], w[..., 3], w[..., 4]), strict=True))
    images = dict(zip(IMAGES, _images(posed, inputs), strict=True))
    count = lambda g: g.numel() if g.numel() <= ALL_ENTRIES_FACTOR * entries else entries
    probe = lambda gradient: Probe.among(gradient, count(gradient), generator)
    return Check.of(inputs, images, weights, band, probe)
