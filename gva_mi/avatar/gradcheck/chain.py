"""An avatar's picture as a chain of links, each a function of named tensors.

=============  =======================================================  =======================
link           from                                                     to
=============  =======================================================  =======================
shape          betas, expression                                        joints
skeleton       rotations, joints, transl                                R, T_world_rest  Eq. 4
blend shapes   means, R, expression                                     shaped_means
residual       means, rotations, the network's weights                  residual     Sec. 4.1
blend          T_world_rest, shaped_means, residual                     A, E             Eq. 5
activations    log_scales, logit_opacities                              scales, opacities
stretch        A, E, shaped_means, residual, quats, scales              posed_means, covars
colours        sh, A, light                                             posed_sh
splatting      the posed Gaussians                                      image        Eq. 1-3
=============  =======================================================  =======================

What is differentiated are the chain's first inputs: the pose, the shape, the canonical Gaussians
and the network. Every link exists twice: as the avatar computes it, and as its slow twin.
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

from gva_mi.avatar.avatar import Avatar, AvatarOptions, moved_by, seed_avatar
from gva_mi.avatar.canonical import CARRIERS, PARAMETERS, CanonicalGaussians, SeedOptions
from gva_mi.avatar.gradcheck import twins
from gva_mi.avatar.light import lit
from gva_mi.avatar.residual import ResidualOptions
from gva_mi.avatar.stretch import carry_stretched
from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JAW, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.splat import Camera, Gaussians, Image, look_at, reference, render

NETWORK = "residual."  # what the names of the network's weights begin with
KINK = 3e-4  # Gaussians at which the network's relu is nearer to its kink are left out
LARGE_ANGLE, SMALL_ANGLE = 0.35, 0.15  # radians, standard deviations: limbs; hands and jaw

Values = dict[str, Tensor]  # of a chain, by the names of the table above


@dataclass(frozen=True)
class Link:
    """One link, as the avatar computes it and as its slow twin does."""

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    fast: Callable[[Values], tuple[Tensor, ...]]
    slow: Callable[[Values], tuple[Tensor, ...]]


@dataclass(frozen=True)
class Scene:
    """What is asked about: an avatar in one pose, and who sees it."""

    models: Mapping[torch.dtype, tuple[BodyModel, Avatar]]  # in both precisions
    values: Values  # the chain's first inputs, float64, of numbers that float32 holds
    camera: Camera
    background: Tensor  # (3,)

    @staticmethod
    def random(
        seed: int = 0, gaussians: int = 400, size: int = 40, body: Path | None = None
    ) -> Scene:
        """An avatar on a body, nothing of it zero, in a random pose, seen whole from 3 m.

        Args:
            seed: of all random numbers.
            gaussians: about how many.
            size: width and height of the picture, px.
            body: a body in SMPL-X's .npz format; the built-in puppet where None.
        """
        generator = Generator().manual_seed(seed)
        normal = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)
        bodies = {dtype: load_body(body, dtype) for dtype in (torch.float64, torch.float32)}
        betas = 0.5 * normal(bodies[torch.float64].num_betas)
        seeds, moved = SeedOptions(count=gaussians, opacity=0.6), ResidualOptions(enabled=True)
        options = AvatarOptions(seed=seeds, residual=moved)
        shape = Shape(betas.float())
        # The network draws from numbers of its own: a larger one is no other pose.
        of_network = Generator().manual_seed(seed)
        avatar = seed_avatar(bodies[torch.float32], shape, None, options, of_network).double()
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
        network = {NETWORK + k: v for k, v in avatar.residual.named_parameters()}
        values = {field: getattr(pose, field)[0] for field in ("rotations", "transl", "expression")}
        values |= {"betas": betas, "light": avatar.light}
        values |= {name: getattr(avatar.canonical, name) for name in PARAMETERS} | network
        values = {k: v.detach().float().double() for k, v in values.items()}
        avatar, values = _off_kinks(avatar, values)
        models = {k: (b, copy.deepcopy(avatar).to(k)) for k, b in bodies.items()}
        return Scene(models, values, camera, background)

    def animated(self, values: Values) -> Image:
        """The picture as a fit draws it, :meth:`Avatar.animate` and ``render``, of any precision.

        Only the joints of the shape are put in from outside: an avatar holds them as constants.
        """
        dtype = values["means"].dtype
        body, avatar = self.models[dtype]
        joints = body.rest(Shape(values["betas"])).joints
        state = {k: v for k, v in values.items() if k.startswith(NETWORK)}
        state |= {f"canonical.{name}": values[name] for name in PARAMETERS}
        state |= {"rest_joints": joints, "light": values["light"]}
        pose = Pose(*(values[name][None] for name in ("rotations", "transl", "expression")))
        gaussians = functional_call(avatar, state, (pose,))
        return render(gaussians, self.camera, background=self.background.to(dtype))

    def links(self, dtype: torch.dtype = torch.float64) -> tuple[Link, ...]:
        """The chain, its fast functions in a precision; the slow ones are float64."""
        body, avatar = self.models[dtype]
        G, parents, network = avatar.canonical, avatar.rig.parents, avatar.residual
        weights, slopes, directions = G.weights, G.slopes, G.directions
        return (
            Link("shape", ("betas", "expression"), ("joints",),
                 lambda v: (body.rest(Shape(v["betas"])).joints
                            + moved_by(v["expression"], avatar.rest_expression_joints),),
                 lambda v: (twins.shaped(twins.joints(body, v["betas"]), v["expression"],
                                         avatar.rest_expression_joints),)),
            Link("skeleton", ("rotations", "joints", "transl"), ("R", "T_world_rest"),
                 lambda v: tuple(x[0] for x in turn_joints(v["rotations"][None], v["joints"],
                                                           parents, v["transl"][None])),
                 lambda v: twins.transforms(v["rotations"], v["joints"], parents, v["transl"])),
            Link("blend shapes", ("means", "R", "expression"), ("shaped_means",),
                 lambda v: (v["means"] + G.moved_by(avatar.coefficients(v["R"], v["expression"])),),
                 lambda v: (twins.shaped(v["means"], twins.coefficients(v["R"], v["expression"],
                                         avatar.rest_pose_features), directions),)),
            Link("residual",
                 ("means", "rotations", *(k for k in self.values if k.startswith(NETWORK))),
                 ("residual",),
                 lambda v: (functional_call(network, _network(v),
                                            (v["means"], weights, v["rotations"])),),
                 lambda v: (twins.residual(network, _network(v), v["means"].detach(), weights,
                                           v["rotations"]),)),
            Link("blend", ("T_world_rest", "shaped_means", "residual"), ("A", "E"),
                 lambda v: G.blended(v["T_world_rest"], v["shaped_means"] + v["residual"]),
                 lambda v: twins.blend(weights, slopes, v["T_world_rest"],
                                       v["shaped_means"] + v["residual"])),
            Link("activations", ("log_scales", "logit_opacities"), ("scales", "opacities"),
                 _activated,
                 lambda v: (v["log_scales"].exp(), 1 / (1 + (-v["logit_opacities"]).exp()))),
            Link("stretch", ("A", "E", "shaped_means", "residual", "quats", "scales"),
                 ("posed_means", "covars"),
                 lambda v: carry_stretched(v["A"], v["E"], v["shaped_means"] + v["residual"],
                                           v["quats"], v["scales"]),
                 lambda v: twins.stretch(v["A"], v["E"], v["shaped_means"] + v["residual"],
                                         v["quats"], v["scales"])),
            Link("colours", ("sh", "A", "light"), ("posed_sh",),
                 lambda v: (lit(v["sh"], v["A"], v["light"]),),
                 lambda v: (twins.lit(v["sh"], v["A"], v["light"]),)),
            Link("splatting",
                 ("posed_means", "covars", "opacities", "posed_sh"),
                 ("color", "alpha", "depth"),
                 lambda v: self._drawn(render, v), lambda v: self._drawn(reference.render, v)),
        )  # fmt: skip

    def slope(self, values: Values, grad_residual: Tensor) -> Tensor:
        """The gradient (N, 3) by the means through the residual, which the network leaves out."""
        avatar, means = self.models[torch.float64][1], values["means"].clone()
        network, weights = avatar.residual, avatar.canonical.weights
        means.requires_grad_()
        moved = twins.residual(network, _network(values), means, weights, values["rotations"])
        return torch.autograd.grad(moved, means, grad_residual)[0]

    def _drawn(self, draw: Callable[..., Image], values: Values) -> tuple[Tensor, ...]:
        gaussians = posed(values)
        background = self.background.to(gaussians.means.dtype)
        image = draw(gaussians, self.camera, background=background)
        return image.color, image.alpha, image.depth


def run(links: tuple[Link, ...], values: Values, *, slow: bool = False) -> Values:
    """The first inputs and all that follows from them."""
    values = dict(values)
    for link in links:
        found = (link.slow if slow else link.fast)(values)
        values |= zip(link.outputs, found, strict=True)
    return values


def posed(values: Values) -> Gaussians:
    """The Gaussians that the chain's last link draws."""
    means, opacities = values["posed_means"], values["opacities"]
    return Gaussians(means, None, None, opacities, sh=values["posed_sh"], covars=values["covars"])


def _network(values: Values) -> Values:
    """The network's weights under their own names."""
    return {k.removeprefix(NETWORK): v for k, v in values.items() if k.startswith(NETWORK)}


def _activated(values: Values) -> tuple[Tensor, Tensor]:
    """Scales and opacities, by the properties of the canonical Gaussians themselves."""
    raw = SimpleNamespace(**values)
    return CanonicalGaussians.scales.fget(raw), CanonicalGaussians.opacities.fget(raw)


def _off_kinks(avatar: Avatar, values: Values) -> tuple[Avatar, Values]:
    """An avatar and its values without the Gaussians at a kink of the network's relu."""
    place = values["means"], avatar.canonical.weights
    before = twins.before_relu(avatar.residual, _network(values), *place, values["rotations"])
    kept = torch.nonzero((before.abs() > KINK).all(1)).flatten()
    some = {name: values[name][kept] for name in PARAMETERS}
    carriers = {name: getattr(avatar.canonical, name)[kept] for name in CARRIERS}
    canonical = CanonicalGaussians(**some, **carriers)
    few = Avatar(canonical, avatar.residual, avatar.rig, avatar.skin, avatar.options)
    return few, values | some
