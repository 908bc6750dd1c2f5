"""``gaussian_splat``: an integrator that splats the ``ellipsoids`` of a scene (EWA splatting).

It draws any scene made for Mitsuba's ray-traced ``volprim_rf_basic``, or loaded from a 3DGS .ply,
with the kernels of ``gva_mi.splat``: no rays, no noise, and correct gradients. The method is
EWA splatting (Zwicker et al., 2002) as in 3D Gaussian splatting (Kerbl et al., 2023).

1. C, α = splat(ellipsoids, sensor)         ``scene.py``
2. I = C + (1 - α) B                        B: the background, or the other shapes' picture
3. With ``meshes`` = ``depth`` or ``lit``, a pixel shows only ellipsoids whose centers are nearer
   than the surface at the pixel's center.
4. c = a S                                  with ``meshes`` = ``lit``: an ellipsoid's colour is its
                                            albedo a times the light S on it, ``lighting.py``

Parameters:
    ``meshes`` (string): ``none`` shows only the ellipsoids; ``depth`` puts them among the other
        shapes of the scene; ``lit`` does so in the scene's light. Default: ``none``.
    nested integrator: renders the other shapes, unless ``meshes`` is ``none``. Default: ``path``.
    ``proxy`` (string): id of a mesh of the scene that stands for the ellipsoids: it casts their
        shadow and is seen in mirrors, but not by the camera (``lighting.py``). ``lit`` needs it;
        ``depth`` may have it.
    ``bake`` (integer): rays per vertex of the proxy that measure the light. Default: 32.
    ``background`` (colour): shown behind the ellipsoids with ``meshes`` = ``none``; otherwise
        the scene's environment is shown. Default: black.
    ``srgb_primitives`` (boolean): whether the ellipsoids' colours are sRGB, as 3DGS trains them.
        Then eq. 2 is in sRGB too; the image is linear, as films are. Default: true.
    ``depth`` (boolean): adds the channel ``depth``, Σ Tᵢ αᵢ zᵢ of the ellipsoids in metres along
        the sensor's axis. Default: false.
    ``blur`` (float): added to the diagonal of the 2D covariances, square pixels. Default: 0.3.
    ``antialiased`` (boolean): reduce the opacity by the area that the blur adds.
        Default: false.

The sensor is ``perspective`` or ``orthographic``, with its crop window, clip distances and
principal point. ``spp``, ``seed`` and the film's filter affect only the nested integrator. A film
with alpha receives the opacity of ellipsoids and meshes together.

Note:
    Differentiable in ``data``, ``opacities`` and ``sh_coeffs`` of the shapes, in the sensor's
    ``to_world``, ``x_fov`` and principal point, and in whatever the nested integrator
    differentiates. Not in the order by depth, nor along the line where a surface hides an
    ellipsoid. With a proxy the sensor's parameters have no derivative through the surroundings.
    Without a proxy meshes and ellipsoids cast no light or shadow on each other, and glass hides
    ellipsoids behind it; with one it shows the proxy. A function under ``dr.freeze`` must not use
    it: the kernels are frozen already.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NoReturn

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.gaussian_splat.lighting import ProxyLight, Shares, on_host
from gva_mi_plugins.gaussian_splat.scene import OtherShapes, SensorCamera, gaussians_of, seen_along

from gva_mi.jit.frozen import exclusive
from gva_mi.splat import Gaussians, Image, SplatOptions
from gva_mi.splat.drjit_render import render
from gva_mi.splat.kernels.sh import C0

RAYS_PER_VERTEX = 32  # chosen: 3 % of noise under a sky, 9 % in a room with small lamps
TINY = 1e-4  # linear; below it sRGB is linear, and its power would have an infinite derivative


class GaussianSplat(mi.ad.integrators.common.ADIntegrator):
    """The integrator ``gaussian_splat``; the module's docstring describes it.

    Example:
        >>> ellipsoids = {
        ...     "type": "ellipsoids",
        ...     "centers": mi.TensorXf([[0, 0, 4], [1, 0, 5]]),
        ...     "scales": mi.TensorXf([[0.5, 0.5, 0.5], [0.5, 0.5, 0.5]]),
        ...     "quaternions": mi.TensorXf([[0, 0, 0, 1], [0, 0, 0, 1]]),
        ...     "opacities": mi.TensorXf([[0.9], [0.9]]),
        ...     "sh_coeffs": mi.TensorXf([[1, 1, 1], [1, -1, -1]]),  # white, and red
        ... }
        >>> film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        >>> sensor = {"type": "perspective", "film": film}
        >>> scene = mi.load_dict({"type": "scene", "sensor": sensor, "splats": ellipsoids})
        >>> parameters = mi.traverse(scene)
        >>> dr.enable_grad(parameters["splats.opacities"])
        >>> _ = parameters.update()
        >>> integrator = mi.load_dict({"type": "gaussian_splat"})
        >>> image = mi.render(scene, parameters, integrator=integrator)
        >>> image.shape
        (16, 16, 3)
        >>> dr.backward(dr.sum(image, axis=None))
        >>> grad = dr.grad(parameters["splats.opacities"])
        >>> grad[0] > 0, grad[1] > 0  # both ellipsoids are visible before black
        (True, True)
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if mi.variant() != "llvm_ad_rgb":
            raise ValueError(
                f"gaussian_splat: needs the variant llvm_ad_rgb, mi.variant() is {mi.variant()}"
            )
        self.meshes = str(props.get("meshes", "none"))
        if self.meshes not in ("none", "depth", "lit"):
            raise ValueError(
                f"gaussian_splat: meshes must be none, depth or lit, got '{self.meshes}'"
            )
        self.proxy = str(props.get("proxy", ""))
        nested = [x for _, x in props.objects() if isinstance(x, mi.Integrator)]
        if self.meshes == "none" and (nested or self.proxy):
            raise ValueError(
                "gaussian_splat: nested integrator and proxy need meshes = 'depth' or 'lit'"
            )
        if self.meshes == "lit" and not self.proxy:
            raise ValueError("gaussian_splat: meshes = 'lit' needs proxy, the id of a mesh")
        if self.meshes != "none" and "background" in props:
            raise ValueError(
                "gaussian_splat: background is for meshes = 'none'; with 'depth' or 'lit', give "
                "the scene an environment, such as the emitter 'constant'"
            )
        if self.meshes != "none":
            self.nested = nested[0] if nested else mi.load_dict({"type": "path"})
        self.bake = int(props.get("bake", RAYS_PER_VERTEX))
        self.background = [float(x) for x in mi.ScalarColor3f(props.get("background", 0.0))]
        self.srgb_primitives = bool(props.get("srgb_primitives", True))
        self.depth = bool(props.get("depth", False))
        self.options = SplatOptions(
            blur=float(props.get("blur", SplatOptions.blur)),
            antialiased=bool(props.get("antialiased", SplatOptions.antialiased)),
            depth=self.depth,
        )

    @exclusive
    def render(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        """Render (H, W, 3); one more channel for a film with alpha, and one for ``depth``."""
        with dr.suspend_grad():
            image = self._image(scene, sensor, seed, spp)
            if evaluate:
                dr.eval(image)
            return image

    @exclusive
    def render_forward(
        self,
        scene: mi.Scene,
        params: mi.SceneParameters,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> mi.TensorXf:
        """Return the derivative of the image along the parameters' gradients."""
        with dr.resume_grad():
            image = self._image(scene, sensor, seed, spp)
            if dr.grad_enabled(image):
                dr.forward_to(image)
            return dr.grad(image)

    @exclusive
    def render_backward(
        self,
        scene: mi.Scene,
        params: mi.SceneParameters,
        grad_in: mi.TensorXf,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> None:
        """Propagate the image's gradient to the gradients of the parameters."""
        with dr.resume_grad():
            image = self._image(scene, sensor, seed, spp)
            if dr.grad_enabled(image):
                dr.set_grad(image, grad_in)
                dr.enqueue(dr.ADMode.Backward, image)
                dr.traverse(dr.ADMode.Backward)
                dr.eval()

    def sample(self, *args: object, **kwargs: object) -> NoReturn:
        """Refuse single rays, which ``aov`` and ``moment`` ask of the integrator inside them."""
        raise ValueError(
            "gaussian_splat: draws whole images and no single rays, therefore it cannot be inside "
            "'aov' or 'moment': render it alone"
        )

    def aov_names(self) -> list[str]:
        """Return the names of the channels after colour and alpha."""
        return ["depth"] if self.depth else []

    def to_string(self) -> str:
        """Return the text that Mitsuba prints."""
        return f"GaussianSplat[meshes={self.meshes}, srgb_primitives={self.srgb_primitives}]"

    def _image(self, scene: mi.Scene, sensor: mi.Sensor | int, seed: int, spp: int) -> mi.TensorXf:
        """Render by eq. 1-3, attached to all parameters that have a gradient."""
        if dr.flag(dr.JitFlag.FreezingScope):  # otherwise Dr.Jit 1.5.0 ends the process
            raise RuntimeError(
                "gaussian_splat: a function under dr.freeze must not render with it; its kernels "
                "are frozen already"
            )
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        view = SensorCamera.of(sensor)
        if self.meshes == "none":
            background = self._to_primitives(mi.TensorXf(self.background))
            splats = self._splat(gaussians_of(scene), view, background=background)
            return self._develop(sensor, splats.color, splats.alpha, splats.depth)

        proxy = _proxy(scene, self.proxy) if self.proxy else None
        others, gaussians = OtherShapes.of(scene, sensor, proxy), gaussians_of(scene)
        if proxy is None:
            shown = others.image(self.nested, seed, spp)
        else:
            whole = OtherShapes.of(scene, sensor)
            shown = whole.image(self.nested, seed, spp, past=others)
            if self.meshes == "lit":
                gaussians = self._lit(gaussians, whole.scene, proxy, seed)
        splats = self._splat(gaussians, view, limit=others.depth(view.camera))
        behind = self._to_primitives(shown[:, :, :3])
        color = splats.color + (1 - _channel(splats.alpha)) * behind
        alpha = splats.alpha
        if shown.shape[2] == 4:
            alpha = 1 - (1 - alpha) * (1 - shown[:, :, 3])
        return self._develop(sensor, color, alpha, splats.depth)

    def _lit(self, gaussians: Gaussians, scene: mi.Scene, proxy: mi.Mesh, seed: int) -> Gaussians:
        """Return Gaussians whose colours are those of eq. 4."""
        vertices, faces = (on_host(mi.traverse(proxy)[x]) for x in ("vertex_positions", "faces"))
        light = ProxyLight.of(scene, vertices, faces.astype("i8"))
        on_vertices = light.on_vertices(self.nested, self.bake, seed, mi.traverse(scene))
        means = on_host(gaussians.means.array)
        on_gaussians = Shares.around(means, vertices).mean(on_vertices)
        n, K, _ = gaussians.sh.shape
        i = dr.arange(mi.UInt32, 3 * n)
        first = dr.gather(mi.Float, gaussians.sh.array, i // 3 * (3 * K) + i % 3)
        albedo = dr.maximum(0.5 + C0 * first, 0)
        if self.srgb_primitives:
            albedo = mi.math.srgb_to_linear(albedo)
        colors = self._to_primitives(mi.TensorXf(albedo, (n, 3)) * on_gaussians)
        return replace(gaussians, colors=colors, sh=None)

    def _splat(
        self,
        gaussians: Gaussians,
        view: SensorCamera,
        background: mi.TensorXf | None = None,
        limit: mi.TensorXf | None = None,
    ) -> Image:
        """Splat by eq. 1, in the colour space of the primitives."""
        if view.camera.model == "ortho" and gaussians.sh is not None:
            gaussians = seen_along(gaussians, view.axis)
        options = replace(self.options, near=view.near, far=view.far)
        return render(gaussians, view.camera, options, background, depth_limit=limit)

    def _to_primitives(self, color: mi.TensorXf) -> mi.TensorXf:
        """Convert linear colours to the colour space of the primitives."""
        return to_srgb(color) if self.srgb_primitives else color

    def _develop(
        self, sensor: mi.Sensor, color: mi.TensorXf, alpha: mi.TensorXf, depth: mi.TensorXf | None
    ) -> mi.TensorXf:
        """Develop the film's image from colours in the primitives' colour space."""
        if self.srgb_primitives:
            color = mi.TensorXf(mi.math.srgb_to_linear(color.array), color.shape)
        film = sensor.film()
        channels = [color]
        if mi.has_flag(film.flags(), mi.FilmFlags.Alpha):
            channels.append(_channel(alpha))
        channels.append(dr.full(mi.TensorXf, 1, (*alpha.shape, 1)))  # weight, of filters
        if self.depth:
            channels.append(_channel(depth))
        film.prepare(self.aov_names())
        film.put_block(mi.ImageBlock(dr.concat(channels, axis=2), film.crop_offset()))
        return film.develop()


def to_srgb(color: mi.TensorXf) -> mi.TensorXf:
    """Encode linear colours as sRGB, with a finite derivative at black.

    Example:
        >>> to_srgb(mi.TensorXf([0, 1]))
        [0, 1]
    """
    x = color.array
    encoded = mi.math.linear_to_srgb(dr.maximum(x, TINY))
    return mi.TensorXf(dr.select(x > TINY, encoded, 12.92 * x), color.shape)


def _proxy(scene: mi.Scene, name: str) -> mi.Mesh:
    """Return the mesh of a scene that has this id."""
    named = {shape.id(): shape for shape in scene.shapes()}
    if name not in named or not named[name].is_mesh() or named[name].is_ellipsoids():
        raise ValueError(
            f"gaussian_splat: proxy must be the id of a mesh of the scene, got '{name}'; its "
            f"shapes are {', '.join(sorted(named))}. Scenes from files keep ids "
            "if they are loaded with optimize=False"
        )
    return named[name]


def _channel(image: mi.TensorXf) -> mi.TensorXf:
    """Reshape (H, W) to (H, W, 1)."""
    return mi.TensorXf(image.array, (*image.shape, 1))
