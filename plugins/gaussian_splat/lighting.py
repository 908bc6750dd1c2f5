"""Light Gaussians by any integrator, through a mesh that stands for them: their proxy.

A *proxy* casts the Gaussians' shadow, is seen in mirrors and through glass, and receives the
scene's light. Two sensors let a renderer look past it and at it.

* ``behind_person`` wraps another sensor. It moves each ray to just before the first surface of the
  scene *without* the proxy. So the camera does not see the proxy, and everything else does:

  1. o' = o + (1 - NEAR) t d        t: distance of the first of the other shapes; or beyond them all

  A ray that meets one of ``mirrors`` first is reflected before, and carries its reflectance.

* ``onto_surface`` has one pixel per point of the proxy. Pixel k looks from a little above point k
  straight down at it, so an integrator measures the radiance that leaves the proxy there, with its
  own sampling, indirect light and derivatives:

  2. o = p_k + h n_k + r_k ξ,   d = -n_k       ξ: a point of the unit disc around n_k
     weight = 1 if the ray meets the proxy's outside within 2 h, else 0

The light on Gaussian g, :class:`ProxyLight`:

3. B_v, a_v = radiance and albedo that ``onto_surface`` sees at vertex v of the proxy
4. E_v = B_v / a_v                       a diffuse surface of albedo a shows a E: E is the light
5. S_v = E_u, u: the vertex of median brightness among v and those around it
6. S_g = Σ_v w_gv S_v                    w: shares of the vertices around Gaussian g

The same rays see B and a. So neither another part of the proxy nor a hole of it can make E large,
and E has a derivative by the proxy's albedo. Where nothing was hit, E is 0.

A path that happens to reach a lamp through glass or a mirror adds a value far above the mean:
a *firefly*. In a picture it is one pixel; here it would be a bright disc. A vertex in a fold of the
proxy is dark. Eq. 5 removes both, and keeps the edges of shadows. Twice as bright emitters
give twice the light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.gaussian_splat.scene import reflected

NEAR = 2e-4  # of eq. 1, share of the distance; chosen: far above float32's rounding
ABOVE = 0.1  # h of eq. 2, in distances of neighbouring points; chosen: less than from limb to limb
SPREAD = 0.25  # r of eq. 2, in the same unit; chosen: discs of neighbours do not overlap
ROW = 256  # pixels in a row of an ``onto_surface`` film; any number would do
_BOX = {"rfilter": {"type": "box"}, "component_format": "float32", "pixel_format": "rgb"}
NEIGHBOURS = 6  # vertices around a Gaussian, and around a vertex; chosen: one ring of a mesh
LEAST_ALBEDO = 1e-3  # below it a surface has no colour that light could be divided by; chosen


class BehindPerson(mi.Sensor):
    """The sensor ``behind_person``: rays of the nested sensor that pass a proxy by (eq. 1).

    Attributes:
        others: the scene without the proxy; set it before rendering the scene with the proxy.
        mirrors: shapes of ``others`` in which the proxy is not seen either.

    Example:
        >>> near = {"type": "sphere", "center": [0, 0, 3]}  # black: there is no light
        >>> wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 5])}
        >>> wall |= {"emitter": {"type": "area", "radiance": 1.0}, "flip_normals": True}
        >>> whole = mi.load_dict({"type": "scene", "near": near, "wall": wall})
        >>> film = {"type": "hdrfilm", "width": 3, "height": 3, "rfilter": {"type": "box"}}
        >>> camera = {"type": "perspective", "fov": 5, "film": film}
        >>> past = mi.load_dict({"type": "behind_person", "camera": camera})
        >>> past.others = mi.load_dict({"type": "scene", "wall": wall})
        >>> integrator = mi.load_dict({"type": "direct"})
        >>> images = [mi.render(whole, sensor=x, integrator=integrator, spp=1)
        ...           for x in (mi.load_dict(camera), past)]
        >>> [image[1, 1, 0].array[0] for image in images]
        [0.0, 1.0]
    """

    def __init__(self, props: mi.Properties) -> None:
        nested = [x for _, x in props.objects() if isinstance(x, mi.Sensor)]
        if len(nested) != 1:
            raise ValueError(f"behind_person: expected one nested sensor, got {len(nested)}")
        self.nested, self.others, self.mirrors = nested[0], None, ()
        props["film"], props["sampler"] = self.nested.film(), self.nested.sampler()
        super().__init__(props)

    def sample_ray(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Color3f]:  # fmt: skip
        """Sample a ray of the nested sensor and move its origin."""
        ray, weight = self.nested.sample_ray(time, sample1, sample2, sample3, active)
        return ray, weight * self._move(ray)

    def sample_ray_differential(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.RayDifferential3f, mi.Color3f]:  # fmt: skip
        """Sample a ray with differentials of the nested sensor and move its origin."""
        ray, weight = self.nested.sample_ray_differential(time, sample1, sample2, sample3, active)
        return ray, weight * self._move(ray)

    def _move(self, ray: mi.Ray3f) -> mi.Color3f:
        """Move a ray by eq. 1, and return the reflectance of mirrors on its way."""
        if self.others is None:
            raise ValueError("behind_person: set its attribute 'others', the scene without a proxy")
        with dr.suspend_grad():
            box = self.others.bbox()
            found, weight = self.others.ray_intersect_preliminary(ray, coherent=True), mi.Color3f(1)
            t = found.t
            if self.mirrors:
                hit, away, tint = reflected(ray, found, self.mirrors)
                weight[hit] = tint
                ray.o[hit], ray.d[hit] = away.o, away.d
                t[hit] = self.others.ray_intersect_preliminary(away, active=hit).t
            reach = dr.norm(ray.o - mi.Point3f(box.center())) + dr.norm(mi.Vector3f(box.extents()))
            t = dr.select(dr.isfinite(t), (1 - NEAR) * t, reach)
        ray.o = ray(t)
        return weight

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Offer the nested sensor's parameters."""
        self.nested.traverse(callback)

    def to_string(self) -> str:
        """Return the text that Mitsuba prints."""
        return f"BehindPerson[{self.nested}]"


class OntoSurface(mi.Sensor):
    """The sensor ``onto_surface``: pixel k looks at point k of a surface (eq. 2).

    Make it by :meth:`of`. Pixels beyond the number of points repeat the last one.

    Example:
        A white ball under a white sky looks white from everywhere.

        >>> white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1}}
        >>> ball, sky = {"type": "sphere", "bsdf": white}, {"type": "constant"}
        >>> scene = mi.load_dict({"type": "scene", "ball": ball, "sky": sky})
        >>> top_and_bottom = np.array([[0, 1.0, 0], [0, -1, 0]])
        >>> sensor = OntoSurface.of(scene, top_and_bottom, top_and_bottom, np.full(2, 0.1))
        >>> image = sensor.render(mi.load_dict({"type": "path"}), spp=64)
        >>> image.shape, bool(dr.all(dr.abs(image - 1) < 0.05, axis=None))
        ((2, 3), True)
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.scene: mi.Scene | None = None
        self.points: mi.Point3f | None = None
        self.normals: mi.Vector3f | None = None
        self.spacing: mi.Float | None = None

    @staticmethod
    def of(
        scene: mi.Scene, points: np.ndarray, normals: np.ndarray, spacing: np.ndarray
    ) -> OntoSurface:
        """Look at points (K, 3) of a scene's surface, with unit normals (K, 3) to the outside.

        ``spacing`` (K,) is the distance of neighbouring points, in units of the scene.
        """
        film = {"type": "hdrfilm", "width": ROW, "height": -(-len(points) // ROW), **_BOX}
        sampler = {"type": "multijitter"}
        sensor = mi.load_dict({"type": "onto_surface", "film": film, "sampler": sampler})
        sensor.scene, sensor.spacing = scene, mi.Float(np.asarray(spacing, np.float32))
        sensor.look_at(points, normals)
        return sensor

    def look_at(self, points: np.ndarray, normals: np.ndarray) -> None:
        """Follow points that have moved."""
        columns = lambda x: np.ascontiguousarray(x.T, np.float32)
        self.points, self.normals = mi.Point3f(columns(points)), mi.Vector3f(columns(normals))

    def render(
        self,
        integrator: mi.Integrator,
        spp: int,
        seed: int = 0,
        params: mi.SceneParameters | None = None,
    ) -> mi.TensorXf:
        """Render what an integrator sees at the points, (K, 3); attached to ``params``.

        ``spp`` rays per point are rounded up to a grid of samples.
        """
        side = math.isqrt(spp)
        grid = side * -(-spp // side)  # as the sampler would, with a warning
        image = mi.render(self.scene, params, self, integrator, spp=grid, seed=seed)
        count, channels = dr.width(self.points), image.shape[2]
        k = dr.arange(mi.UInt32, 3 * count)
        return mi.TensorXf(dr.gather(mi.Float, image.array, k // 3 * channels + k % 3), (count, 3))

    def sample_ray(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Color3f]:  # fmt: skip
        """Sample a ray of eq. 2."""
        size = mi.Vector2f(self.film().crop_size())
        at = sample2 * size
        cell = dr.minimum(dr.floor(at), size - 1)
        k = dr.minimum(mi.UInt32(cell.y * size.x + cell.x), dr.width(self.points) - 1)
        p, n = dr.gather(mi.Point3f, self.points, k), dr.gather(mi.Vector3f, self.normals, k)
        spacing = dr.gather(mi.Float, self.spacing, k)
        disc = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(dr.clip(at - cell, 0, 1)))
        disc *= SPREAD * spacing
        frame = mi.Frame3f(n)
        o = p + n * (ABOVE * spacing) + frame.s * disc.x + frame.t * disc.y
        ray = mi.Ray3f(o, -n, time, [])
        with dr.suspend_grad():
            probe = mi.Ray3f(o, -n, 2 * ABOVE * spacing, time, [])
            found = self.scene.ray_intersect(probe, mi.RayFlags.Minimal, coherent=False)
            outside = found.is_valid() & (dr.dot(found.n, n) > 0)
        # Weights do not reach the channels of ``aov``: a ray without weight must see nothing there.
        ray.maxt = dr.select(outside, probe.maxt, 0)
        return ray, mi.Color3f(dr.select(outside, 1.0, 0.0))

    def sample_ray_differential(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.RayDifferential3f, mi.Color3f]:  # fmt: skip
        """Sample a ray of eq. 2, without differentials."""
        ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
        return mi.RayDifferential3f(ray), weight

    def to_string(self) -> str:
        """Return the text that Mitsuba prints."""
        return f"OntoSurface[points={0 if self.points is None else dr.width(self.points)}]"


@dataclass(frozen=True)
class Shares:
    """Means over the vertices around points.

    Example:
        >>> at = np.array([[0.0, 0, 0], [1, 0, 0], [0, 5, 0]])
        >>> shares = Shares.around(np.array([[0.5, 0, 0]]), at, count=2)
        >>> shares.mean(mi.TensorXf([[1, 0, 0], [0, 1, 0], [0, 0, 1]]))
        [[0.5, 0.5, 0]]
    """

    weights: np.ndarray  # (N, k) float32, rows sum to 1
    vertices: np.ndarray  # (N, k) uint32

    @staticmethod
    def around(points: np.ndarray, vertices: np.ndarray, count: int = NEIGHBOURS) -> Shares:
        """Weight the nearest of ``vertices`` (V, 3) of points (N, 3).

        A vertex at distance d has the weight (1/d - 1/r)², r: distance of the first one left out.
        """
        from scipy.spatial import cKDTree

        d, near = cKDTree(vertices).query(points, k=min(count + 1, len(vertices)), workers=-1)
        inverse = 1 / np.maximum(d.reshape(len(points), -1), 1e-9)
        weights = np.square(inverse - inverse[:, -1:])
        weights[weights.sum(1) == 0, 0] = 1  # all equally far
        weights /= weights.sum(1, keepdims=True)
        return Shares(*(x[:, :count] for x in (weights, near.reshape(weights.shape))))

    def mean(self, values: mi.TensorXf) -> mi.TensorXf:
        """Return the means (N, C) of values (V, C) of vertices, differentiable in these."""
        (n, k), channels = self.weights.shape, values.shape[1]
        i = dr.arange(mi.UInt32, n * channels)
        point, channel = i // channels, i % channels
        total = mi.Float(0)
        for j in range(k):
            near = mi.UInt32(np.ascontiguousarray(self.vertices[:, j], np.uint32))
            weights = mi.Float(np.ascontiguousarray(self.weights[:, j], np.float32))
            vertex, weight = dr.gather(mi.UInt32, near, point), dr.gather(mi.Float, weights, point)
            total = total + weight * dr.gather(mi.Float, values.array, vertex * channels + channel)
        return mi.TensorXf(total, (n, channels))


@dataclass(frozen=True)
class ProxyLight:
    """The light on a proxy of V vertices in a scene.

    Example:
        An octahedron under a white sky: the light on it is 1 everywhere.

        >>> axes = np.eye(3)
        >>> corners = np.stack([axes, -axes], axis=1).reshape(6, 3)  # x, -x, y, -y, z, -z
        >>> front, back = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4]], [[2, 0, 5], [1, 2, 5]]
        >>> faces = np.array([*front, *back, [3, 1, 5], [0, 3, 5]])
        >>> proxy = mi.Mesh("proxy", vertex_count=6, face_count=8)
        >>> params = mi.traverse(proxy)
        >>> params["vertex_positions"], params["faces"] = corners.ravel(), faces.ravel()
        >>> changed = params.update()
        >>> scene = mi.load_dict({"type": "scene", "proxy": proxy, "sky": {"type": "constant"}})
        >>> light = ProxyLight.of(scene, corners, faces)
        >>> found = light.on_vertices(mi.load_dict({"type": "path"}), spp=64)
        >>> found.shape, bool(dr.all(dr.abs(found - 1) < 0.1, axis=None))
        ((6, 3), True)
    """

    sensor: OntoSurface
    ring: np.ndarray  # (V, k) int64, each vertex and those around it

    @staticmethod
    def of(scene: mi.Scene, vertices: np.ndarray, faces: np.ndarray) -> ProxyLight:
        """Prepare a proxy of ``scene``, from its vertices (V, 3) and faces (F, 3)."""
        from scipy.spatial import cKDTree

        count = min(NEIGHBOURS + 1, len(vertices))
        distance, near = cKDTree(vertices).query(vertices, k=count, workers=-1)
        spacing = distance[:, 1:].mean(1)
        sensor = OntoSurface.of(scene, vertices, vertex_normals(vertices, faces), spacing)
        return ProxyLight(sensor, near)

    def follow(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """Follow the proxy, whose vertices (V, 3) have moved in its scene."""
        self.sensor.look_at(vertices, vertex_normals(vertices, faces))

    def on_vertices(
        self,
        integrator: mi.Integrator,
        spp: int,
        seed: int = 0,
        params: mi.SceneParameters | None = None,
    ) -> mi.TensorXf:
        """Return S of eq. 5, (V, 3); attached to ``params`` as far as the integrator is."""
        surface = mi.load_dict({"type": "aov", "aovs": "albedo:albedo"})
        shown = self.sensor.render(integrator, spp, seed, params).array
        albedo = self.sensor.render(surface, spp, seed, params).array
        light = dr.select(
            albedo > LEAST_ALBEDO, shown / dr.maximum(albedo, LEAST_ALBEDO), mi.Float(0)
        )
        return self._without_specks(mi.TensorXf(light, (len(self.ring), 3)))

    def _without_specks(self, light: mi.TensorXf) -> mi.TensorXf:
        """Evaluate eq. 5 for values (V, 3) of vertices."""
        brightness = dr.detach(light).numpy().sum(1)[self.ring]
        middle = np.argsort(brightness, axis=1, kind="stable")[:, self.ring.shape[1] // 2]
        chosen = self.ring[np.arange(len(self.ring)), middle].astype(np.uint32)
        i = dr.arange(mi.UInt32, 3 * len(chosen))
        vertex = dr.gather(mi.UInt32, mi.UInt32(chosen), i // 3)
        return mi.TensorXf(dr.gather(mi.Float, light.array, 3 * vertex + i % 3), light.shape)


def on_host(array: mi.Float | mi.UInt32) -> np.ndarray:
    """Return rows of three numbers as a numpy array, (K, 3), detached.

    Example:
        >>> on_host(mi.Float([1, 2, 3, 4, 5, 6])).shape
        (2, 3)
    """
    return dr.detach(array).numpy().reshape(-1, 3)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit normals (V, 3), averaged over the faces (F, 3) around each vertex by area.

    Example:
        >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> vertex_normals(corners, np.array([[0, 1, 2]]))[0]
        array([0., 0., 1.])
    """
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    crossed, corners = np.cross(b - a, c - a), faces.T.ravel()
    total = lambda x: np.bincount(corners, np.tile(x, 3), len(vertices))
    normals = np.stack([total(x) for x in crossed.T], axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
