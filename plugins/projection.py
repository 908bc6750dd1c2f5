"""From a Mitsuba sensor to a projection matrix, and back from pixels to rays.

With the world point ``x`` and homogeneous ``x̃ = (x, 1)``, a sensor is a matrix ``P`` (3, 4) with
rows ``P_0, P_1, P_2``, and with ``A`` its left 3x3 part:

1. depth  ``w = P_2 x̃``,
2. pixel  ``q_i = (P_i x̃) / w``,
3. ray    ``o + t A^{-1} (q, 1)`` from the eye ``o`` through ``q``; ``t`` is then the depth ``w``,
4. motion ``∂q_i/∂x = (P_i - q_i P_2)[:3] / w``.

Pixels are those of the film's crop window: its left upper corner is (0, 0), pixel centres at +0.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass(frozen=True)
class Projection:
    """A pinhole view of the world on W x H pixels."""

    rows: tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]  # of A
    offset: mi.Vector3f  # last column of P
    pixel_to_ray: mi.Matrix3f  # A^-1
    eye: mi.Point3f  # o, world
    camera_world: mi.Matrix3f  # rotation from world to camera, OpenCV axes
    width: int
    height: int

    @staticmethod
    def of(sensor: mi.Sensor, pixel_aspect: float = 1.0) -> Projection:
        """The projection of a ``perspective`` sensor.

        Args:
            sensor: a Mitsuba sensor of type ``perspective``.
            pixel_aspect: width of a pixel over its height, ``f_y / f_x``. Mitsuba's pixels are
                square; another aspect stretches the image in y about the principal point.

        Raises:
            ValueError: for another kind of sensor.
        """
        if sensor.class_name() != "PerspectiveCamera":
            raise ValueError(
                f"mesh_normals: sensor must be 'perspective', got {sensor.class_name()}"
            )
        width, height = (int(x) for x in sensor.film().crop_size())
        with dr.suspend_grad():
            to_world = sensor.world_transform().matrix
            rotation = mi.Matrix3f([[to_world[i, j] for j in range(3)] for i in range(3)])
            eye = mi.Point3f(to_world[0, 3], to_world[1, 3], to_world[2, 3])
            # Mitsuba's camera looks along +z with x to the left and y up.
            flip = mi.Matrix3f([[-1, 0, 0], [0, -1, 0], [0, 0, 1]])
            camera_world = flip @ rotation.T
            sample = (
                sensor.projection_transform().matrix
            )  # camera -> film in [0, 1]², depth in row 2
            film = mi.Matrix3f([[sample[i, j] for j in range(3)] for i in (0, 1, 3)])
            K = mi.Matrix3f([[width, 0, 0], [0, height, 0], [0, 0, 1]]) @ film @ flip
            K /= K[2, 2]
            size, parameters = sensor.film().size(), mi.traverse(sensor)
            K[0, 2] -= size[0] * parameters["principal_point_offset_x"]
            K[1, 2] -= size[1] * parameters["principal_point_offset_y"]
            K[1, 1] *= pixel_aspect
            A = K @ camera_world
            rows = tuple(mi.Vector3f(A[i, 0], A[i, 1], A[i, 2]) for i in range(3))
            offset = -(A @ mi.Vector3f(eye))
            inverse = camera_world.T @ dr.rcp(K)
            dr.make_opaque(rows, offset, inverse, eye, camera_world)
        return Projection(rows, offset, inverse, eye, camera_world, width, height)

    def pixel(self, x: mi.Point3f) -> tuple[mi.Point2f, mi.Float]:
        """Eq. 1, 2: where world points are seen, in pixels, and their depth."""
        w = dr.dot(self.rows[2], x) + self.offset.z
        u = dr.dot(self.rows[0], x) + self.offset.x
        v = dr.dot(self.rows[1], x) + self.offset.y
        return mi.Point2f(u, v) / w, w

    def ray(self, q: mi.Point2f) -> mi.Ray3f:
        """Eq. 3: rays through pixels, in the world; their parameter is the depth, not a length."""
        return mi.Ray3f(self.eye, self.pixel_to_ray @ mi.Vector3f(q.x, q.y, 1))

    def pull_back(self, m: mi.Vector2f, q: mi.Point2f, w: mi.Float) -> mi.Vector3f:
        """Eq. 4: the world vector ``(∂q/∂x)ᵀ m`` at a point seen in ``q`` at depth ``w``."""
        rows = self.rows
        return (m.x * (rows[0] - q.x * rows[2]) + m.y * (rows[1] - q.y * rows[2])) / w

    def is_inside(self, q: mi.Point2f) -> mi.Bool:
        """Whether a pixel position lies on the image."""
        return (q.x >= 0) & (q.y >= 0) & (q.x < self.width) & (q.y < self.height)

    def pixel_index(self, q: mi.Point2f) -> mi.UInt32:
        """Number of the pixel that holds a position on the image."""
        return mi.UInt32(q.y) * self.width + mi.UInt32(q.x)
