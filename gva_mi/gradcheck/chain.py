"""An avatar's picture as a chain of links, each a function of named tensors.

=============  =======================================================  =======================
link           from                                                     to
=============  =======================================================  =======================
shape          betas, expression                                        joints
skeleton       rotations, joints, transl                                R, T_world_rest  Eq. 4
blend shapes   means, R, expression                                     shaped_means
residual       rotations, the network's weights                         residual     Sec. 4.1
activations    log_scales, logit_opacities                              scales, opacities
skinning       T_world_rest, shaped_means, residual, quats, scales,     posed_means, covars,
               sh, light                                                posed_sh         Eq. 5
splatting      the posed Gaussians                                      image        Eq. 1-3
=============  =======================================================  =======================

The chain's first inputs are differentiated: the pose, the shape, the canonical Gaussians and the
network. Gradients leave out how the residual changes with the means (:class:`PoseResidual`); the
residual link therefore reads a constant copy of them, ``network_means``.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import torch
from torch import Generator, Tensor
from torch.func import functional_call
from torch.overrides import TorchFunctionMode

from gva_mi.avatar.avatar import Avatar, AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import BINDING, PARAMETERS, CanonicalGaussians, SeedOptions
from gva_mi.avatar.residual import ResidualOptions
from gva_mi.avatar.rig import moved_by
from gva_mi.avatar.skin_gaussians import skin_gaussians
from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JAW, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.gradcheck.probes import Tensors
from gva_mi.splat import Camera, Gaussians, Image, look_at, render

NETWORK = "residual."  # prefix of the names of the network's weights
STILL_MEANS = "network_means"
KINK = 3e-4  # Gaussians for which a relu's input is closer to zero are left out
LARGE_ANGLE, SMALL_ANGLE = 0.35, 0.15  # radians, standard deviations: limbs; hands and jaw


@dataclass(frozen=True)
class Link:
    """One step of the chain."""

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    function: Callable[[Tensors], tuple[Tensor, ...]]

    def extended(self, values: Tensors) -> Tensors:
        """Return the values with this link's outputs added."""
        return values | dict(zip(self.outputs, self.function(values), strict=True))


@dataclass(frozen=True)
class PosedAvatar:
    """An avatar in one pose before a camera, in both precisions."""

    models: Mapping[torch.dtype, tuple[BodyModel, Avatar]]
    values: Tensors  # the chain's first inputs, float64, of numbers that float32 holds
    camera: Camera
    background: Tensor  # (3,)

    @staticmethod
    def random(
        seed: int = 0, gaussians: int = 400, size: int = 40, body: Path | None = None
    ) -> PosedAvatar:
        """An avatar in a random pose, seen whole from 3 m; none of its parameters is zero.

        Args:
            seed: of all random numbers.
            gaussians: about how many.
            size: width and height of the picture, px.
            body: a body in SMPL-X's .npz format; the built-in body where None.
        """
        generator = Generator().manual_seed(seed)
        normal = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)
        bodies = {dtype: load_body(body, dtype) for dtype in (torch.float64, torch.float32)}
        betas = 0.5 * normal(bodies[torch.float64].num_betas)
        options = AvatarOptions(
            seed=SeedOptions(count=gaussians, opacity=0.6), residual=ResidualOptions(enabled=True)
        )
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
        pose = Pose(LARGE_ANGLE * normal(1, 55, 3), 0.1 * normal(1, 3), psi)
        for part in (JAW, LEFT_HAND, RIGHT_HAND):
            pose.rotations[:, part] *= SMALL_ANGLE / LARGE_ANGLE
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

    def render(self, values: Tensors) -> Image:
        """The picture as a fit draws it, by ``Avatar.forward`` and ``render``, of any precision.

        Only the joints of the shape are put in from outside: an avatar holds them as constants.
        """
        dtype = values["means"].dtype
        body, avatar = self.models[dtype]
        state = {k: v for k, v in values.items() if k.startswith(NETWORK)}
        state |= {f"canonical.{name}": values[name] for name in PARAMETERS}
        state |= {"rest_joints": body.rest(Shape(values["betas"])).joints, "light": values["light"]}
        pose = Pose(*(values[name][None] for name in ("rotations", "transl", "expression")))
        gaussians = functional_call(avatar, state, (pose,))
        return render(gaussians, self.camera, background=self.background.to(dtype))

    def links(self, dtype: torch.dtype = torch.float64) -> tuple[Link, ...]:
        """The chain in one precision."""
        body, avatar = self.models[dtype]
        G, parents, network = avatar.canonical, avatar.rig.parents, avatar.residual
        network_inputs = tuple(k for k in self.values if k.startswith(NETWORK))
        means = lambda v: v["shaped_means"] + v["residual"]
        return (
            Link("shape", ("betas", "expression"), ("joints",),
                 lambda v: (body.rest(Shape(v["betas"])).joints
                            + moved_by(v["expression"], avatar.rest_expression_joints),)),
            Link("skeleton", ("rotations", "joints", "transl"), ("R", "T_world_rest"),
                 lambda v: tuple(x[0] for x in turn_joints(v["rotations"][None], v["joints"],
                                                           parents, v["transl"][None]))),
            Link("blend shapes", ("means", "R", "expression"), ("shaped_means",),
                 lambda v: (v["means"] + G.moved_by(avatar.coefficients(v["R"],
                                                                        v["expression"])),)),
            Link("residual", ("rotations", *network_inputs), ("residual",),
                 lambda v: (functional_call(network, _network(v), (v[STILL_MEANS], G.weights,
                                                                   v["rotations"])),)),
            Link("activations", ("log_scales", "logit_opacities"), ("scales", "opacities"),
                 _activated),
            Link("skinning",
                 ("T_world_rest", "shaped_means", "residual", "quats", "scales", "sh", "light"),
                 ("posed_means", "covars", "posed_sh"),
                 lambda v: skin_gaussians(G.sparse_weights, v["T_world_rest"].double(), means(v),
                                          v["quats"], v["scales"], v["sh"], v["light"])),
            Link("splatting", ("posed_means", "covars", "opacities", "posed_sh"),
                 ("color", "alpha", "depth"), self._splatted),
        )  # fmt: skip

    def _splatted(self, values: Tensors) -> tuple[Tensor, ...]:
        gaussians = posed_gaussians(values)
        background = self.background.to(gaussians.means.dtype)
        image = render(gaussians, self.camera, background=background)
        return image.color, image.alpha, image.depth


def run(links: tuple[Link, ...], values: Tensors, moved: str | None = None) -> Tensors:
    """Return the first inputs and all that follows from them.

    Args:
        links: the chain.
        values: the first inputs; with ``moved`` all values of the chain.
        moved: the one input that differs from those the other values were made of.
    """
    values = {STILL_MEANS: values["means"].detach()} | values
    stale = {moved}
    for link in links:
        if moved is None or stale.intersection(link.inputs):
            values = link.extended(values)
            stale.update(link.outputs)
    return values


def posed_gaussians(values: Tensors) -> Gaussians:
    """The Gaussians that the chain's last link draws."""
    means, opacities = values["posed_means"], values["opacities"]
    return Gaussians(means, None, None, opacities, sh=values["posed_sh"], covars=values["covars"])


def _network(values: Tensors) -> Tensors:
    """The network's weights under their own names."""
    return {k.removeprefix(NETWORK): v for k, v in values.items() if k.startswith(NETWORK)}


def _activated(values: Tensors) -> tuple[Tensor, Tensor]:
    """Return scales and opacities, computed by the canonical Gaussians' own properties."""
    raw = SimpleNamespace(**values)
    return CanonicalGaussians.scales.fget(raw), CanonicalGaussians.opacities.fget(raw)


class _ReluInputs(TorchFunctionMode):
    """Recorder of the rows for which all inputs of all relus are away from zero."""

    away: Tensor | bool = True

    def __torch_function__(self, function, types, args=(), kwargs=None):  # noqa: ANN001, ANN204
        if function is torch.relu:
            self.away = self.away & (args[0].abs() > KINK).all(1)
        return function(*args, **(kwargs or {}))


def _away_from_kinks(avatar: Avatar, values: Tensors) -> tuple[Avatar, Tensors]:
    """Return an avatar and its values without the Gaussians at a kink of the network's relu."""
    place = values["means"], avatar.canonical.weights, values["rotations"]
    with _ReluInputs() as relus:
        functional_call(avatar.residual, _network(values), place)
    some = {name: values[name][relus.away] for name in PARAMETERS}
    binding = {name: getattr(avatar.canonical, name)[relus.away] for name in BINDING}
    canonical = CanonicalGaussians(**some, **binding)
    few = Avatar(canonical, avatar.residual, avatar.rig, avatar.skin, avatar.options)
    return few, values | some
