"""Render a synthetic subject with Mitsuba's rays under fixed lights.

A pixel has S samples over its area. Each ray misses, or hits the surface at x with normal n and
albedo a:

    1. radiance = a/π · ( Σ_l E_l(x) + π · mean over directions ω ~ cos of  L(ω) )
    2. E_l      = area of l · L_l · cos θ_x · cos θ_l / r² · visible,        one point per sample
    3. L(ω)     = sky(ω) where nothing is hit, else the average colour of the surface there
    4. mask     = fraction of samples that hit;  normal = their mean, normalised
    5. color    = mask · sRGB( mean radiance of the hits ) + (1 − mask) · white

Eq. 5 blends encoded values, so color and mask agree as a renderer of 8-bit pictures expects.
Lights and directions are stratified over the S samples and every sample uses all lights, because
Mitsuba's path tracer, which picks one at random, is noisier. All sums have a fixed order: a seed
always gives the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np

from gva_mi.splat import Camera
from gva_mi.synthetic.clothes.level_sets import vertex_normals
from gva_mi.synthetic.look import Material, encode
from gva_mi.synthetic.subject import Subject
from gva_mi.synthetic.texture import albedo

VARIANT = "llvm_ad_rgb"
OFFSET = 1e-4  # m, distance of secondary rays' origins from the surface


@dataclass(frozen=True)
class AreaLight:
    """A parallelogram that emits light on one side."""

    centre: tuple[float, float, float]  # metres, world
    u: tuple[float, float, float]  # half edges; u × v points to the emitting side
    v: tuple[float, float, float]
    radiance: tuple[float, float, float]  # linear


# Besides the sky. Usual: a key light at the upper left of the camera and a weak fill light to the
# right, both metres wide. Side: one lamp to the left, which lights a turning person from all sides.
LIGHTS = {
    "usual": (
        AreaLight((-2.2, 3.0, 3.0), (0.7, 0.0, 0.5), (-0.4, 0.6, 0.55), (15.0, 14.5, 13.8)),
        AreaLight((3.2, 1.6, 2.2), (0.5, 0.0, -0.75), (0.0, 0.9, 0.0), (1.6, 1.7, 1.9)),
    ),
    "side": (AreaLight((-3.6, 1.4, 0.0), (0.0, 0.8, 0.0), (0.0, 0.0, 0.8), (24.0, 23.2, 22.1)),),
    "ambient": (),
}
SKY, EARTH = (0.58, 0.60, 0.63), (0.30, 0.29, 0.28)  # ambient radiance from above and from below


@dataclass(frozen=True)
class Rendering:
    """Images of a subject from one camera."""

    color: np.ndarray  # (H, W, 3) float32 in [0, 1], sRGB-encoded, on white
    mask: np.ndarray  # (H, W) float32 in [0, 1], coverage
    normals: np.ndarray  # (H, W, 3) float32, camera space, OpenCV axes; zero where empty
    depth: np.ndarray  # (H, W) float32, metres along z; zero where empty


class Renderer:
    """Render one subject in any number of poses."""

    def __init__(self, subject: Subject) -> None:
        import mitsuba as mi

        mi.set_variant(VARIANT)
        self._faces = subject.faces
        self._look = subject.look
        self._mesh = mi.Mesh("subject", len(subject.vertices), len(subject.faces))
        self._params = mi.traverse(self._mesh)
        self._params["faces"] = mi.UInt32(subject.faces.astype(np.uint32).ravel())
        self._params["vertex_positions"] = mi.Float(subject.vertices.ravel())
        self._params.update()
        self._scene = mi.load_dict({"type": "scene", "mesh": self._mesh})
        self._scene_params = mi.traverse(self._scene)
        self._material = mi.UInt32(subject.material)
        self._rest = mi.Float(subject.vertices.ravel())
        self._tint = mi.Float(subject.tint.ravel())
        self._corner = self._params["faces"]
        emission = np.array([subject.look.mean_color(p) for p in Material])
        self._emission = mi.Float((0.55 * emission).ravel().astype(np.float32))
        dr.eval(self._material, self._rest, self._tint, self._emission)

    def __call__(
        self,
        vertices: np.ndarray,
        camera: Camera,
        samples: int = 16,
        seed: int = 0,
        light: str = "usual",
    ) -> Rendering:
        """Render the subject's vertices (N, 3) in the world, metres, under one of LIGHTS.

        ``samples`` are rays per pixel, a square number; ``seed`` is that of all random numbers.
        """
        import mitsuba as mi

        (key,) = (k for k in self._scene_params.keys() if k.endswith("vertex_positions"))
        self._scene_params[key] = mi.Float(vertices.astype(np.float32).ravel())
        self._scene_params.update()
        normals = vertex_normals(vertices.astype(np.float64), self._faces)
        self._normals = mi.Float(normals.astype(np.float32).ravel())

        left, top, width, height = _window(vertices, camera)
        values = self._trace(camera.cropped(left, top, width, height), samples, seed, LIGHTS[light])
        values = values.reshape(height, width, samples, 8).astype(np.float64)
        hit = values[..., 7]
        count = hit.sum(2)
        mean = (values[..., :7] * hit[..., None]).sum(2) / np.maximum(count, 1)[..., None]
        mask = count / samples
        color = mask[..., None] * encode(mean[..., :3]) + (1 - mask[..., None])
        normal = mean[..., 3:6] @ camera.T_camera_world[:3, :3].T
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        normal = np.where(length > 1e-3, normal / np.maximum(length, 1e-3), 0)
        window = (slice(top, top + height), slice(left, left + width))
        shape = (camera.height, camera.width)

        def placed(part: np.ndarray, empty: float) -> np.ndarray:
            image = np.full((*shape, *part.shape[2:]), empty, dtype=np.float32)
            image[window] = part
            return image

        return Rendering(
            placed(color, 1.0), placed(mask, 0.0), placed(normal, 0.0), placed(mean[..., 6], 0.0)
        )

    def _trace(
        self, camera: Camera, samples: int, seed: int, lights: Sequence[AreaLight]
    ) -> np.ndarray:
        """Trace all samples of a view, (H W S, 8): radiance, world normal, depth, hit."""
        import mitsuba as mi

        n = int(round(samples**0.5))
        total = camera.width * camera.height * samples
        lane = dr.arange(mi.UInt32, total)
        pixel = lane // dr.opaque(mi.UInt32, samples)
        sample = lane - pixel * dr.opaque(mi.UInt32, samples)
        random = mi.PCG32(size=total, initstate=dr.opaque(mi.UInt64, seed))
        stratum = _Strata(random, pixel, sample, n)
        column = pixel % dr.opaque(mi.UInt32, camera.width)
        row = pixel // dr.opaque(mi.UInt32, camera.width)

        jitter = mi.Point2f(
            (mi.Float(sample % n) + random.next_float32()) / n,
            (mi.Float(sample // n) + random.next_float32()) / n,
        )
        ray, per_depth = _primary_rays(
            camera, mi.Float(column) + jitter.x, mi.Float(row) + jitter.y
        )
        at = self._scene.ray_intersect_preliminary(ray, coherent=True)
        hit = at.is_valid()
        material, rest, tint, n_shading = self._surface(at.prim_index, at.prim_uv, hit)
        color = albedo(self._look, material, rest) * tint
        start = ray(at.t) + n_shading * OFFSET - ray.d * OFFSET

        light = mi.Color3f(0)
        for source in lights:
            light += self._direct(source, start, n_shading, stratum(), hit)
        light += dr.pi * self._ambient(start, n_shading, stratum(), hit)
        radiance = color * light * dr.inv_pi
        values = [*radiance, *n_shading, at.t / per_depth, dr.select(hit, 1.0, 0.0)]
        values = [dr.select(hit, value, 0.0) for value in values]
        dr.eval(values)  # together, as one kernel
        return np.stack([value.numpy() for value in values], axis=-1)

    def _surface(
        self, triangle: dr.ArrayBase, uv: dr.ArrayBase, active: dr.ArrayBase
    ) -> tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]:
        """Return material, rest position, tint and shading normal at points of triangles."""
        import mitsuba as mi

        corner = dr.gather(mi.Vector3u, self._corner, triangle, active)
        weight = (1 - uv.x - uv.y, uv.x, uv.y)
        blend = lambda values: sum(
            dr.gather(mi.Vector3f, values, corner[k], active) * weight[k] for k in range(3)
        )
        material = dr.gather(mi.UInt32, self._material, triangle, active)
        normal = blend(self._normals)
        return material, blend(self._rest), blend(self._tint), normal / dr.norm(normal)

    def _direct(
        self,
        source: AreaLight,
        x: dr.ArrayBase,
        n: dr.ArrayBase,
        uv: dr.ArrayBase,
        active: dr.ArrayBase,
    ) -> dr.ArrayBase:
        """Return the irradiance from one point of an area light (eq. 2)."""
        import mitsuba as mi

        u, v = np.array(source.u), np.array(source.v)
        across = np.cross(u, v)
        area = 4 * float(np.linalg.norm(across))
        facing = mi.Vector3f(*(across / np.linalg.norm(across)).tolist())
        centre = mi.Point3f(*source.centre)
        edge_u, edge_v = mi.Vector3f(*source.u), mi.Vector3f(*source.v)
        to = centre + edge_u * (2 * uv.x - 1) + edge_v * (2 * uv.y - 1) - x
        distance = dr.norm(to)
        to = to / distance
        cosines = dr.maximum(dr.dot(n, to), 0) * dr.abs(dr.dot(facing, to))
        ray = mi.Ray3f(x, to, distance * (1 - 1e-4), 0.0, [])
        seen = ~self._scene.ray_test(ray, active & (cosines > 0))
        falloff = area * cosines / dr.square(distance)
        return mi.Color3f(*source.radiance) * dr.select(seen, falloff, 0.0)

    def _ambient(
        self, x: dr.ArrayBase, n: dr.ArrayBase, uv: dr.ArrayBase, active: dr.ArrayBase
    ) -> dr.ArrayBase:
        """Return L of a cosine-distributed direction (eq. 3)."""
        import mitsuba as mi

        local = mi.warp.square_to_cosine_hemisphere(uv)
        direction = mi.Frame3f(n).to_world(local)
        pi = self._scene.ray_intersect_preliminary(mi.Ray3f(x, direction), active=active)
        blocked = pi.is_valid()
        material = dr.gather(mi.UInt32, self._material, pi.prim_index, active & blocked)
        emission = dr.gather(mi.Color3f, self._emission, material, active & blocked)
        sky = dr.lerp(mi.Color3f(*EARTH), mi.Color3f(*SKY), 0.5 + 0.5 * direction.y)
        return dr.select(blocked, emission, sky)


def _primary_rays(
    camera: Camera, x: dr.ArrayBase, y: dr.ArrayBase
) -> tuple[dr.ArrayBase, dr.ArrayBase]:
    """Return rays through image points (pixels), and their length per metre of depth."""
    import mitsuba as mi

    number = lambda x: dr.opaque(mi.Float, x)
    direction = mi.Vector3f(
        (x - number(camera.cx)) / number(camera.fx),
        (y - number(camera.cy)) / number(camera.fy),
        1.0,
    )
    per_depth = dr.norm(direction)
    T_world_camera = np.linalg.inv(camera.T_camera_world)
    R = [[number(float(T_world_camera[i, j])) for j in range(3)] for i in range(3)]
    turned = mi.Vector3f(
        *(R[i][0] * direction.x + R[i][1] * direction.y + R[i][2] * direction.z for i in range(3))
    )
    eye = mi.Point3f(*(number(float(x)) for x in T_world_camera[:3, 3]))
    return mi.Ray3f(eye, turned / per_depth), per_depth


class _Strata:
    """Stratified points of the unit square: one per cell of an n × n grid over a pixel's samples.

    The cells are permuted for each call and pixel, so that dimensions do not correlate.
    """

    def __init__(
        self, random: dr.ArrayBase, pixel: dr.ArrayBase, sample: dr.ArrayBase, n: int
    ) -> None:
        self._random, self._pixel, self._sample, self._n = random, pixel, sample, n
        self._calls = 0

    def __call__(self) -> dr.ArrayBase:
        import mitsuba as mi

        n = self._n
        self._calls += 1
        key = mi.sample_tea_32(self._pixel, self._calls, 3)[0]
        cell = mi.permute_kensler(self._sample, n * n, key)
        u = (mi.Float(cell % n) + self._random.next_float32()) / n
        v = (mi.Float(cell // n) + self._random.next_float32()) / n
        return mi.Point2f(u, v)


def _window(vertices: np.ndarray, camera: Camera) -> tuple[int, int, int, int]:
    """Return the window of the picture that holds the vertices: left, top, width, height."""
    uv = camera.project(vertices.astype(np.float64))
    size = np.array([camera.width, camera.height])
    lo = np.clip(np.floor(uv.min(0)) - 1, 0, size - 1).astype(int)
    hi = np.clip(np.ceil(uv.max(0)) + 1, lo + 1, size).astype(int)
    return int(lo[0]), int(lo[1]), int(hi[0] - lo[0]), int(hi[1] - lo[1])
