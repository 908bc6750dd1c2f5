"""Scenes to test and measure the kernels with: from a file, random, or shaped like a person."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Generator, Tensor

from gva_mi.core.errors import InputError
from gva_mi.splat.axes import half_turned
from gva_mi.splat.camera import Camera, CameraModel, CameraTensors, look_at
from gva_mi.splat.formats.gltf import load_gltf
from gva_mi.splat.formats.ply import load_ply
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.options import SplatOptions


@dataclass(frozen=True)
class Scene:
    """Gaussians, a camera, a background and options: the input of a picture.

    Example:
        >>> scene = random_scene(Generator().manual_seed(0), gaussians=5, width=16, height=12)
        >>> {name: tuple(x.shape) for name, x in scene.inputs().items()}["scales"]
        (5, 3)
        >>> (scene.through("fisheye").camera.model, scene.window(4, 4, 8, 8).camera.width)
        ('fisheye', 8)
    """

    gaussians: Gaussians  # float64 torch tensors
    camera: Camera  # made of float64 torch tensors if it is differentiated too
    background: Tensor  # (D,) float64
    options: SplatOptions = SplatOptions()

    @staticmethod
    def of(gaussians: Gaussians, camera: Camera, background: np.ndarray) -> Scene:
        """Make a scene from Gaussians of numpy arrays."""
        to_torch = lambda array: torch.tensor(np.asarray(array, dtype=np.float64))
        tensors = Gaussians(**{k: to_torch(v) for k, v in gaussians.arrays().items()})
        return Scene(tensors, camera, to_torch(background))

    @staticmethod
    def load(path: Path) -> Scene:
        """Look at the Gaussians of a .ply or .glb from their front, +z, on black.

        Nine tenths of them fill the middle: the rest of a captured scene is far away.

        Raises:
            InputError: no Gaussians, or numbers that are not finite; the message has the path.
        """
        in_world = path.suffix.lower() == ".glb"
        gaussians = load_gltf(path) if in_world else half_turned(load_ply(path))
        if not len(gaussians):
            raise InputError(f"{path}: holds no Gaussians; a scene needs one")
        for name, tensor in gaussians.arrays().items():
            if not torch.isfinite(tensor).all():
                raise InputError(f"{path}: holds {name} that are not finite")
        means = gaussians.means.detach().double().numpy()
        middle = np.median(means, axis=0)
        reach = float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.9))
        reach = max(reach, 3 * float(gaussians.scales.median()), 1e-3)
        T = look_at(middle + [0, 0, 4.5 * reach], middle)
        camera = Camera(716.8, 716.8, 256.0, 256.0, T, 512, 512)
        return Scene.of(gaussians, camera, np.zeros(gaussians.channels))

    def inputs(self) -> dict[str, Tensor]:
        """Return the differentiable tensors, by name."""
        matrices = {k: v for k, v in self.camera.tensors._asdict().items() if v is not None}
        return self.gaussians.arrays() | {"background": self.background} | matrices

    def with_camera_inputs(self) -> Scene:
        """Return the scene with a differentiable camera, made of tensors."""
        T, K = (torch.tensor(matrix) for matrix in (self.camera.T_camera_world, self.camera.K))
        return replace(self, camera=self.camera.with_matrices(T, K))

    def with_inputs(self, inputs: dict[str, Tensor]) -> Scene:
        """Return the scene with other tensors."""
        inputs = dict(inputs)
        background = inputs.pop("background")
        matrices = {k: inputs.pop(k) for k in CameraTensors._fields if k in inputs}
        camera = self.camera.with_matrices(**matrices) if matrices else self.camera
        return replace(self, gaussians=Gaussians(**inputs), background=background, camera=camera)

    def to(self, dtype: torch.dtype) -> Scene:
        """Return the scene in another precision, detached, as leaves that need gradients."""
        inputs = self.inputs().items()
        return self.with_inputs({k: v.detach().to(dtype).requires_grad_() for k, v in inputs})

    def rounded(self) -> Scene:
        """Round every number to float32, the camera's too."""
        round32 = lambda x: np.asarray(x, dtype=np.float32).astype(np.float64)
        c = self.camera
        rounded = self.to(torch.float32).to(torch.float64)
        if any(matrix is not None for matrix in c.tensors):
            return rounded
        camera = c.with_matrices(round32(c.T_camera_world), round32(c.K))
        return replace(rounded, camera=camera)

    def window(self, left: int, top: int, width: int, height: int) -> Scene:
        """Cut out a part of the picture as a scene, without the Gaussians that miss it."""
        g, camera = self.gaussians, self.camera.cropped(left, top, width, height)
        means, scales = g.means.detach().numpy(), g.scales.detach().numpy()
        x = means @ camera.T_camera_world[:3, :3].T + camera.T_camera_world[:3, 3]
        ahead = x[:, 2] > self.options.near
        z = np.where(ahead, x[:, 2], 1.0)
        # |J| <= f/z sqrt(1 + |x/z|^2) for a pinhole, and less for a fisheye; f for parallel rays
        stretch = 1.0
        if camera.model != "ortho":
            stretch = np.sqrt(1 + ((x[:, :2] / z[:, None]) ** 2).sum(axis=1)) / z
        sigma = scales.max(axis=1) * max(camera.fx, camera.fy) * stretch
        # alpha < alpha_min beyond so many sigma
        sigmas = math.sqrt(-2 * math.log(max(self.options.alpha_min, 1e-12)))  # 0: no cut-off
        reach = sigmas * np.sqrt(sigma**2 + self.options.blur)[:, None]
        u = camera.project(np.where(ahead[:, None], means, np.nan))
        near = (u + reach > 0) & (u - reach < [width, height])
        kept = {k: v[torch.from_numpy(near.all(axis=1))] for k, v in g.arrays().items()}
        return replace(self, gaussians=Gaussians(**kept), camera=camera)

    def through(self, model: CameraModel) -> Scene:
        """Return the view with another camera model; the Gaussians' middle stays about as large."""
        c, means = self.camera, self.gaussians.means.detach().numpy()
        size = 1.0
        if len(means) and (model == "ortho") != (c.model == "ortho"):  # px per metre, not per slope
            middle = float(np.median(c.depths(means)))
            size = 1 / middle if model == "ortho" else middle
        return replace(self, camera=replace(c, model=model, fx=c.fx * size, fy=c.fy * size))

    def windows(self, size: int, count: int) -> Iterator[tuple[str, Scene]]:
        """Yield ``count`` windows of ``size`` pixels, fullest to emptiest, named by place."""
        means = self.gaussians.means.detach().numpy()
        u = self.camera.project(means[self.camera.depths(means) > self.options.near])
        columns, rows = max(1, self.camera.width // size), max(1, self.camera.height // size)
        extent = [[0, columns * size], [0, rows * size]]
        crowd, _, _ = np.histogram2d(u[:, 0], u[:, 1], bins=(columns, rows), range=extent)
        places = np.argsort(-crowd, axis=None, kind="stable")[: np.count_nonzero(crowd)]
        if not len(places):
            raise InputError("the scene's camera sees none of its Gaussians")
        picked = np.linspace(0, len(places) - 1, count).astype(int)
        for place in dict.fromkeys(places[picked].tolist()):
            left, top = (int(i) * size for i in np.unravel_index(place, crowd.shape))
            width = min(size, self.camera.width - left)
            height = min(size, self.camera.height - top)
            yield f"pixel {left}, {top}", self.window(left, top, width, height)


def random_scene(
    generator: Generator,
    gaussians: int = 40,
    width: int = 32,
    height: int = 32,
    degree: int | None = None,
    channels: int = 3,
) -> Scene:
    """Spread random Gaussians about the origin, some beyond the picture's border, seen from 3 m.

    Give ``degree`` for spherical harmonics; None gives plain colours of so many channels.

    Example:
        >>> scene = random_scene(Generator().manual_seed(0), gaussians=5, degree=2)
        >>> tuple(scene.gaussians.sh.shape)
        (5, 9, 3)
    """
    n = gaussians
    uniform = lambda low, high, *shape: (
        low + (high - low) * torch.rand(*shape, generator=generator, dtype=torch.float64)
    )
    normal = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)
    kwargs = {"colors": uniform(0, 1, n, channels)}
    if degree is not None:
        kwargs, channels = {"sh": 0.4 * normal(n, (degree + 1) ** 2, 3)}, 3
    values = Gaussians(
        means=uniform(-1, 1, n, 3) * torch.tensor([1.0, 1.0, 0.6], dtype=torch.float64),
        quats=normal(n, 4),
        scales=torch.exp(uniform(math.log(0.03), math.log(0.3), n, 3)),
        opacities=uniform(0.05, 1.0, n),
        **kwargs,
    )
    T_camera_world = look_at((0.6, 0.4, 2.9), (0.0, 0.0, 0.0))
    fx = 1.7 * max(width, height)
    centre = width / 2 + 0.7, height / 2 - 0.4
    camera = Camera(fx, 1.05 * fx, *centre, T_camera_world, width, height)
    return Scene(values, camera, uniform(0, 1, channels))


# A person 1.79 m tall as tapered capsules: end a, end b (m, y up), radius at a, radius at b (m).
# Chosen by eye. The limbs, from the thigh on, are mirrored.
PERSON = (
    ((0.0, 0.93, 0.0), (0.0, 1.38, 0.0), 0.145, 0.155),  # trunk
    ((0.0, 1.40, 0.0), (0.0, 1.52, 0.0), 0.055, 0.055),  # neck
    ((0.0, 1.57, 0.01), (0.0, 1.70, 0.01), 0.090, 0.085),  # head
    ((0.10, 0.90, 0.0), (0.12, 0.49, 0.01), 0.082, 0.054),  # thigh
    ((0.12, 0.49, 0.01), (0.13, 0.09, -0.01), 0.053, 0.038),  # shin
    ((0.13, 0.04, 0.0), (0.14, 0.03, 0.15), 0.038, 0.030),  # foot
    ((0.18, 1.38, 0.0), (0.44, 1.19, 0.0), 0.054, 0.043),  # upper arm
    ((0.44, 1.19, 0.0), (0.65, 1.03, 0.05), 0.041, 0.029),  # forearm
    ((0.65, 1.03, 0.05), (0.77, 0.95, 0.08), 0.029, 0.016),  # hand
)


def person_scene(generator: np.random.Generator, gaussians: int = 20_000, size: int = 512) -> Scene:
    """Cover a person made of capsules with Gaussians, seen from 3 m: like an avatar.

    Their size follows the spacing on the surface, so that there are no holes at any number.
    ``size`` is the width and height of the picture, px.

    Example:
        >>> scene = person_scene(np.random.default_rng(0), gaussians=100, size=64)
        >>> round(float(scene.gaussians.means[:, 1].max()), 1)  # m, near the top of the head
        1.7
    """
    mirrored = [[*np.multiply(((a, b)), (-1, 1, 1)), *radii] for a, b, *radii in PERSON[3:]]
    limbs = [*PERSON, *mirrored]
    areas = [
        math.pi * (ra + rb) * math.dist(a, b) + 2 * math.pi * (ra**2 + rb**2)
        for a, b, ra, rb in limbs
    ]
    n, area = gaussians, sum(areas)
    limb = generator.choice(len(limbs), n, p=np.array(areas) / area)
    a, b, ra, rb = (np.array([limb_[k] for limb_ in limbs], dtype=float)[limb] for k in range(4))

    # a random direction about a random point of the axis, longer than the limb: its ends are caps
    length = np.linalg.norm(b - a, axis=1)
    axis = (b - a) / length[:, None]
    t = (generator.random(n) * (length + ra + rb) - ra) / length
    direction = generator.normal(size=(n, 3))
    beyond = np.where(t < 0, -1, np.where(t > 1, 1, 0))
    along = (direction * axis).sum(axis=1)
    kept = np.where(beyond == 0, 0, beyond * np.abs(along))
    direction += (kept - along)[:, None] * axis
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    t = np.clip(t, 0, 1)[:, None]
    means = a + t * (b - a) + direction * (ra[:, None] + t * (rb - ra)[:, None])

    spacing = math.sqrt(area / n)
    scales = spacing * np.array([0.75, 0.75, 0.35]) * np.exp(0.35 * generator.normal(size=(n, 3)))
    opacities = 1 / (1 + np.exp(-0.7 - 1.5 * generator.normal(size=n)))
    sh = 0.05 * generator.normal(size=(n, 16, 3))  # of degree 3
    sh[:, 0] = 1.4 * np.sin(means @ generator.normal(size=(3, 3)) * 4)
    gaussians = Gaussians(means, generator.normal(size=(n, 4)), scales, opacities, sh=sh)
    T_camera_world = look_at((0.25, 1.05, 3.0), (0.0, 0.88, 0.0))
    focal = 1.45 * size
    camera = Camera(focal, focal, size / 2, size / 2, T_camera_world, size, size)
    return Scene.of(gaussians, camera, np.array([0.1, 0.2, 0.3]))
