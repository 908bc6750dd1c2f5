"""Are the gradients that refine a pose right? The body's, against exact ones, joint by joint.

The puppet stands 512 pixels high in poses in which limbs are free, lie before the body, cross, or
are pressed into it or one another, and one coordinate of the pose moves: a translation, a shoulder,
an elbow, a finger. The gradient of ``mesh_normals`` by the vertices is pulled back to that
coordinate and compared with two twins that share no code with it, in float64:

1. the mask's gradient and the normals' boundary term with
   :class:`gva_mi_plugins.mesh_normals.twins.scanlines.Scanlines`, the normals' interior with
   :meth:`gva_mi_plugins.mesh_normals.twins.differences.Differences.interior`; each apart, for in their sum errors may
   cancel;
2. each for WEIGHTINGS linear functions of the image, smooth random fields: the figure is
   ``|gradients - truth| / |truth|``, vectors over these functions. One function alone may be small
   by chance, where opposite sides of a limb cancel.

Differences of whole images are no truth here: contours of neighbouring fingers all but coincide on
the picture. With a step of 0.1 pixels the mask's difference for an index finger is 12 % off, with
one of 0.05 pixels 0.2 %.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.errors import InputError
from gva_mi.mesh.mesh_scene import sensor_of
from gva_mi.splat import Camera, look_at

LIMITS = {"mask": 0.03, "interior": 0.05, "boundary": 0.05}  # relative errors
WEIGHTINGS = 16
WIDTH = 0.025  # standard deviation of their blur, as a share of the image's width
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
    # Both thighs are mirror images: every edge that passes through the other one meets an edge.
    "pressed": {
        "left_hip": (0, 0, -0.2), "right_hip": (0, 0, 0.2),
    },
}  # fmt: skip
CASES = (  # pose, what moves, along or about which axis
    ("free", "transl", 0), ("free", "transl", 1), ("free", "transl", 2),
    ("free", "left_shoulder", 2), ("free", "left_elbow", 1),
    ("free", "left_thumb1", 2), ("free", "left_index1", 2), ("free", "left_pinky1", 2),
    ("occluding", "left_shoulder", 1), ("occluding", "left_elbow", 1),
    ("occluding", "left_index1", 2),
    ("crossing", "left_shoulder", 1), ("crossing", "right_elbow", 1), ("crossing", "left_hip", 2),
    ("piercing", "left_shoulder", 2), ("pressed", "left_hip", 2),
)  # fmt: skip


@dataclass(frozen=True)
class GradientOptions:
    """How finely to compare."""

    size: int = 512  # pixels, width and height
    spp: int = 16  # rays for a pixel of the gradient that is examined
    lines: int = 16000  # across the rectangle that moves, for the true boundary term
    points: int = 89  # on each face, for the true interior
    count: int = len(CASES)  # how many of the cases, from the first

    def __post_init__(self) -> None:
        leasts = {"size": 32, "spp": 1, "lines": 1, "points": 1, "count": 1}
        for name, least in leasts.items():
            found = getattr(self, name)
            if found < least:
                raise InputError(f"gradcheck-normals: {name} must be at least {least}, got {found}")
        if self.count > len(CASES):
            raise InputError(
                f"gradcheck-normals: count must be at most {len(CASES)}, got {self.count}"
            )


@dataclass(frozen=True)
class Row:
    """Relative errors of one case."""

    pose: str
    moves: str
    mask: float | None  # None where the mask does not change
    interior: float
    boundary: float

    @property
    def passed(self) -> bool:
        """Whether each error is within its limit."""
        return all(
            error is None or error <= LIMITS[name]
            for name, error in zip(LIMITS, (self.mask, self.interior, self.boundary), strict=True)
        )


def table(rows: Sequence[Row]) -> str:
    """For a person to read."""
    percent = lambda x: f"{'-':>10}" if x is None else f"{x:10.2%}"
    lines = [f"{'pose':12}{'moves':18}{'mask':>10}{'interior':>10}{'boundary':>10}"]
    for row in rows:
        errors = "".join(percent(x) for x in (row.mask, row.interior, row.boundary))
        lines.append(f"{row.pose:12}{row.moves:18}{errors}{'' if row.passed else '  too much'}")
    return "\n".join(lines)


def check_gradients(options: GradientOptions) -> Iterator[Row]:
    """One row after the other, in the order of CASES."""
    import gva_mi_plugins
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    gva_mi_plugins.register()
    body = load_body(dtype=torch.float64)
    size = options.size
    focal = 1.15 * size
    camera = Camera(
        focal, focal, size / 2, size / 2, look_at((0.25, 0.1, 2.4), (0, -0.05, 0)), size, size
    )
    weightings = _weightings(size)
    for pose, moves, axis in CASES[: options.count]:
        yield _row(body, camera, options, weightings, pose, moves, axis)


def _row(
    body: BodyModel,
    camera: Camera,
    options: GradientOptions,
    weightings: list[np.ndarray],
    pose: str,
    moves: str,
    axis: int,
) -> Row:
    import mitsuba as mi
    from gva_mi_plugins.mesh_normals.twins.differences import Differences
    from gva_mi_plugins.mesh_normals.twins.moving_mesh import MovingMesh
    from gva_mi_plugins.mesh_normals.twins.scanlines import Scanlines

    vertices = _posed(body, pose, moves, axis)
    tiny = 1e-5
    motion = (vertices(tiny) - vertices(-tiny)) / (2 * tiny)
    mesh = MovingMesh(vertices(0.0), body.faces.numpy(), motion)
    sensor = mi.load_dict(sensor_of(camera))
    jumps = Scanlines([mesh], sensor).boundary(options.lines, np.random.default_rng(0))
    inside = Differences([mesh], sensor).interior(tiny, options.points)
    truth = {"mask": jumps, "interior": inside, "boundary": jumps}

    shape = mi.Mesh("body", len(mesh.vertices), len(mesh.faces))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(mesh.vertices.ravel().astype(np.float32))
    parameters["faces"] = mi.UInt32(mesh.faces.ravel().astype(np.uint32))
    parameters.update()
    scene = mi.load_dict({"type": "scene", "body": shape})
    view = mi.load_dict({"type": "mesh_normals"}).view(scene, sensor, options.spp)
    inside, jumps = view.tangent_parts(mi.Vector3f(motion.T.astype(np.float32)))
    jumps = np.array(jumps)
    ours = {"mask": jumps, "interior": np.array(inside), "boundary": jumps}

    def error(name: str) -> float:
        channels = slice(3, 4) if name == "mask" else slice(0, 3)
        a, b = (
            np.array([(x[..., channels] * w[..., channels]).sum() for w in weightings])
            for x in (ours[name].astype(np.float64), truth[name])
        )
        return float(np.linalg.norm(a - b) / np.linalg.norm(b))

    hidden = not truth["mask"][..., 3].any()
    label = f"{moves} {'xyz'[axis]}"
    return Row(pose, label, None if hidden else error("mask"), error("interior"), error("boundary"))


def _posed(body: BodyModel, pose: str, moves: str, axis: int) -> Callable[[float], np.ndarray]:
    """The body's vertices (V, 3) by the coordinate that moves, metres or radians."""
    rotations = torch.zeros(1, 55, 3, dtype=torch.float64)
    for joint, angles in POSES[pose].items():
        rotations[0, JOINTS.index(joint)] = torch.tensor(angles, dtype=torch.float64)
    zero = lambda *size: torch.zeros(*size, dtype=torch.float64)

    def vertices(x: float) -> np.ndarray:
        turned, transl = rotations.clone(), zero(1, 3)
        if moves == "transl":
            transl[0, axis] += x
        else:
            turned[0, JOINTS.index(moves), axis] += x
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
