"""Convert a Mitsuba scene: ellipsoids to Gaussians, a sensor to a camera, other shapes to depths.

**Gaussians** are the shapes of type ``ellipsoids``; the conversion is differentiable:

| what | in the shape | in the kernels |
|---|---|---|
| center, scale, rotation | ``data``, ten floats each: 3, 3, 4 | ``means, scales, quats`` |
| rotation | unit quaternion xyzw | wxyz, normalised inside |
| scale | standard deviations along its axes | the same |
| opacity at the center | ``opacities`` (N, 1) | ``opacities`` (N,) |
| colour | ``sh_coeffs`` (N, 3 K), coefficient by coefficient | ``sh`` (N, K, 3), the same basis |

The shape's ``extent`` limits an ellipsoid for ray tracers; a splat ends where its alpha falls to
1/255.

**The camera** is computed from the sensor, also differentiably. A Mitsuba sensor looks along +z,
with x to the left and y up: F = diag(-1, -1, 1) converts to OpenCV's axes. With ``to_world = [M |
o]``, the film's size (W, H) and the corner of its crop window, in pixels:

1. M = R diag(s)                                  s = 1 for perspective, which may not be scaled
2. T_camera_world = [F R⁻¹ | -F R⁻¹ o]
3. f = W / (2 tan(x_fov / 2))                     perspective
   f = (W / 2 s₀, W / 2 s₁)                       orthographic, pixels per metre
4. c = (W, H) / 2 - corner - (W, H) · offset      offset: principal_point_offset of perspective

**The other shapes** become a scene of their own, because a ray tracer cannot ignore the ellipsoids.
It shares shapes, materials and emitters with the first scene. It is built again for every picture,
with a new BVH, because shapes may have moved and only the first scene is notified.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gva_mi.splat import Camera, Gaussians
from gva_mi.splat.gaussians import MAX_DEGREE, degree_of
from gva_mi.splat.kernels import sh

FLOATS_PER_ELLIPSOID = 10  # floats in ``data``: center, scale, quaternion (Mitsuba)
SH_COUNTS = [(degree + 1) ** 2 for degree in range(MAX_DEGREE + 1)]  # K of every degree


def gaussians_of(scene: mi.Scene) -> Gaussians:
    """Collect all ellipsoids of a scene, attached to the shapes' parameters.

    Raises:
        ValueError: there is no ellipsoid, or an attribute is missing or has the wrong size.

    Example:
        >>> ellipsoids = {
        ...     "type": "ellipsoids",
        ...     "centers": mi.TensorXf([[0, 0, 4], [1, 0, 5]]),
        ...     "scales": mi.TensorXf([[0.5, 0.5, 0.5], [0.5, 0.5, 0.5]]),
        ...     "quaternions": mi.TensorXf([[0, 0, 0, 1], [0, 0, 0, 1]]),
        ...     "opacities": mi.TensorXf([[0.9], [0.9]]),
        ...     "sh_coeffs": mi.TensorXf([[1, 1, 1], [1, -1, -1]]),  # white, and red
        ... }
        >>> gaussians = gaussians_of(mi.load_dict({"type": "scene", "splats": ellipsoids}))
        >>> gaussians.means.shape, gaussians.sh.shape
        ((2, 3), (2, 1, 3))
        >>> gaussians.quats[0]  # wxyz
        [1, 0, 0, 0]
    """
    parts = [_Ellipsoids.of(shape) for shape in scene.shapes() if shape.is_ellipsoids()]
    if not parts:
        raise ValueError("gaussian_splat: the scene has no shape of type 'ellipsoids'")
    n, K = sum(part.count for part in parts), max(part.coefficients for part in parts)
    joined = lambda arrays: arrays[0] if len(arrays) == 1 else dr.concat(arrays)
    return Gaussians(
        means=mi.TensorXf(joined([part.columns(0, 1, 2) for part in parts]), (n, 3)),
        quats=mi.TensorXf(joined([part.columns(9, 6, 7, 8) for part in parts]), (n, 4)),
        scales=mi.TensorXf(joined([part.columns(3, 4, 5) for part in parts]), (n, 3)),
        opacities=mi.TensorXf(joined([part.opacities for part in parts]), (n,)),
        sh=mi.TensorXf(joined([part.harmonics(K) for part in parts]), (n, K, 3)),
    )


def seen_along(gaussians: Gaussians, direction: list[mi.Float]) -> Gaussians:
    """Evaluate the colours for parallel rays along a unit vector.

    Example:
        The first coefficient is a constant colour: 0.5 + 0.28 times it, at least 0.

        >>> zeros = lambda *shape: dr.zeros(mi.TensorXf, shape)
        >>> sh = mi.TensorXf([1, 0, -2], (1, 1, 3))
        >>> one = Gaussians(zeros(1, 3), zeros(1, 4), zeros(1, 3), zeros(1), sh=sh)
        >>> seen_along(one, [mi.Float(0), mi.Float(0), mi.Float(1)]).colors
        [[0.782095, 0.5, 0]]
    """
    n, K, _ = gaussians.sh.shape
    basis = sh.basis(degree_of(K), *direction)
    k = dr.arange(mi.UInt32, 3 * n)
    first = k // 3 * (3 * K) + k % 3
    total = mi.Float(0.5)
    for i in range(K):
        total = total + basis[i] * _gather(gaussians.sh.array, first + 3 * i)
    colors = mi.TensorXf(dr.select(total > 0, total, 0), (n, 3))
    return Gaussians(
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, colors
    )


@dataclass(frozen=True)
class _Ellipsoids:
    """Parameters of one shape."""

    data: mi.Float  # 10 N
    opacities: mi.Float  # N
    sh: mi.Float  # 3 K N
    count: int  # N
    coefficients: int  # K

    @staticmethod
    def of(shape: mi.Shape) -> _Ellipsoids:
        parameters = mi.traverse(shape)
        for name, form in (("opacities", "(N, 1)"), ("sh_coeffs", "(N, 3 K)")):
            if name not in parameters:
                raise ValueError(
                    f"gaussian_splat: shape '{shape.id()}' needs the attribute {name} {form}"
                )
        data, opacities, sh = (parameters[name] for name in ("data", "opacities", "sh_coeffs"))
        count = dr.width(data) // FLOATS_PER_ELLIPSOID
        coefficients, rest = divmod(dr.width(sh), 3 * count)
        if dr.width(opacities) != count:
            raise ValueError(
                f"gaussian_splat: opacities of shape '{shape.id()}' must be (N, 1), got "
                f"{dr.width(opacities)} numbers where N is {count}"
            )
        if rest or coefficients not in SH_COUNTS:
            raise ValueError(
                f"gaussian_splat: sh_coeffs of shape '{shape.id()}' must be (N, 3 K) with K one of "
                f"{SH_COUNTS}, got {dr.width(sh)} numbers where N is {count}"
            )
        return _Ellipsoids(data, opacities, sh, count, coefficients)

    def columns(self, *columns: int) -> mi.Float:
        """Select columns of ``data``, as one flat array of rows."""
        width = len(columns)
        k = dr.arange(mi.UInt32, self.count * width)
        column = dr.gather(mi.UInt32, mi.UInt32(columns), k % width)
        return _gather(self.data, k // width * FLOATS_PER_ELLIPSOID + column)

    def harmonics(self, coefficients: int) -> mi.Float:
        """Pad ``sh`` with zeros to ``coefficients`` coefficients per Gaussian and colour."""
        if coefficients == self.coefficients:
            return self.sh
        wide, given = 3 * coefficients, 3 * self.coefficients
        k = dr.arange(mi.UInt32, self.count * wide)
        return _gather(self.sh, k // wide * given + k % wide, k % wide < given)


def _gather(source: mi.Float, index: mi.UInt32, active: mi.Bool = True) -> mi.Float:
    """Gather from distinct indices, so that the adjoint needs no atomics."""
    return dr.gather(mi.Float, source, index, active=active, mode=dr.ReduceMode.NoConflicts)


# By how much an entry of R Rᵀ may differ from the identity. Chosen: above
# float32's rounding of a rotation.
ORTHONORMAL_TOLERANCE = 1e-4


@dataclass(frozen=True)
class SensorCamera:
    """A sensor's camera, its axis and its clip distances.

    Example:
        >>> film = {"type": "hdrfilm", "width": 16, "height": 16}
        >>> sensor = mi.load_dict({"type": "perspective", "fov": 90, "film": film})
        >>> view = SensorCamera.of(sensor)
        >>> round(view.camera.fx, 3), view.camera.cx, view.axis
        (8.0, 8.0, [[0], [0], [1]])
    """

    camera: Camera  # holds tensors attached to the sensor's parameters if one has a gradient
    axis: list[mi.Float]  # viewing direction: a unit vector of the world
    near: float  # m
    far: float  # m

    @staticmethod
    def of(sensor: mi.Sensor) -> SensorCamera:
        """Convert a ``perspective`` or ``orthographic`` sensor.

        Raises:
            ValueError: another kind of sensor, or a to_world with shear.
        """
        parameters, film = mi.traverse(sensor), sensor.film()
        to_world, size = sensor.world_transform().matrix, film.size()
        M = mi.Matrix3f([[to_world[i, j] for j in range(3)] for i in range(3)])
        c = [size[i] / 2 - film.crop_offset()[i] for i in range(2)]
        if sensor.class_name() == "PerspectiveCamera":
            model, s = "pinhole", mi.Vector3f(1)
            f = [size[0] / 2 / dr.tan(dr.deg2rad(parameters["x_fov"]) / 2)] * 2
            offsets = [parameters[f"principal_point_offset_{axis}"] for axis in "xy"]
            c = [c[i] - size[i] * offsets[i] for i in range(2)]
        elif sensor.class_name() == "OrthographicCamera":
            model = "ortho"
            columns = [mi.Vector3f(M[0, j], M[1, j], M[2, j]) for j in range(3)]
            s = mi.Vector3f([dr.norm(column) for column in columns])
            f = [size[0] / 2 / s[i] for i in range(2)]
        else:
            raise ValueError(
                "gaussian_splat: the sensor must be 'perspective' or 'orthographic', got "
                f"{sensor.class_name()}"
            )
        flip = mi.Matrix3f([[-1, 0, 0], [0, -1, 0], [0, 0, 1]])
        R = flip @ dr.rcp(M @ dr.diag(1 / s))
        t = -(R @ mi.Vector3f(*(to_world[i, 3] for i in range(3))))
        T = _tensor([*([*(R[i, j] for j in range(3)), t[i]] for i in range(3)), [0, 0, 0, 1]])
        K = _tensor([[f[0], 0, c[0]], [0, f[1], c[1]], [0, 0, 1]])

        dr.eval(T, K, s)
        attached = dr.grad_enabled(T, K)
        matrices = (K, T) if attached else (dr.detach(x).numpy() for x in (K, T))
        rotation = dr.detach(T).numpy().astype(np.float64)[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=ORTHONORMAL_TOLERANCE):
            raise ValueError("gaussian_splat: the sensor's to_world must not be sheared")
        camera = Camera.from_matrices(*matrices, *film.crop_size(), model)
        axis = [dr.gather(mi.Float, T.array, 8 + j) for j in range(3)]
        along_z = float(dr.detach(s.z)[0])
        near, far = along_z * sensor.near_clip(), along_z * sensor.far_clip()
        return SensorCamera(camera, axis, near, far)


def _tensor(rows: list[list[mi.Float | float]]) -> mi.TensorXf:
    numbers = [mi.Float(x) for row in rows for x in row]
    return mi.TensorXf(dr.concat(numbers), (len(rows), len(rows[0])))


def by_id(parts: Iterable[mi.Object]) -> dict[str, mi.Object]:
    """Return parts of a scene by their ids, for ``mi.load_dict``, which gives them the key as id.

    Example:
        >>> parts = [mi.load_dict({"type": "sphere", "id": name}) for name in ("ball", "ball")]
        >>> list(by_id(parts))
        ['ball', 'part1']
    """
    named: dict[str, mi.Object] = {}
    for k, part in enumerate(parts):
        taken = not part.id() or part.id() in named
        named[f"part{k}" if taken else part.id()] = part
    return named


def plane_mirrors(scene: mi.Scene) -> tuple[mi.Shape, ...]:
    """Return the rectangles of a scene that reflect perfectly and do nothing else.

    Example:
        >>> metal = {"type": "rectangle", "bsdf": {"type": "conductor"}}
        >>> parts = {"metal": metal, "glass": metal | {"bsdf": {"type": "dielectric"}}}
        >>> [shape.id() for shape in plane_mirrors(mi.load_dict({"type": "scene"} | parts))]
        ['metal']
    """
    flags = lambda shape: int(shape.bsdf().flags()) & int(mi.BSDFFlags.All)
    planes = [s for s in scene.shapes() if s.class_name() == "Rectangle" and s.bsdf()]
    mirrors = (s for s in planes if flags(s) == int(mi.BSDFFlags.DeltaReflection))
    return tuple(s for s in mirrors if not s.is_emitter())


def reflected(
    ray: mi.Ray3f, found: mi.PreliminaryIntersection3f, mirrors: Iterable[mi.Shape]
) -> tuple[mi.Bool, mi.Ray3f, mi.Color3f]:
    """Reflect the rays that meet a mirror: which do, the rays after it, and its reflectance.

    Example:
        >>> mirror = {"type": "rectangle", "bsdf": {"type": "conductor"}}
        >>> scene = mi.load_dict({"type": "scene", "mirror": mirror})
        >>> ray = mi.Ray3f([0, 0, 5], [0, 0, -1])
        >>> found = scene.ray_intersect_preliminary(ray)
        >>> hit, after, tint = reflected(ray, found, scene.shapes())
        >>> hit, after.d, tint  # a conductor reflects all light unless a material is named
        ([True], [[0, 0, 1]], [[1, 1, 1]])
    """
    hit = mi.Bool(False)
    for mirror in mirrors:
        hit |= found.is_valid() & (found.shape == mi.ShapePtr(mirror))
    at = found.compute_surface_interaction(ray, mi.RayFlags.All, hit)
    sample, tint = at.bsdf().sample(mi.BSDFContext(), at, 0.5, mi.Point2f(0.5), hit)
    return hit, at.spawn_ray(at.to_world(sample.wo)), tint


@dataclass(frozen=True)
class OtherShapes:
    """All shapes of a scene except ellipsoids, with the scene's emitters and a sensor.

    Example:
        >>> film = {"type": "hdrfilm", "width": 16, "height": 16}
        >>> sensor = {"type": "perspective", "film": film}
        >>> ball = {"type": "sphere", "center": [0, 0, 5]}
        >>> scene = mi.load_dict({"type": "scene", "sensor": sensor, "ball": ball})
        >>> others = OtherShapes.of(scene, scene.sensors()[0])
        >>> depth = others.depth(SensorCamera.of(others.sensor).camera)
        >>> depth[8, 8] < 4.1, depth[0, 0] == dr.inf  # on the ball, and beside it
        (True, True)
    """

    scene: mi.Scene
    sensor: mi.Sensor
    mirrors: tuple[mi.Shape, ...] = ()  # that show what is behind a proxy, not the proxy

    @staticmethod
    def of(scene: mi.Scene, sensor: mi.Sensor, proxy: mi.Mesh | None = None) -> OtherShapes:
        """Collect the shapes of a scene that are neither ellipsoids nor their ``proxy``.

        Raises:
            ValueError: there are none, and no proxy.
        """
        shapes = [s for s in scene.shapes() if not s.is_ellipsoids() and s != proxy]
        if not shapes and proxy is None:
            raise ValueError("gaussian_splat: meshes is 'depth', and the scene has no mesh")
        emitters = [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
        others = mi.load_dict({"type": "scene", **by_id([*shapes, *emitters, sensor])})
        for emitter in emitters:  # an environment encloses the scene that took it in last
            emitter.set_scene(scene)
        return OtherShapes(others, sensor)

    def image(
        self,
        integrator: mi.Integrator,
        seed: int,
        spp: int,
        params: mi.SceneParameters | None = None,
        past: OtherShapes | None = None,
    ) -> mi.TensorXf:
        """Render the shapes, (H, W, 3 or 4), with an integrator and its own derivatives.

        Args:
            integrator: any.
            seed: of its random numbers.
            spp: rays per pixel; 0: as the sensor says.
            params: parameters of the scene, if it was traversed before.
            past: these shapes without a proxy, which the camera then does not see.
        """
        sensor = self.sensor
        if past is not None:
            sensor = mi.load_dict({"type": "behind_person", "sensor": sensor})
            sensor.others, sensor.mirrors = past.scene, past.mirrors
        params = mi.traverse(self.scene) if params is None else params
        image = mi.render(self.scene, params, sensor, integrator, seed=seed, spp=spp)
        if image.shape[2] not in (3, 4) or integrator.aov_names():
            raise ValueError(
                "gaussian_splat: where meshes is not 'none', film and nested integrator must make "
                f"RGB or RGBA images, got {image.shape[2]} channels {integrator.aov_names()}"
            )
        return image

    def depth(self, camera: Camera) -> mi.TensorXf:
        """Depth (H, W) m along the camera's z of the surface at each pixel's centre.

        Infinite where there is no surface. Not differentiable.
        """
        with dr.suspend_grad():
            ray, found = self._centers(camera)
            return _depth(camera, ray, found.t)

    def depth_in(self, mirror: mi.Shape, camera: Camera) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Return :meth:`depth` of what a mirror shows, 0 beside it, and its reflectance (H, W, 3).

        The image of a point in a plane mirror is as far away as light has travelled.
        """
        with dr.suspend_grad():
            ray, found = self._centers(camera)
            hit, away, tint = reflected(ray, found, [mirror])
            further = self.scene.ray_intersect_preliminary(away, active=hit)
            depth = _depth(camera, ray, found.t + further.t)
            inside = dr.select(hit, depth.array, 0)
            return mi.TensorXf(inside, depth.shape), mi.TensorXf(dr.ravel(tint), (*depth.shape, 3))

    def _centers(self, camera: Camera) -> tuple[mi.Ray3f, mi.PreliminaryIntersection3f]:
        """Return rays through the centers of pixels, and what they meet."""
        pixel = dr.arange(mi.UInt32, camera.width * camera.height)
        row = pixel // camera.width
        size = mi.Point2f(camera.width, camera.height)
        center = (mi.Point2f(pixel - row * camera.width, row) + 0.5) / size
        ray, _ = self.sensor.sample_ray(0, 0, center, mi.Point2f(0.5))
        return ray, self.scene.ray_intersect_preliminary(ray, coherent=True)


def _depth(camera: Camera, ray: mi.Ray3f, t: mi.Float) -> mi.TensorXf:
    """Return the depth (H, W) along the camera's z of points on the rays of its pixels."""
    axis = mi.Vector3f(camera.T_camera_world[2, :3].tolist())
    z = dr.dot(axis, ray(t)) + float(camera.T_camera_world[2, 3])
    return mi.TensorXf(dr.select(dr.isfinite(t), z, dr.inf), (camera.height, camera.width))
