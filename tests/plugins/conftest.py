"""Small closed meshes with shared vertices, and scenes of them: the fixture ``scenes``."""

from dataclasses import dataclass
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest

from gva_mi.gradcheck.moving_mesh import MovingMesh
from gva_mi.mesh.mesh_scene import load_plugins


@pytest.fixture(scope="session")
def scenes():
    load_plugins()
    names = (load, moving, move, weights, weightings, mesh, camera, sphere, torus)
    return SimpleNamespace(**{f.__name__: f for f in names})


def sphere(rings=24, segments=40, radius=0.5, center=(0.0, 0.0, 0.0)):
    """A closed sphere whose poles are single vertices: vertices (V, 3) and faces (F, 3)."""
    theta = np.pi * np.arange(1, rings) / rings
    phi = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.sin(theta)[:, None] * np.cos(phi),
        np.broadcast_to(np.cos(theta)[:, None], (rings - 1, segments)),
        np.sin(theta)[:, None] * np.sin(phi)], axis=-1).reshape(-1, 3)  # fmt: skip
    top, bottom = len(ring), len(ring) + 1
    at = lambda i, j: i * segments + j % segments
    faces = []
    for j in range(segments):
        faces.append((top, at(0, j + 1), at(0, j)))
        faces.append((bottom, at(rings - 2, j), at(rings - 2, j + 1)))
        for i in range(rings - 2):
            a, b, c, d = at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)
            faces += [(a, b, d), (a, d, c)]
    vertices = np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]]) * radius + center
    return vertices, np.array(faces)


def torus(around=48, across=24, major=0.5, minor=0.16, tilt=0.7, center=(0.0, 0.0, 0.0)):
    """A closed torus, turned about x by ``tilt``: it occludes itself."""
    u = 2 * np.pi * np.arange(around)[:, None] / around
    v = 2 * np.pi * np.arange(across) / across
    r = major + minor * np.cos(v)
    grid = np.stack([r * np.cos(u), r * np.sin(u), minor * np.sin(v) + 0 * u], axis=-1)
    c, s = np.cos(tilt), np.sin(tilt)
    vertices = grid.reshape(-1, 3) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T + center
    at = lambda i, j: i % around * across + j % across
    faces = []
    for i in range(around):
        for j in range(across):
            a, b, c, d = at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)
            faces += [(a, b, d), (a, d, c)]
    return vertices, np.array(faces)


def mesh(name, vertices, faces, facets=False):
    properties = mi.Properties()
    properties["face_normals"] = facets
    result = mi.Mesh(name, len(vertices), len(faces), props=properties)
    parameters = mi.traverse(result)
    parameters["vertex_positions"] = mi.Float(np.ravel(vertices).astype(np.float32))
    parameters["faces"] = mi.UInt32(np.ravel(faces).astype(np.uint32))
    parameters.update()
    return result


def camera(size=48, kind="perspective", **film):
    """A sensor before the origin, three metres away."""
    to_world = mi.ScalarTransform4f().look_at([0.3, 0.4, 3.0], [0, 0, 0], [0, 1, 0])
    if kind == "perspective":
        lens = {"fov": 34.0, "to_world": to_world}
    else:  # its field is as wide as its transform scales it
        lens = {"to_world": to_world @ mi.ScalarTransform4f().scale([0.9, 0.9, 1])}
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, **film}
    sampler = {"type": "independent", "sample_count": 1}
    return mi.load_dict({"type": kind, **lens, "film": film, "sampler": sampler})


def half(part):
    """The mesh without the faces whose first corner lies to the right: an open one."""
    vertices, faces = part
    return vertices, faces[vertices[faces[:, 0], 0] < 0.1]


def mirrored(part):
    """The mesh on the other side of x = 0: every edge of either that crosses it meets an edge."""
    vertices, faces = part
    return vertices * [-1, 1, 1], faces[:, ::-1]


def fin(size=0.5, parts=8):
    """Three squares that share an edge: no manifold."""
    y = np.linspace(-size, size, parts + 1)
    line = lambda x, z: np.stack([np.full_like(y, x), y, np.full_like(y, z)], axis=1)
    columns, faces = [line(0.0, 0.0)], []
    for angle in (0.3, 2.4, 4.5):
        before = 0
        for r in size * np.arange(1, parts + 1) / parts:
            here = len(columns)
            columns.append(line(r * np.cos(angle), r * np.sin(angle)))
            for i in range(parts):
                a, b = before * len(y) + i, here * len(y) + i
                faces += [[a, b, a + 1], [b, b + 1, a + 1]]
            before = here
    return np.concatenate(columns) + [0.03, 0.02, 0], np.array(faces)  # off the pixels' borders


# name -> list of (vertices, faces, facets): outer contour, self-occlusion, one mesh before another,
# facets, meshes that intersect, a mesh pressed against its mirror image, an open mesh,
# three faces at an edge
SCENES = {
    "sphere": lambda: [(*sphere(), False)],
    "torus": lambda: [(*torus(), False)],
    "occluding": lambda: [
        (*sphere(radius=0.3, center=(0.0, 0.3, 0.8)), False),
        (*torus(center=(-0.1, 0, -0.3)), False),
    ],
    "facets": lambda: [(*torus(), True), (*sphere(5, 8, 0.25, (0.2, 0, 1.0)), True)],
    "intersecting": lambda: [
        (*torus(), False),
        (*sphere(radius=0.3, center=(0.35, 0.1, 0.15)), False),
    ],
    "mirrored": lambda: [
        (*sphere(radius=0.4, center=(0.3, 0.1, 0.0)), False),
        (*mirrored(sphere(radius=0.4, center=(0.3, 0.1, 0.0))), False),
    ],
    "open": lambda: [(*half(torus()), False)],
    "fin": lambda: [(*fin(), True)],
}


@dataclass(frozen=True)
class FacetedMesh(MovingMesh):
    """A moving mesh of which some faces have a normal of their own."""

    facets: np.ndarray  # (F,) bool

    def corner_normals(self, step):
        p = np.moveaxis(self.at(step)[self.faces], 1, 0)
        c = np.cross(p[1] - p[0], p[2] - p[0])[:, None]
        flat = c / np.linalg.norm(c, axis=2, keepdims=True)
        return np.where(self.facets[:, None, None], flat, super().corner_normals(step))


def moving(name):
    """A scene as one mesh, each part with a motion of its own: moved, turned, sheared."""
    ways = [([1.0, 0.5, 0.6], 0.7, 0.6), ([-0.6, 0.7, -0.5], 0.3, -0.5)]
    parts, count = [], 0
    for (vertices, faces, facets), (way, turn, shear) in zip(SCENES[name](), ways, strict=False):
        x, y, z = vertices.T
        motion = way + np.stack([turn * z + shear * y, x * y, shear * x * y - turn * x], axis=1)
        parts.append((vertices, faces + count, motion, np.full(len(faces), facets)))
        count += len(vertices)
    return FacetedMesh(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def load(name):
    """A scene, its traversed parameters and the parts it was made of."""
    parts = SCENES[name]()
    shapes = {f"m{k}": mesh(f"m{k}", *part) for k, part in enumerate(parts)}
    scene = mi.load_dict({"type": "scene", **shapes})
    return scene, mi.traverse(scene), parts


def move(parameters, vertices):
    for k, v in enumerate(vertices):
        parameters[f"m{k}.vertex_positions"] = mi.Float(np.ravel(v).astype(np.float32))
    parameters.update()


def weightings(size, channels=5, count=8):
    """Smooth random images (count, H, W, C): sums of waves."""
    generator = np.random.default_rng(0)
    y, x = np.mgrid[:size, :size] / size
    fx, fy, phase = generator.normal(size=(3, 6, count, 1, 1, channels)) * [[[[[[9]]]]]]
    waves = np.cos(fx * x[..., None] + fy * y[..., None] + phase)
    return waves.sum(0).astype(np.float32)


def weights(size, channels=(0, 1, 2, 3)):
    """A smooth image (H, W, 4) that weighs some channels; opposite sides do not cancel."""
    y, x = np.mgrid[:size, :size] / size - 0.5
    ramps = [x + 0.5 * y, y - 0.3 * x, 0.5 + x * y, 2 * x - y + 0.5]
    image = np.zeros((size, size, 4), np.float32)
    for c in channels:
        image[..., c] = 4 * ramps[c]
    return image
