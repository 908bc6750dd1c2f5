"""Projection matrix of a Mitsuba sensor, and rays through its pixels.

With the world point ``x`` and ``x̃ = (x, 1)``, a sensor is a matrix ``P`` (3, 4) with rows ``P_0,
P_1, P_2``:

1. scale  ``h = P_2 x̃``: the depth before a pinhole, 1 in an orthographic view,
2. pixel  ``q_i = (P_i x̃) / h``,
3. ray    the points that project to ``q`` are ``o(q) + w d(q)``, ``w`` their depth: the distance
   from the sensor's plane. A pinhole has one ``o`` and ``d = A^{-1} (q, 1)`` with ``A`` the left
   part of ``P``; an orthographic view has one ``d``, the optical axis,
4. motion ``∂q_i/∂x = (P_i - q_i P_2)[:3] / h``,
5. lines  a segment of the world appears as the line from ``a`` to ``b`` on the image; the share
   ``t`` of the line shows the share ``s = t h_a / (t h_a + (1 - t) h_b)`` of the segment,
6. pose   with ``T`` the sensor's ``to_world``, a point fixed to the sensor moves by ``dT T^{-1} v``
   with ``v = (x, 1)``, a direction with ``v = (n, 0)``. Gradients are with respect to the
   entries of ``T``; its last row is not used. They hold for any ``dT`` in an orthographic view. A
   pinhole sensor is rigid, so only gradients along rotations and translations have a meaning.

Pixels count from the upper left corner of the film's crop window; their centres lie at +0.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

LEVEL_STEP = 1e-6  # pixels: a segment that rises less along an axis counts as parallel to it
PINHOLE, PARALLEL = "PerspectiveCamera", "OrthographicCamera"


@dataclass(frozen=True)
class SensorProjection:
    """A view of the world on W x H pixels.

    Example:
        >>> film = {"type": "hdrfilm", "width": 16, "height": 16}
        >>> sensor = mi.load_dict({"type": "perspective", "fov": 90, "film": film})
        >>> view = SensorProjection.of(sensor)  # looks along +z, x to the left
        >>> view.pixel(mi.Point3f(1, 0, 4))
        ([[6, 8]], [4])
        >>> view.ray(mi.Point2f(6, 8)).d
        [[0.25, 0, 1]]
    """

    pinhole: bool  # else orthographic
    rows: tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]  # of P, without its last column
    offset: mi.Vector3f  # last column of P
    pixel_to_world: mi.Matrix3f  # A^-1; orthographic: its first columns are ∂o/∂q
    determinant: mi.Float  # |det| of the inverse of pixel_to_world
    eye: mi.Point3f  # o of a pinhole; orthographic: o of pixel (0, 0)
    axis: mi.Vector3f  # the unit vector along which depth grows, world
    axis_offset: mi.Float  # depth is axis · x + axis_offset
    camera_world: mi.Matrix3f  # rotation from world to camera, OpenCV axes
    to_world: mi.Matrix4f  # of the sensor, Mitsuba's axes
    near: mi.Float  # depth at which rays start
    reach: mi.Float  # depth from there to where they end
    size: mi.Point2f  # width and height in pixels; no constants: each would have its own kernels

    @staticmethod
    def of(sensor: mi.Sensor, pixel_aspect: float = 1.0) -> SensorProjection:
        """Make the projection of a sensor.

        Args:
            sensor: a Mitsuba sensor of type ``perspective`` or ``orthographic``.
            pixel_aspect: width of a pixel over its height, ``f_y / f_x``. Mitsuba's pixels are
                square; another aspect stretches the image in y about the principal point.

        Raises:
            ValueError: another kind of sensor.
        """
        kind = sensor.class_name()
        if kind not in (PINHOLE, PARALLEL):
            raise ValueError(
                f"mesh_normals: sensor must be 'perspective' or 'orthographic', got {kind}"
            )
        pinhole = kind == PINHOLE
        size = _size_of(sensor.film().crop_size())
        with dr.suspend_grad():
            to_world = mi.Matrix4f(sensor.world_transform().matrix)
            L = mi.Matrix3f([[to_world[i, j] for j in range(3)] for i in range(3)])
            origin = mi.Vector3f(to_world[0, 3], to_world[1, 3], to_world[2, 3])
            x, y, z = (mi.Vector3f(L[0, j], L[1, j], L[2, j]) for j in range(3))
            axis = z / dr.norm(z)
            axis_offset = -dr.dot(axis, origin)
            # Mitsuba's camera looks along +z with x to the left and y up.
            right, down = -x / dr.norm(x), -y / dr.norm(y)
            camera_world = mi.Matrix3f([list(right), list(down), list(axis)])

            K, shift = _camera_to_pixels(sensor, pixel_aspect)
            A = K @ dr.rcp(L)
            offset = shift - A @ origin
            rows = tuple(mi.Vector3f(A[i, 0], A[i, 1], A[i, 2]) for i in range(3))
            if pinhole:
                pixel_to_world, eye = dr.rcp(A), origin
            else:
                pixel_to_world = dr.rcp(mi.Matrix3f([list(rows[0]), list(rows[1]), list(axis)]))
                eye = pixel_to_world @ mi.Vector3f(-offset.x, -offset.y, -axis_offset)
            determinant = dr.rcp(dr.abs(dr.det(pixel_to_world)))
            near = mi.Float(sensor.near_clip()) * (1.0 if pinhole else dr.norm(z))
            reach = mi.Float(sensor.far_clip() - sensor.near_clip())
            dr.make_opaque(rows, offset, pixel_to_world, eye, axis, axis_offset)
            dr.make_opaque(camera_world, to_world, near, reach, determinant, size)
        return SensorProjection(
            pinhole=pinhole, rows=rows, offset=offset, pixel_to_world=pixel_to_world,
            determinant=determinant, eye=mi.Point3f(eye), axis=axis, axis_offset=axis_offset,
            camera_world=camera_world, to_world=to_world, near=near, reach=reach, size=size,
        )  # fmt: skip

    def depth(self, x: mi.Point3f) -> mi.Float:
        """Return the distances of world points from the sensor's plane."""
        return dr.dot(self.axis, x) + self.axis_offset

    def pixel(self, x: mi.Point3f) -> tuple[mi.Point2f, mi.Float]:
        """Project world points to pixels; return their scale ``h``, too (eq. 1, 2)."""
        h = dr.dot(self.rows[2], x) + self.offset.z
        u = dr.dot(self.rows[0], x) + self.offset.x
        v = dr.dot(self.rows[1], x) + self.offset.y
        return mi.Point2f(u, v) / h, h

    def toward(self, x: mi.Point3f) -> mi.Vector3f:
        """Return a vector along the ray that meets a world point, away from the sensor."""
        return x - self.eye if self.pinhole else self.axis

    def ray(self, q: mi.Point2f) -> mi.Ray3f:
        """Return the rays through pixels (eq. 3); a ray's parameter t is the depth ``near + t``."""
        if self.pinhole:
            o, d = self.eye, self.pixel_to_world @ mi.Vector3f(q.x, q.y, 1)
        else:
            o, d = self.eye + self.pixel_to_world @ mi.Vector3f(q.x, q.y, 0), self.axis
        ray = mi.Ray3f(mi.Point3f(o + self.near * d), mi.Vector3f(d))
        ray.maxt = self.reach
        return ray

    def sideways(self, m: mi.Vector2f) -> mi.Vector3f:
        """Return the motion of the ray's point at depth 1 for a step of the pixel."""
        return self.pixel_to_world @ mi.Vector3f(m.x, m.y, 0)

    def pull_back(self, m: mi.Vector2f, q: mi.Point2f, h: mi.Float) -> mi.Vector3f:
        """Return the world vector ``(∂q/∂x)ᵀ m`` (eq. 4) of a point at pixel ``q``, scale ``h``."""
        rows = self.rows
        return (m.x * (rows[0] - q.x * rows[2]) + m.y * (rows[1] - q.y * rows[2])) / h

    def carried(self, d_to_world: mi.Matrix4f, v: mi.Vector3f, w: int) -> mi.Vector3f:
        """Return the motion of points (w = 1) or directions (w = 0) fixed to the sensor, eq. 6."""
        move = d_to_world @ (dr.rcp(self.to_world) @ mi.Vector4f(*v, w))
        return mi.Vector3f(move.x, move.y, move.z)

    def carried_adjoint(self, grad: mi.Vector3f, v: mi.Vector3f, w: int) -> mi.Matrix4f:
        """Convert the gradient of the motions of eq. 6 to the gradient of ``T``."""
        y = dr.rcp(self.to_world) @ mi.Vector4f(*v, w)
        dr.eval(grad, y)
        return mi.Matrix4f([[dr.sum(g * entry) for entry in y] for g in grad] + [[0, 0, 0, 0]])

    def density(self, c: mi.Vector3f, corner: mi.Point3f, ray: mi.Ray3f) -> mi.Float:
        """Return one over the pixel area of a small parallelogram that a ray meets.

        ``c`` is the cross product of its sides, ``corner`` any point of its plane.
        """
        along = dr.dot(c, ray.d)
        h = dr.dot(c, mi.Vector3f(corner) - self.eye) / along if self.pinhole else mi.Float(1)
        return dr.square(h) / (self.determinant * dr.abs(along))

    def is_inside(self, q: mi.Point2f) -> mi.Bool:
        """Return whether a pixel position lies on the image."""
        return (q.x >= 0) & (q.y >= 0) & (q.x < self.size.x) & (q.y < self.size.y)

    def clip(self, a: mi.Point2f, b: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Return the shares of the line ``a`` to ``b`` at which it enters and leaves the image.

        A line beside the image does not enter it before it leaves: t0 ≥ t1.
        """
        t0, t1 = mi.Float(0), mi.Float(1)
        for k, size in enumerate(self.size):
            step = b[k] - a[k]
            at_low, at_high = -a[k] / step, (size - a[k]) / step
            level = dr.abs(step) < LEVEL_STEP
            outside = level & ((a[k] < 0) | (a[k] > size))
            t0 = dr.maximum(t0, dr.select(level, 0, dr.minimum(at_low, at_high)))
            t1 = dr.minimum(t1, dr.select(level, 1, dr.maximum(at_low, at_high)))
            t1 = dr.select(outside, 0, t1)
        return t0, t1


def _camera_to_pixels(sensor: mi.Sensor, pixel_aspect: float) -> tuple[mi.Matrix3f, mi.Vector3f]:
    """Return ``K`` and ``k`` of eq. 1 and 2 in the sensor's frame, with Mitsuba's axes.

    ``K y + k`` is ``(h q, h)`` of a point ``y``.
    """
    size, whole = _size_of(sensor.film().crop_size()), _size_of(sensor.film().size())
    film = sensor.projection_transform().matrix  # camera to film in [0, 1]², depth in row 2
    dr.make_opaque(size, whole, film)
    rows = [[size[i] * film[i, j] for j in range(4)] for i in range(2)]
    if sensor.class_name() == PINHOLE:
        parameters = mi.traverse(sensor)
        rows[0][2] -= whole[0] * parameters["principal_point_offset_x"]
        rows[1][2] -= whole[1] * parameters["principal_point_offset_y"]
    shift = mi.Vector3f(rows[0][3], rows[1][3], film[3, 3])
    rows[1][0], rows[1][1] = rows[1][0] * pixel_aspect, rows[1][1] * pixel_aspect
    return mi.Matrix3f([row[:3] for row in (*rows, film[3])]), shift


def _size_of(size: mi.ScalarVector2u) -> mi.Point2f:
    return mi.Point2f(int(size[0]), int(size[1]))


def share_on_segment(t: mi.Float, ha: mi.Float, hb: mi.Float) -> mi.Float:
    """Convert the share of a segment's image to the share of the segment (eq. 5).

    By Blinn, "Hyperbolic Interpolation", 1992.

    Example:
        The middle of the image lies on the nearer half.

        >>> share_on_segment(mi.Float(0.5), ha=mi.Float(1), hb=mi.Float(3))
        [0.25]
    """
    return t * ha / (t * ha + (1 - t) * hb)
