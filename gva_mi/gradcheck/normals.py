"""Check the derivatives of ``mesh_normals`` with respect to coordinates of the body's pose.

The built-in body fills a picture of 512 pixels. Its limbs are free, lie before the body, cross, or
intersect. One coordinate of the pose moves: a translation, a shoulder, an elbow, a finger.
``mesh_normals`` gives the derivative of the image along the vertices' motion. It is compared with
two references in float64 that share no code with the plugin:

1. ``scanlines.py`` for the mask's derivative and the normals' boundary term, ``moving_mesh.py`` for
   the normals' interior term. The terms are compared separately, because in their sum errors may
   cancel.
2. Each is compared for WEIGHTINGS linear functions of the image, smooth random fields. The error is
   ``|found - truth| / |truth|``, norms over these functions. A single function may be small by
   chance, where opposite sides of a limb cancel.

Differences of whole images are no reference here: contours of neighbouring fingers nearly coincide
in the picture, and even a step of 0.1 pixels is too long.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.gradcheck.engine import Comparison
from gva_mi.gradcheck.moving_mesh import MovingMesh, PinholeLens, interior
from gva_mi.gradcheck.scanlines import boundary
from gva_mi.mesh.mesh_scene import load_plugins, sensor_of
from gva_mi.splat import Camera, look_at

# See check_normals. Chosen: a person fills the picture; the references' own errors are far below
# TOLERANCES.
SIZE, SPP, LINES, POINTS = 512, 16, 16000, 89
# Greatest relative errors. Chosen: two to four times the largest in docs/plugins.md.
TOLERANCES = {"mask": 0.03, "interior": 0.05, "boundary": 0.05}
WEIGHTINGS = 16  # linear functions of the image; chosen: enough that not all are small at once
# Standard deviation of their blur, as a share of the image's width. Chosen: about a limb's width.
BLUR_WIDTH = 0.025
# Step of the differences, metres or radians. Chosen: rounding leaves 1e-16 / 1e-5.
DIFFERENCE_STEP = 1e-5
POSES: dict[str, dict[str, tuple[float, float, float]]] = {  # axis-angles of joints, radians
    "free": {
        "left_shoulder": (0, 0, -0.7), "left_elbow": (0, -0.5, 0),
        "right_shoulder": (0, 0, 0.7), "right_elbow": (0, 0.5, 0),
    },
    "occluding": {
        "left_shoulder": (0, -1.0, -1.0), "left_elbow": (0, -0.6, 0), "right_shoulder": (0, 0, 1.0),
    },
    "crossing": {
        "left_shoulder": (0, -1.2, -0.8), "left_elbow": (0, -0.7, 0),
        "right_shoulder": (0, 1.0, 0.9), "right_elbow": (0, 0.9, 0),
        "left_hip": (0, 0, -0.25), "right_hip": (-0.25, 0, 0.2),
    },
    "intersecting": {
        "left_shoulder": (0, 0, -1.45), "right_shoulder": (0, 0, 1.45),
    },
    # The thighs are mirror images: edges of one pass through edges of the other.
    "pressed": {
        "left_hip": (0, 0, -0.2), "right_hip": (0, 0, 0.2),
    },
}  # fmt: skip


class PoseCoordinate(NamedTuple):
    """One coordinate of one pose.

    Example:
        >>> str(PoseCoordinate("free", "left_elbow", 1))
        'free, left_elbow y'
    """

    pose: str  # in POSES
    moves: str  # ``transl``, or the joint that turns
    axis: int  # along or about which axis

    def __str__(self) -> str:
        return f"{self.pose}, {self.moves} {'xyz'[self.axis]}"


_MOVES = {
    "free": "transl x, transl y, transl z, left_shoulder z, left_elbow y, left_thumb1 z, "
    "left_index1 z, left_pinky1 z",
    "occluding": "left_shoulder y, left_elbow y, left_index1 z",
    "crossing": "left_shoulder y, right_elbow y, left_hip z",
    "intersecting": "left_shoulder z",
    "pressed": "left_hip z",
}
COORDINATES = tuple(
    PoseCoordinate(pose, move[:-2], "xyz".index(move[-1]))
    for pose, moves in _MOVES.items()
    for move in moves.split(", ")
)


def check_normals(
    count: int, size: int = SIZE, spp: int = SPP, lines: int = LINES, points: int = POINTS
) -> Iterator[list[Comparison]]:
    """Yield the comparisons of the first coordinates in COORDINATES, one coordinate at a time.

    Args:
        count: coordinates to compare.
        size: width and height of the picture, pixels.
        spp: rays per pixel of the plugin's derivative.
        lines: rows and columns of the reference for the boundary term, over the part that moves.
        points: points on each face, of the reference for the interior term.

    Example:
        >>> rows = next(check_normals(1, size=32, spp=4, lines=400, points=8))  # far too small
        >>> for row in rows:
        ...     print(f"{row.name}: {row.error:.1f}")
        free, transl x: mask: 0.1
        free, transl x: interior: 0.0
        free, transl x: boundary: 0.1
    """
    load_plugins()
    body = load_body(dtype=torch.float64)
    T_camera_world = look_at((0.25, 0.1, 2.4), (0, -0.05, 0))
    camera = Camera(1.15 * size, 1.15 * size, size / 2, size / 2, T_camera_world, size, size)
    weightings = _weightings(size)
    for coordinate in COORDINATES[:count]:
        vertices = _posed(body, coordinate)
        motion = (vertices(DIFFERENCE_STEP) - vertices(-DIFFERENCE_STEP)) / (2 * DIFFERENCE_STEP)
        mesh = MovingMesh(vertices(0.0), body.faces.numpy(), motion)
        inside, jumps = _by_plugin(mesh, camera, spp)
        lens = PinholeLens(camera)
        true_inside = interior(mesh, lens, DIFFERENCE_STEP, points)
        true_jumps = boundary(mesh, lens, lines, np.random.default_rng(0))
        rows = []
        for name, found, truth, channels in (
            ("mask", jumps, true_jumps, slice(3, 4)),
            ("interior", inside, true_inside, slice(0, 3)),
            ("boundary", jumps, true_jumps, slice(0, 3)),
        ):
            a, b = (
                torch.tensor([(x[..., channels] * w[..., channels]).sum() for w in weightings])
                for x in (found, truth)
            )
            if b.any():  # the mask does not change where a finger lies before the body
                title = f"{coordinate}: {name}"
                rows.append(Comparison.of("tangent f32", title, a, b, TOLERANCES[name]))
        yield rows


def _by_plugin(mesh: MovingMesh, camera: Camera, spp: int) -> tuple[np.ndarray, np.ndarray]:
    """Return interior and boundary derivative of ``mesh_normals``' image, (H, W, 4) each."""
    import mitsuba as mi

    sensor = mi.load_dict(sensor_of(camera))
    view = mi.load_dict({"type": "mesh_normals"}).view(mesh.scene(), sensor, spp)
    parts = view.tangent_parts(mi.Vector3f(mesh.motion.T.astype(np.float32)))
    return tuple(np.array(part).astype(np.float64) for part in parts)


def _posed(body: BodyModel, coordinate: PoseCoordinate) -> Callable[[float], np.ndarray]:
    """Return the vertices (V, 3) as a function of the moving coordinate, metres or radians."""
    rotations = torch.zeros(1, 55, 3, dtype=torch.float64)
    for joint, angles in POSES[coordinate.pose].items():
        rotations[0, JOINTS.index(joint)] = torch.tensor(angles, dtype=torch.float64)
    zero = lambda *size: torch.zeros(*size, dtype=torch.float64)

    def vertices(x: float) -> np.ndarray:
        turned, transl = rotations.clone(), zero(1, 3)
        if coordinate.moves == "transl":
            transl[0, coordinate.axis] += x
        else:
            turned[0, JOINTS.index(coordinate.moves), coordinate.axis] += x
        moved = Pose(turned, transl, zero(1, 10))
        return body(moved, Shape(zero(10))).vertices[0].numpy()

    return vertices


def _weightings(size: int) -> list[np.ndarray]:
    """Make smooth random images (H, W, 4) with structures about as wide as a limb."""
    generator = np.random.default_rng(0)
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
    blur = np.exp(-2 * (np.pi * BLUR_WIDTH * size * frequency) ** 2)[..., None]
    noise = [generator.normal(size=(size, size, 4)) for _ in range(WEIGHTINGS)]
    blurred = (np.fft.rfft2(field, axes=(0, 1)) * blur for field in noise)
    smooth = (np.fft.irfft2(field, (size, size), (0, 1)) for field in blurred)
    return [field / field.std() for field in smooth]
