"""An avatar in a Mitsuba scene, with shadows, reflections, the scene's light, and gradients of all.

1. c_g = 2^e a_g S_g                  Gaussian g: its albedo, and the light on it;  light = "scene"
         as in the video              light = "kept"
2. C, α = splat(c), before the depth of the scene's shapes
3. I   = C + (1 - α) sRGB(2^e L)      L: the scene with the proxy in it, as seen past the proxy

In plane mirrors too, the camera sees Gaussians and not the proxy: L of a mirror's pixels is eq. 3
with the camera's image in the mirror, times the mirror's reflectance.

S, the light on Gaussians, and the sensors that see past a proxy and onto it belong to the plugin
``gaussian_splat`` (``plugins/gaussian_splat/lighting.py``). e is the exposure in
stops.

The proxy is the avatar's outer skin, an ordinary mesh with diffuse vertex colours, so any
integrator makes its shadows and reflections. It is the surface of the last re-initialisation with
the fingers of the rest body, smoothed once more: Gaussians do not mind a fold of it, but no light
falls into one. It moves as a Gaussian at vertex v would, by eq. 1 and 2 of
:mod:`gva_mi.avatar.avatar`:

4. v_t = A(v) (v + D(v) c + MLP(theta))

A video shows albedo times light, and cannot tell them apart. f_0 of a Gaussian, its colour without
the light's direction (eq. 4 of :mod:`gva_mi.avatar.avatar`), still has the dark armpits and
nostrils of the video, which the scene's light would darken again. So the video's light is taken to
come from all sides alike, and the person's mean light to be 1:

5. a_g = f_0 mean(V) / V_g            V: direct light of a white sky, mean over poses of the video

Single Gaussians are brighter than white where pictures blend them to white, so only the proxy's
albedo is limited.

Limits: surfaces are diffuse; the light is measured at the proxy's vertices, a centimetre apart;
through glass, and in curved mirrors, the person is the proxy; hair is opaque in shadows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import AVATAR_SPLATTING, Avatar
from gva_mi.avatar.reinit import SURFACE_OPACITY, ReinitOptions, mesh_gaussians
from gva_mi.avatar.rig import moved_by
from gva_mi.avatar.surface import SurfaceMesh, with_fingers
from gva_mi.body.pose import Pose
from gva_mi.body.skinning import skin_points
from gva_mi.core.errors import InputError
from gva_mi.core.options import PythonOnly, Within, options_of
from gva_mi.jit.frozen import exclusive
from gva_mi.jit.tensors import to_drjit
from gva_mi.mesh.mesh_scene import load_plugins
from gva_mi.splat import Camera, Gaussians
from gva_mi.splat.drjit_render import render as splat
from gva_mi.splat.kernels.sh import C0

if TYPE_CHECKING:
    import mitsuba as mi
    from gva_mi_plugins.gaussian_splat.lighting import ProxyLight

DARKEST, BRIGHTEST = 0.01, 0.95  # albedos of the proxy; chosen: black velvet to fresh snow
SKY_POSES = 6  # of the video, for eq. 5; chosen: a turn in steps of a sixth
LEAST_SKY = 0.2  # V / mean(V) in eq. 5; chosen: what sees less was hardly filmed, and is noise
VARIANT = "llvm_ad_rgb"
SMOOTHING = 10  # steps of Taubin's filter; chosen: folds of a few triangles come apart
PERSON = "person"  # the proxy's name among the scene's parameters


@dataclass(frozen=True)
class Proxy:
    """An avatar's outer skin, as a mesh that moves with the Gaussians.

    Example:
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> proxy = Proxy.of(avatar)
        >>> torch.allclose(proxy.posed(Pose.rest()), avatar.skin.vertices, atol=1e-6)
        True
    """

    avatar: Avatar
    vertices: Tensor  # (V, 3) metres, at rest
    faces: Tensor  # (F, 3) int64, counter-clockwise seen from outside
    weights: Tensor  # (V, 55) skinning weights
    directions: Tensor  # (V, 3, K) metres by which blend shapes move the vertices

    @staticmethod
    @torch.no_grad()
    def of(avatar: Avatar, surface: SurfaceMesh | None = None) -> Proxy:
        """Take the skin of an avatar.

        ``surface`` is the surface of its last re-initialisation, without fingers. Without it, and
        if the avatar was re-initialised, a surface is made from its opaque Gaussians.
        """
        rig, skin = avatar.rig, avatar.skin
        if surface is None and len(skin.vertices) == len(rig.vertices):
            vertices, faces = skin.vertices, rig.faces
        else:
            if surface is None:
                G = avatar.canonical
                solid = G.opacities > SURFACE_OPACITY
                means, weights = (x[solid].double().numpy() for x in (G.means, G.weights))
                surface = mesh_gaussians(means, rig, ReinitOptions(), weights)
            whole = with_fingers(surface, rig)
            smooth = whole.meshlab()
            smooth.apply_coord_taubin_smoothing(stepsmoothnum=SMOOTHING)
            vertices = torch.from_numpy(smooth.current_mesh().vertex_matrix()).to(rig.vertices)
            faces = torch.from_numpy(np.ascontiguousarray(whole.faces))
        bound = skin.bind(vertices)
        return Proxy(avatar, vertices, faces, bound["weights"], bound["directions"])

    @torch.no_grad()
    def posed(self, pose: Pose) -> Tensor:
        """Return v_t of eq. 4 in a pose of one frame, (V, 3) metres, in the avatar's world."""
        skeleton = self.avatar.posed_skeleton(pose)
        moved = self.vertices + moved_by(skeleton.coefficients, self.directions)[0]
        if self.avatar.options.residual.enabled:
            moved = moved + self.avatar.residual(self.vertices, self.weights, skeleton.rotations[0])
        return skin_points(moved, self.weights, skeleton.T_world_rest[0].to(moved.dtype))


@options_of("render")
class StageOptions:
    """How an avatar stands in a Mitsuba scene.

    Example:
        >>> StageOptions(light="scene", exposure=-1).bake
        32
    """

    # The person's light: as in the video, or the scene's; shadows and reflections are in both.
    light: Literal["kept", "scene"] = "kept"
    # Exposure of what the scene lights.
    exposure: Annotated[float, Within(-20, 20, unit="stops")] = 0.0
    # Rays per pixel; 0: as the scene says.
    spp: Annotated[int, Within(0, 65536)] = 0
    # Rays per vertex of the person's proxy, which measure the light.
    bake: PythonOnly[Annotated[int, Within(1, 65536)]] = 32


class Stage:
    """An avatar in a scene.

    Attributes:
        params: parameters of the scene with the proxy, ``person``, in it. Change them, or enable
            their gradients, then call ``params.update()``: pictures are attached to them as far as
            the scene's integrator differentiates (``prb`` and others; see Mitsuba).
        albedo: (N, 3) ``mi.TensorXf``, linear, of the Gaussians; may be attached too.
        integrator: the scene's, or ``path``.

    Example:
        An avatar that was not fitted, on a floor under a white sky.

        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> from gva_mi.mesh.mesh_scene import sensor_of
        >>> from gva_mi.splat import Camera, look_at
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> load_plugins()
        >>> camera = Camera(24.0, 24.0, 16.0, 16.0, look_at((0, 1, 3), (0, 0, 0)), 32, 32)
        >>> scene = {"type": "scene", "sky": {"type": "constant"}, "sensor": sensor_of(camera)}
        >>> stage = Stage(scene, avatar, StageOptions("scene", spp=4))
        >>> picture = stage.render(Pose.rest())
        >>> picture.shape, round(picture.array[0], 3)  # the sky
        ((32, 32, 3), 1.0)
    """

    def __init__(
        self,
        scene: mi.Scene | dict[str, Any],
        avatar: Avatar,
        options: StageOptions = StageOptions(),  # noqa: B008 (frozen)
        *,
        T_scene_avatar: np.ndarray | None = None,
        surface: SurfaceMesh | None = None,
        filmed: Pose | None = None,
        sensor: mi.Sensor | None = None,
    ) -> None:
        """Put an avatar into a scene.

        Args:
            scene: a Mitsuba scene or its dictionary, metres, y up, with a sensor, an emitter, and
                perhaps an integrator.
            avatar: of a finished fit.
            options: the form of light, exposure and numbers of rays.
            T_scene_avatar: (4, 4) rigid, from the world of the avatar's poses to the scene's; None:
                both are the same.
            surface: of the avatar's last re-initialisation; see :meth:`Proxy.of`.
            filmed: poses of the avatar's video, for eq. 5; None: the rest pose.
            sensor: in place of the scene's.

        Raises:
            InputError: the scene has no sensor or no emitter, or another variant than
                ``llvm_ad_rgb`` is set.
        """
        load_plugins()
        import drjit as dr
        import mitsuba as mi
        from gva_mi_plugins.gaussian_splat.lighting import Shares
        from gva_mi_plugins.gaussian_splat.scene import OtherShapes, plane_mirrors

        if mi.variant() != VARIANT:
            raise InputError(
                f"scene: expected the variant {VARIANT}, mi.variant() is {mi.variant()}"
            )
        scene = mi.load_dict(scene) if isinstance(scene, dict) else scene
        if not scene.emitters():
            raise InputError("scene: has no light, expected an emitter, such as 'constant'")
        if sensor is None and not scene.sensors():
            raise InputError("scene: has no sensor, expected one, such as 'perspective'")
        self.avatar, self.options, self.proxy = avatar, options, Proxy.of(avatar, surface)
        self.T_scene_avatar = np.eye(4) if T_scene_avatar is None else T_scene_avatar
        self.integrator = scene.integrator() or mi.load_dict({"type": "path"})
        self.others = OtherShapes(scene, sensor or scene.sensors()[0], plane_mirrors(scene))

        vertices, means = (
            x.detach().float().numpy() for x in (self.proxy.vertices, avatar.canonical.means)
        )
        self.around = Shares.around(means, vertices)
        mesh = _mesh(vertices, self.proxy.faces.numpy())
        self.albedo = _albedo(
            avatar, self._sky_light(mesh, Pose.rest() if filmed is None else filmed)
        )
        emitters = [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
        self.whole = _WithPerson.of([mesh, *scene.shapes(), *emitters], self.proxy)
        self.params = self.whole.params
        opacities = avatar.canonical.opacities.detach().numpy()
        solid = opacities >= min(SURFACE_OPACITY, opacities.max())
        colors = Shares.around(vertices, means[solid]).mean(mi.TensorXf(self.albedo.numpy()[solid]))
        self.params[f"{PERSON}.vertex_color"] = dr.clip(colors.array, DARKEST, BRIGHTEST)

    @exclusive
    def render(self, pose: Pose, *, sensor: mi.Sensor | None = None, seed: int = 0) -> mi.TensorXf:
        """Return the picture of a pose of one frame, (H, W, 3) sRGB, from 0 for black.

        ``sensor`` takes the place of the scene's. The same seed in all frames keeps noise still.

        Note:
            Differentiable in ``params`` and ``albedo``.
        """
        import mitsuba as mi
        from gva_mi_plugins.gaussian_splat.integrator import to_srgb

        if sensor is not None:
            self.others = replace(self.others, sensor=sensor)
        self.place(pose)
        gaussians = self.gaussians(pose, seed)
        behind = to_srgb(2**self.options.exposure * self.surroundings(seed))
        for mirror in (*self.others.mirrors, None):
            color, alpha = self.person(gaussians, mirror)
            behind = color + (1 - mi.TensorXf(alpha.array, (*alpha.shape, 1))) * behind
        return behind

    def place(self, pose: Pose) -> None:
        """Move the proxy to a pose of one frame."""
        T = torch.from_numpy(self.T_scene_avatar)
        self.whole.move(self.proxy.posed(pose).double() @ T[:3, :3].T + T[:3, 3])

    def light(self, seed: int = 0) -> mi.TensorXf:
        """Return S, the light on the Gaussians in the last pose, (N, 3) linear, attached."""
        return self.around.mean(self.whole.light(self.integrator, self.options.bake, seed))

    def _sky_light(self, mesh: mi.Mesh, poses: Pose) -> np.ndarray:
        """Return V of eq. 5, (N, 3)."""
        import mitsuba as mi

        outside = _WithPerson.of([mesh, mi.load_dict({"type": "constant"})], self.proxy)
        direct, found = mi.load_dict({"type": "path", "max_depth": 2}), []
        chosen = np.linspace(0, len(poses) - 1, min(SKY_POSES, len(poses)))
        for k in chosen.round().astype(int):
            outside.move(self.proxy.posed(poses[int(k)]))
            found.append(self.around.mean(outside.light(direct, self.options.bake)).numpy())
        return np.mean(found, axis=0)

    def gaussians(self, pose: Pose, seed: int = 0) -> Gaussians:
        """Return the Gaussians in the colours of eq. 1, Dr.Jit arrays, after :meth:`place`."""
        from gva_mi_plugins.gaussian_splat.integrator import to_srgb

        with torch.no_grad():
            g = self.avatar(pose)
        parts = {name: _tensor(x) for name, x in g.arrays().items()}
        if self.options.light == "scene":
            parts.pop("sh")
            gain = 2**self.options.exposure
            parts["colors"] = to_srgb(gain * self.albedo * self.light(seed))
        return Gaussians(**dict.fromkeys({"quats", "scales"} - parts.keys()), **parts)

    def person(
        self, gaussians: Gaussians, mirror: mi.Shape | None = None
    ) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Return C (H, W, 3) sRGB and α (H, W) of eq. 2, or of the person's image in a mirror."""
        import mitsuba as mi
        from gva_mi_plugins.gaussian_splat.integrator import to_srgb
        from gva_mi_plugins.gaussian_splat.scene import SensorCamera

        view = SensorCamera.of(self.others.sensor)
        options, camera = replace(AVATAR_SPLATTING, near=view.near, far=view.far), view.camera
        if mirror is None:
            limit = self.others.depth(camera)
        else:
            limit, tint = self.others.depth_in(mirror, camera)
            plane = _plane(mirror, camera)
            reflection = np.eye(4) - 2 * np.outer(plane * [1, 1, 1, 0], plane)
            camera = replace(camera, T_camera_world=camera.T_camera_world @ reflection)
            nx, ny, nz, d = plane @ self.T_scene_avatar
            before = gaussians.means.numpy() @ [nx, ny, nz] + d > 0
            opacities = gaussians.opacities * mi.TensorXf(before.astype(np.float32))
            gaussians = replace(gaussians, opacities=opacities)
        image = splat(gaussians, self.in_avatars_world(camera), options, depth_limit=limit)
        if mirror is None:
            return image.color, image.alpha
        color = tint.array * mi.math.srgb_to_linear(image.color.array)
        return to_srgb(mi.TensorXf(color, tint.shape)), image.alpha

    def in_avatars_world(self, camera: Camera) -> Camera:
        """Move a camera from the world of the scene to the world of the avatar's poses."""
        return replace(camera, T_camera_world=camera.T_camera_world @ self.T_scene_avatar)

    def surroundings(self, seed: int = 0) -> mi.TensorXf:
        """Return L of eq. 3, (H, W, 3) linear, attached, after :meth:`place`."""
        whole = replace(self.others, scene=self.whole.scene)
        image = whole.image(self.integrator, seed, self.options.spp, self.params, self.others)
        return image[:, :, :3]


def _plane(mirror: mi.Shape, camera: Camera) -> np.ndarray:
    """Return (n, d) with n · x + d = 0 on a mirror and a unit n towards the camera."""
    import mitsuba as mi

    at = mirror.sample_position(0, mi.Point2f(0.5))
    p, n = (np.array(x, np.float64).ravel() for x in (at.p, at.n))
    eye = np.linalg.inv(camera.T_camera_world)[:3, 3]
    return np.sign(n @ (eye - p)) * np.append(n, -n @ p)


def _tensor(x: Tensor) -> mi.TensorXf:
    import mitsuba as mi

    return mi.TensorXf(to_drjit(x.float(), mi.Float), tuple(x.shape))


def _albedo(avatar: Avatar, sky_light: np.ndarray) -> mi.TensorXf:
    """Return a of eq. 5, linear, (N, 3)."""
    import mitsuba as mi

    first = _tensor((avatar.canonical.sh.detach()[:, 0] * C0 + 0.5).clamp_min(0))
    linear = mi.math.srgb_to_linear(first.array).numpy().reshape(-1, 3)
    relative = np.maximum(sky_light / max(sky_light.mean(), 1e-6), LEAST_SKY)
    return mi.TensorXf((linear / relative).astype(np.float32))


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> mi.Mesh:
    """Return a mesh with diffuse vertex colours, grey, and smooth normals."""
    import mitsuba as mi

    color = {"type": "mesh_attribute", "name": "vertex_color"}
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(
        {"type": "twosided", "side": {"type": "diffuse", "reflectance": color}}
    )
    mesh = mi.Mesh(PERSON, len(vertices), len(faces), has_vertex_normals=True, props=props)
    mesh.set_id(PERSON)
    mesh.add_attribute("vertex_color", 3, np.full(vertices.size, 0.5, np.float32))
    params = mi.traverse(mesh)
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    params["vertex_positions"] = mi.Float(vertices.ravel())
    params.update()
    return mesh


@dataclass(frozen=True)
class _WithPerson:
    """A scene with a proxy in it."""

    scene: mi.Scene
    params: mi.SceneParameters
    proxy_light: ProxyLight
    faces: np.ndarray  # (F, 3)

    @staticmethod
    def of(parts: list[mi.Object], proxy: Proxy) -> _WithPerson:
        """Make a scene of shapes and emitters, of which the mesh of the proxy is one."""
        import mitsuba as mi
        from gva_mi_plugins.gaussian_splat.lighting import ProxyLight
        from gva_mi_plugins.gaussian_splat.scene import by_id

        scene, faces = mi.load_dict({"type": "scene", **by_id(parts)}), proxy.faces.numpy()
        light = ProxyLight.of(scene, proxy.vertices.float().numpy(), faces)
        return _WithPerson(scene, mi.traverse(scene), light, faces)

    def move(self, vertices: Tensor) -> None:
        """Move the proxy's vertices (V, 3)."""
        import mitsuba as mi

        x = vertices.float().numpy()
        self.params[f"{PERSON}.vertex_positions"] = mi.Float(x.ravel())
        self.params.update()
        self.proxy_light.follow(x, self.faces)

    def light(self, integrator: mi.Integrator, rays: int, seed: int = 0) -> mi.TensorXf:
        """Return the light on the proxy's vertices, (V, 3), attached to ``params``."""
        return self.proxy_light.on_vertices(integrator, rays, seed, self.params)
