"""The light of a scene on Gaussians, measured on their proxy by any integrator.

1. B_v, a_v = radiance and albedo that the sensor ``onto_surface`` sees at vertex v of the proxy
2. E_v = B_v / a_v                       a diffuse surface of albedo a shows a E: E is the light
3. S_v = E_u, u: the vertex of median brightness among v and those around it
4. S_g = Σ_v w_gv S_v                    w: shares of the vertices around Gaussian g

The same rays see B and a. So neither another part of the proxy nor a hole of it can make E large,
and E has a derivative by the proxy's albedo. Where nothing was hit, E is 0.

A path that finds a lamp by chance, through glass or a mirror, adds a value far above the mean:
a *firefly*. In a picture it is one pixel; here it would be a bright disc. A vertex in a fold of the
proxy is dark. Eq. 3 removes both, and keeps the edges of shadows. Twice as bright emitters
give twice the light.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.gaussian_splat.sensors import OntoSurface

NEIGHBOURS = 6  # vertices around a Gaussian, and around a vertex; chosen: one ring of a mesh
LEAST_ALBEDO = 1e-3  # below it a surface has no colour that light could be divided by; chosen


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
        A ball in front of a white sky, seen by two Gaussians: one on it and one a little above it.

        >>> ball = mi.load_dict({"type": "ply", "filename": "ball.ply"})  # doctest: +SKIP
        >>> scene = mi.load_dict({"type": "scene", "ball": ball, "sky": {"type": "constant"}})
        ... # doctest: +SKIP
        >>> light = ProxyLight.of_mesh(scene, ball)  # doctest: +SKIP
        >>> light.on_vertices(mi.load_dict({"type": "path"}), spp=64)  # doctest: +SKIP
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
        """Return S of eq. 3, (V, 3); attached to ``params`` as far as the integrator is."""
        surface = mi.load_dict({"type": "aov", "aovs": "albedo:albedo"})
        shown = self.sensor.render(integrator, spp, seed, params).array
        albedo = self.sensor.render(surface, spp, seed, params).array
        light = dr.select(
            albedo > LEAST_ALBEDO, shown / dr.maximum(albedo, LEAST_ALBEDO), mi.Float(0)
        )
        return self._without_specks(mi.TensorXf(light, (len(self.ring), 3)))

    def _without_specks(self, light: mi.TensorXf) -> mi.TensorXf:
        """Evaluate eq. 3 for values (V, 3) of vertices."""
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
