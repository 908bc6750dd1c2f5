"""Render a synthetic subject with Mitsuba's rays under fixed lamps, on white or in a room.

A pixel has S samples over its area. Each ray misses, or hits a surface at x with normal n and
albedo a:

    1. radiance = a/π · ( Σ_l E_l(x) + π · mean over directions ω ~ cos of  L(ω) )
    2. E_l      = area of l · L_l · cos θ_x · cos θ_l / r² · visible,        one point per sample
    3. L(ω)     = sky(ω) where nothing is hit, else the average colour of the surface there
    4. mask     = fraction of samples that hit the person;  normal = their mean, normalised
    5. color    = mask · sRGB( mean radiance of these ) + (1 − mask) · white,  or in a room
       color    = sRGB( mask · mean radiance of these + Σ a of others / S · light of the room )
    6. light    = Σ radiance / Σ a  of the samples that miss the person, over 5 × 5 pixels

On white, eq. 5 blends encoded values, so color and mask agree as a renderer of 8-bit pictures
expects; in a room light is blended, as in a camera. By eq. 6, few samples suffice beside the
person. Lights and directions are stratified over the S samples and every sample uses all lights,
because Mitsuba's path tracer, which picks one at random, is noisier. All sums have a fixed order: a
seed always gives the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.core.srgb import encoded
from gva_mi.splat import Camera
from gva_mi.synthetic.person.level_sets import vertex_normals
from gva_mi.synthetic.person.surface import PersonSurface
from gva_mi.synthetic.person.texture import Material, albedo
from gva_mi.synthetic.pictures.finishes import finish_color
from gva_mi.synthetic.pictures.lights import LIGHTS, AreaLight
from gva_mi.synthetic.pictures.room import Room, smoothly_lit

VARIANT = "llvm_ad_rgb"
# Metres from the surface to the origins of secondary rays. Chosen: above float32's error.
SECONDARY_RAY_OFFSET = 1e-4
FEWER_SAMPLES = 4  # times fewer beside the person; chosen: eq. 6 smooths the light there
PERSON_MATERIALS = len(Material)  # finishes of a room have the numbers from here on
# Columns of what a ray finds; ALBEDO only if the room is shown.
RADIANCE, NORMAL, DEPTH, HIT, ALBEDO = slice(0, 3), slice(3, 6), 6, slice(7, 8), slice(8, 11)
OF_PERSON, OF_ROOM = slice(0, 7), np.r_[RADIANCE, ALBEDO]


@dataclass(frozen=True)
class Rendering:
    """Images of a subject from one camera."""

    color: np.ndarray  # (H, W, 3) float32 in [0, 1], sRGB-encoded, on white or in a room
    mask: np.ndarray  # (H, W) float32 in [0, 1], coverage
    normals: np.ndarray  # (H, W, 3) float32, camera space, OpenCV axes; zero where empty
    depth: np.ndarray  # (H, W) float32, metres along z; zero where empty


@dataclass(frozen=True)
class Moment:
    """What a camera sees at one moment of an exposure."""

    surface: np.ndarray  # (N, 3) float32 metres, the subject's vertices in the world
    camera: Camera


class Renderer:
    """Render one subject in any number of poses, on white or in a room, under one of LIGHTS."""

    def __init__(
        self, subject: PersonSurface, room: Room | None = None, light: str = "usual"
    ) -> None:
        import mitsuba as mi

        mi.set_variant(VARIANT)
        self._look, self._room, self._light = subject.look, room, LIGHTS[light]
        indirect = np.array(self._light.indirect)
        vertices, faces, material = subject.vertices, subject.faces, subject.material
        rest, tint = subject.vertices, subject.tint
        emission = indirect * np.array([subject.look.mean_color(p) for p in Material])
        if room is not None:  # its furniture follows the subject, in one mesh
            faces = np.concatenate([faces, room.faces + len(vertices)])
            numbers = (room.finish + PERSON_MATERIALS).astype(np.uint32)
            material = np.concatenate([material, numbers])
            rest = np.concatenate([rest, np.pad(room.uv, ((0, 0), (0, 1)))])
            tint = np.concatenate([tint, np.ones_like(room.vertices)])
            colors = [finish.mean_color() for finish in room.finishes]
            emission = np.concatenate([emission, indirect * np.array(colors)])
            self._finishes = mi.Float(np.ravel([f.row() for f in room.finishes]).astype("f4"))
            vertices = np.concatenate([vertices, room.vertices])
        self._faces, mesh = faces, mi.Mesh("subject", len(vertices), len(faces))
        params = mi.traverse(mesh)
        params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
        params["vertex_positions"] = mi.Float(vertices.ravel())
        params.update()
        self._scene = mi.load_dict({"type": "scene", "mesh": mesh})
        self._scene_params = mi.traverse(self._scene)
        self._material = mi.UInt32(material)
        self._rest = mi.Float(rest.ravel())
        self._tint = mi.Float(tint.ravel())
        self._corner = params["faces"]
        self._emission = mi.Float(emission.ravel().astype(np.float32))
        dr.eval(self._material, self._rest, self._tint, self._emission)

    def expose(
        self, moments: Sequence[Moment], samples: int, seed: int, shown: bool = True
    ) -> Rendering:
        """Render the subject as an exposure sees it.

        Args:
            moments: of the exposure, with equal shares; one for a shutter that does not blur.
            samples: rays per pixel and moment, a square number.
            seed: of all random numbers.
            shown: show the room, if there is one; otherwise its walls light a subject on white.
        """
        camera, shown = moments[0].camera, shown and self._room is not None
        shape = camera.height, camera.width
        total, count, room = (np.zeros((*shape, n)) for n in (7, 1, 6))
        fewer = max(1, round((samples / FEWER_SAMPLES) ** 0.5)) ** 2
        for k, moment in enumerate(moments):
            self._place(moment.surface, shown)
            window = window_of(moment.surface, moment.camera)
            parts = [window, *beside(window, *shape)] if shown else [window]
            for number, (left, top, width, height) in enumerate(parts):
                rays, person = (samples, True) if number == 0 else (fewer, False)
                part = moment.camera.cropped(left, top, width, height)
                values = self._trace(part, rays, seed + 7 * k + number, person, shown)
                values = values.reshape(height, width, rays, -1).astype(np.float64)
                at = (slice(top, top + height), slice(left, left + width))
                hit = values[..., HIT]
                if person:
                    count[at] += hit.sum(2)
                    total[at] += (values[..., OF_PERSON] * hit).sum(2)
                if shown:
                    room[at] += (values[..., OF_ROOM] * (1 - hit)).mean(2)
        mean, most = total / np.maximum(count, 1), samples * len(moments)
        mask = count / most
        color = mask * encode(mean[..., RADIANCE]) + (1 - mask)
        if shown:
            color = encode(total[..., RADIANCE] / most + smoothly_lit(room) / len(moments))
        normal = mean[..., NORMAL] @ camera.T_camera_world[:3, :3].T
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        normal = np.where(length > 1e-3, normal / np.maximum(length, 1e-3), 0)
        found = color, mask[..., 0], normal, mean[..., DEPTH]
        return Rendering(*(image.astype(np.float32) for image in found))

    def _place(self, surface: np.ndarray, shown: bool) -> None:
        """Move the subject's vertices (N, 3); furniture that is not shown shrinks to nothing."""
        import mitsuba as mi

        vertices = surface.astype(np.float32)
        if self._room is not None:
            vertices = np.concatenate([vertices, self._room.vertices * np.float32(shown)])
        (key,) = (k for k in self._scene_params.keys() if k.endswith("vertex_positions"))
        self._scene_params[key] = mi.Float(vertices.ravel())
        self._scene_params.update()
        normals = vertex_normals(vertices.astype(np.float64), self._faces)
        self._normals = mi.Float(normals.astype(np.float32).ravel())

    def _trace(
        self, camera: Camera, samples: int, seed: int, person: bool, shown: bool
    ) -> np.ndarray:
        """Trace all samples of a view, (H W S, 8): radiance, world normal, depth, hit the person.

        Without ``person`` no ray meets the person. Where the room is ``shown`` the others meet it,
        and the albedo follows, (H W S, 11).
        """
        import mitsuba as mi

        n = int(round(samples**0.5))
        total = camera.width * camera.height * samples
        lane = dr.arange(mi.UInt32, total)
        pixel = lane // dr.opaque(mi.UInt32, samples)
        sample = lane - pixel * dr.opaque(mi.UInt32, samples)
        random = mi.PCG32(size=total, initstate=dr.opaque(mi.UInt64, seed))
        stratum = Strata(random, pixel, sample, n)
        column = pixel % dr.opaque(mi.UInt32, camera.width)
        row = pixel // dr.opaque(mi.UInt32, camera.width)
        x = mi.Float(column) + (mi.Float(sample % n) + random.next_float32()) / n
        y = mi.Float(row) + (mi.Float(sample // n) + random.next_float32()) / n
        ray, per_depth = primary_rays(camera, x, y)
        at = self._scene.ray_intersect_preliminary(ray, coherent=True)
        t, hit = at.t, at.is_valid()
        material, rest, tint, n_shading = self._surface(at.prim_index, at.prim_uv, hit)
        color = albedo(self._look, material, rest) * tint if person else mi.Color3f(0)
        lit = hit
        if shown:
            t, hit, color, n_shading = self._in_room(ray, t, hit, material, rest, color, n_shading)
            lit = mi.Bool(True)
        start = ray(t) + n_shading * SECONDARY_RAY_OFFSET - ray.d * SECONDARY_RAY_OFFSET

        light = mi.Color3f(0)
        for source in self._light.lamps:
            light += self._direct(source, start, n_shading, stratum(), lit)
        light += dr.pi * self._ambient(start, n_shading, stratum(), lit)
        radiance = color * light * dr.inv_pi
        if self._room is not None:
            radiance *= mi.Color3f(*self._room.gain)
        values = [dr.select(lit, value, 0.0) for value in radiance]
        values += [dr.select(hit, value, 0.0) for value in (*n_shading, t / per_depth, 1.0)]
        values += [*color] if shown else []
        dr.eval(values)  # together, as one kernel
        return np.stack([value.numpy() for value in values], axis=-1)

    def _in_room(
        self, ray: Array, t: Array, hit: Array, material: Array, rest: Array, color: Array,
        normal: Array,
    ) -> tuple[Array, ...]:  # fmt: skip
        """Return distance, which rays hit the person, albedo and normal, walls included."""
        import mitsuba as mi

        far, side, u, v = self._room.exit(ray.o, ray.d)
        person = hit & (material < PERSON_MATERIALS)
        finish = dr.select(hit, dr.maximum(material, PERSON_MATERIALS) - PERSON_MATERIALS, side)
        u, v = dr.select(hit, rest.x, u), dr.select(hit, rest.y, v)
        axis = [dr.select(side // 2 == k, 1.0, 0.0) for k in range(3)]
        normal = dr.select(hit, normal, mi.Vector3f(*axis))
        away = ~person & (dr.dot(normal, ray.d) > 0)
        color = dr.select(person, color, finish_color(self._finishes, finish, u, v))
        return dr.select(hit, t, far), person, color, dr.select(away, -normal, normal)

    def _surface(self, triangle: Array, uv: Array, active: Array) -> tuple[Array, ...]:
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

    def _direct(self, source: AreaLight, x: Array, n: Array, uv: Array, active: Array) -> Array:
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

    def _ambient(self, x: Array, n: Array, uv: Array, active: Array) -> Array:
        """Return L of a cosine-distributed direction (eq. 3)."""
        import mitsuba as mi

        direction = mi.Frame3f(n).to_world(mi.warp.square_to_cosine_hemisphere(uv))
        pi = self._scene.ray_intersect_preliminary(mi.Ray3f(x, direction), active=active)
        blocked = pi.is_valid()
        material = dr.gather(mi.UInt32, self._material, pi.prim_index, active & blocked)
        emission = dr.gather(mi.Color3f, self._emission, material, active & blocked)
        if self._room is None:
            ground, sky = mi.Color3f(*self._light.ground), mi.Color3f(*self._light.sky)
            return dr.select(blocked, emission, dr.lerp(ground, sky, 0.5 + 0.5 * direction.y))
        # Every direction that nothing blocks gives the mean of all, which leaves little to chance.
        below, above = (mi.Color3f(c.tolist()) for c in self._room.ambient)
        return dr.select(blocked, emission, dr.lerp(below, above, 0.5 + n.y / 3))


def faces_seen(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> np.ndarray:
    """Return which face of a mesh the centre of each pixel shows, (H, W) int64, -1: none.

    ``vertices`` (N, 3) are metres in the world, ``faces`` (F, 3) integers.
    """
    import mitsuba as mi

    mi.set_variant(VARIANT)
    mesh = mi.Mesh("mesh", len(vertices), len(faces))
    params = mi.traverse(mesh)
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    params["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
    params.update()
    pixel = dr.arange(mi.UInt32, camera.width * camera.height)
    column, row = mi.Float(pixel % camera.width), mi.Float(pixel // camera.width)
    ray, _ = primary_rays(camera, column + 0.5, row + 0.5)
    at = mi.load_dict({"type": "scene", "mesh": mesh}).ray_intersect_preliminary(ray)
    face = np.where(at.is_valid().numpy(), at.prim_index.numpy().astype(np.int64), -1)
    return face.reshape(camera.height, camera.width)


def primary_rays(camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
    """Return rays through image points (pixels), and their length per metre of depth."""
    import mitsuba as mi

    number = lambda value: dr.opaque(mi.Float, value)
    x = (x - number(camera.cx)) / number(camera.fx)
    direction = mi.Vector3f(x, (y - number(camera.cy)) / number(camera.fy), 1.0)
    per_depth = dr.norm(direction)
    T_world_camera = np.linalg.inv(camera.T_camera_world)
    R = [[number(float(T_world_camera[i, j])) for j in range(3)] for i in range(3)]
    turned = (r[0] * direction.x + r[1] * direction.y + r[2] * direction.z for r in R)
    eye = mi.Point3f(*(number(float(c)) for c in T_world_camera[:3, 3]))
    return mi.Ray3f(eye, mi.Vector3f(*turned) / per_depth), per_depth


class Strata:
    """Stratified points of the unit square: one per cell of an n × n grid over a pixel's samples.

    The cells are permuted for each call and pixel, so that dimensions do not correlate.
    """

    def __init__(self, random: Array, pixel: Array, sample: Array, n: int) -> None:
        self._random, self._pixel, self._sample, self._n = random, pixel, sample, n
        self._calls = 0

    def __call__(self) -> Array:
        import mitsuba as mi

        n = self._n
        self._calls += 1
        key = mi.sample_tea_32(self._pixel, self._calls, 3)[0]
        cell = mi.permute_kensler(self._sample, n * n, key)
        u = (mi.Float(cell % n) + self._random.next_float32()) / n
        v = (mi.Float(cell // n) + self._random.next_float32()) / n
        return mi.Point2f(u, v)


def window_of(vertices: np.ndarray, camera: Camera) -> tuple[int, int, int, int]:
    """Return the window of the picture that holds the vertices: left, top, width, height."""
    uv = camera.project(vertices.astype(np.float64))
    size = np.array([camera.width, camera.height])
    lo = np.clip(np.floor(uv.min(0)) - 1, 0, size - 1).astype(int)
    hi = np.clip(np.ceil(uv.max(0)) + 1, lo + 1, size).astype(int)
    return int(lo[0]), int(lo[1]), int(hi[0] - lo[0]), int(hi[1] - lo[1])


def beside(
    window: tuple[int, int, int, int], height: int, width: int
) -> list[tuple[int, int, int, int]]:
    """Return the parts of a picture around a window, each left, top, width, height."""
    left, top, wide, high = window
    right, bottom = left + wide, top + high
    parts = [
        (0, 0, width, top), (0, bottom, width, height - bottom),
        (0, top, left, high), (right, top, width - right, high),
    ]  # fmt: skip
    return [part for part in parts if min(part[2:]) > 0]


def encode(linear_rgb: np.ndarray) -> np.ndarray:
    """Encode linear light as sRGB in [0, 1], float32."""
    return encoded(np.clip(linear_rgb, 0, 1)).astype(np.float32)
