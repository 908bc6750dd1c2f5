"""Are the gradients that refine a pose right? They are compared with exact ones, joint by joint.

The puppet stands 512 pixels high in poses in which limbs are free, lie before the body, cross, or
are pressed into it or one another, and one coordinate of the pose moves: a translation, a shoulder,
an elbow, a finger. The derivative of the image by that coordinate, as ``mesh_normals`` gives it for
the vertices' motion, is compared with two twins that share no code with it, in float64
(``gva_mi_plugins.mesh_normals.twins``):

1. the mask's derivative and the normals' boundary term with ``Scanlines``, the normals' interior
   with ``Differences.interior``; each is compared apart, for in their sum errors may cancel;
2. each for WEIGHTINGS linear functions of the image, smooth random fields: the figure is
   ``|found - truth| / |truth|``, vectors over these functions. One function alone may be small
   by chance, where opposite sides of a limb cancel.

Differences of whole images are no truth here: contours of neighbouring fingers all but coincide on
the picture. With a step of 0.1 pixels the mask's difference for an index finger is 12 % off, with
one of 0.05 pixels 0.2 %.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.mesh.mesh_scene import load_plugins, scene_of
from gva_mi.mesh.sensor import sensor_of
from gva_mi.ranges import Within, require_ranges
from gva_mi.splat import Camera, look_at

if TYPE_CHECKING:
    import mitsuba as mi
    from gva_mi_plugins.mesh_normals.twins.moving_mesh import MovingMesh

LIMITS = {"mask": 0.03, "interior": 0.05, "boundary": 0.05}  # relative errors
WEIGHTINGS = 16
WIDTH = 0.025  # standard deviation of their blur, as a share of the image's width
TINY = 1e-5  # metres or radians: the step of differences
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
    "piercing": {
        "left_shoulder": (0, 0, -1.45), "right_shoulder": (0, 0, 1.45),
    },
    # The thighs are mirror images: where an edge of one passes through the other, it meets an edge.
    "pressed": {
        "left_hip": (0, 0, -0.2), "right_hip": (0, 0, 0.2),
    },
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One coordinate of one pose."""

    pose: str  # in POSES
    moves: str  # ``transl``, or the joint that turns
    axis: int  # along or about which axis

    @property
    def label(self) -> str:
        """What moves, and its axis."""
        return f"{self.moves} {'xyz'[self.axis]}"


CASES = (
    Case("free", "transl", 0),
    Case("free", "transl", 1),
    Case("free", "transl", 2),
    Case("free", "left_shoulder", 2),
    Case("free", "left_elbow", 1),
    Case("free", "left_thumb1", 2),
    Case("free", "left_index1", 2),
    Case("free", "left_pinky1", 2),
    Case("occluding", "left_shoulder", 1),
    Case("occluding", "left_elbow", 1),
    Case("occluding", "left_index1", 2),
    Case("crossing", "left_shoulder", 1),
    Case("crossing", "right_elbow", 1),
    Case("crossing", "left_hip", 2),
    Case("piercing", "left_shoulder", 2),
    Case("pressed", "left_hip", 2),
)


@dataclass(frozen=True)
class GradientOptions:
    """How finely to compare."""

    size: Annotated[int, Within(32, 4096)] = 512  # pixels, width and height
    spp: Annotated[int, Within(1, 4096)] = 16  # rays for a pixel of the gradient that is examined
    # Across the rectangle that moves, for the true boundary term.
    lines: Annotated[int, Within(1, 1_000_000)] = 16000
    # On each face, for the true interior.
    points: Annotated[int, Within(1, 10_000)] = 89
    count: Annotated[int, Within(1, len(CASES))] = len(CASES)  # cases, from the first

    def __post_init__(self) -> None:
        require_ranges("gradcheck-normals", self)


@dataclass(frozen=True)
class GradientErrors:
    """Relative errors of one case."""

    pose: str
    moves: str
    mask: float | None  # None where the mask does not change
    interior: float
    boundary: float

    @property
    def passed(self) -> bool:
        """Whether each error is within its limit."""
        errors = {name: getattr(self, name) for name in LIMITS}
        return all(error is None or error <= LIMITS[name] for name, error in errors.items())


def table(rows: Sequence[GradientErrors]) -> str:
    """For a person to read."""
    percent = lambda x: f"{'-':>10}" if x is None else f"{x:10.2%}"
    lines = [f"{'pose':12}{'moves':18}{'mask':>10}{'interior':>10}{'boundary':>10}"]
    for row in rows:
        errors = "".join(percent(x) for x in (row.mask, row.interior, row.boundary))
        lines.append(f"{row.pose:12}{row.moves:18}{errors}{'' if row.passed else '  too much'}")
    return "\n".join(lines)


def check_gradients(options: GradientOptions) -> Iterator[GradientErrors]:
    """The errors of one case after the other, in the order of CASES."""
    load_plugins()
    from gva_mi_plugins.mesh_normals.twins.moving_mesh import MovingMesh

    body = load_body(dtype=torch.float64)
    size = options.size
    focal = 1.15 * size
    camera = Camera(
        focal, focal, size / 2, size / 2, look_at((0.25, 0.1, 2.4), (0, -0.05, 0)), size, size
    )
    weightings = _weightings(size)
    for case in CASES[: options.count]:
        vertices = _posed(body, case)
        motion = (vertices(TINY) - vertices(-TINY)) / (2 * TINY)
        mesh = MovingMesh(vertices(0.0), body.faces.numpy(), motion)
        yield _compare(case, mesh, camera, options, weightings)


@dataclass(frozen=True)
class _Derivative:
    """How an image changes as one coordinate moves; its two terms apart, (H, W, C >= 4)."""

    interior: np.ndarray
    boundary: np.ndarray


def _compare(
    case: Case,
    mesh: MovingMesh,
    camera: Camera,
    options: GradientOptions,
    weightings: list[np.ndarray],
) -> GradientErrors:
    """The relative errors of the plugin's derivative, as functions of the image see them."""
    import mitsuba as mi

    sensor = mi.load_dict(sensor_of(camera))
    found, truth = _found(mesh, sensor, options), _true(mesh, sensor, options)
    normals, mask = slice(0, 3), slice(3, 4)

    def error(found: np.ndarray, truth: np.ndarray, channels: slice) -> float:
        a, b = (
            np.array([(x[..., channels] * w[..., channels]).sum() for w in weightings])
            for x in (found, truth)
        )
        return float(np.linalg.norm(a - b) / np.linalg.norm(b))

    changes = truth.boundary[..., mask].any()
    return GradientErrors(
        case.pose,
        case.label,
        mask=error(found.boundary, truth.boundary, mask) if changes else None,
        interior=error(found.interior, truth.interior, normals),
        boundary=error(found.boundary, truth.boundary, normals),
    )


def _true(mesh: MovingMesh, sensor: mi.Sensor, options: GradientOptions) -> _Derivative:
    """The derivative by the twins."""
    from gva_mi_plugins.mesh_normals.twins.differences import Differences
    from gva_mi_plugins.mesh_normals.twins.scanlines import Scanlines

    boundary = Scanlines([mesh], sensor).boundary(options.lines, np.random.default_rng(0))
    return _Derivative(Differences([mesh], sensor).interior(TINY, options.points), boundary)


def _found(mesh: MovingMesh, sensor: mi.Sensor, options: GradientOptions) -> _Derivative:
    """The derivative by the plugin."""
    import mitsuba as mi

    vertices = torch.from_numpy(mesh.vertices.astype(np.float32))
    scene = scene_of(torch.from_numpy(mesh.faces), vertices)
    view = mi.load_dict({"type": "mesh_normals"}).view(scene, sensor, options.spp)
    parts = view.tangent_parts(mi.Vector3f(mesh.motion.T.astype(np.float32)))
    return _Derivative(*(np.array(part).astype(np.float64) for part in parts))


def _posed(body: BodyModel, case: Case) -> Callable[[float], np.ndarray]:
    """The body's vertices (V, 3) by the coordinate that moves, metres or radians."""
    rotations = torch.zeros(1, 55, 3, dtype=torch.float64)
    for joint, angles in POSES[case.pose].items():
        rotations[0, JOINTS.index(joint)] = torch.tensor(angles, dtype=torch.float64)
    zero = lambda *size: torch.zeros(*size, dtype=torch.float64)

    def vertices(x: float) -> np.ndarray:
        turned, transl = rotations.clone(), zero(1, 3)
        if case.moves == "transl":
            transl[0, case.axis] += x
        else:
            turned[0, JOINTS.index(case.moves), case.axis] += x
        moved = Pose(turned, transl, zero(1, 10))
        return body(moved, Shape(zero(10))).vertices[0].numpy()

    return vertices


def _weightings(size: int) -> list[np.ndarray]:
    """Smooth random images (H, W, 4), of structures about as wide as a limb."""
    generator = np.random.default_rng(0)
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
    blur = np.exp(-2 * (np.pi * WIDTH * size * frequency) ** 2)[..., None]
    noise = [generator.normal(size=(size, size, 4)) for _ in range(WEIGHTINGS)]
    smooth = [
        np.fft.irfft2(np.fft.rfft2(n, axes=(0, 1)) * blur, (size, size), (0, 1)) for n in noise
    ]
    return [field / field.std() for field in smooth]
