"""Pictures of a bare body, to judge it by eye: a turntable, and a sheet of poses, hands and faces.

Smooth-shaded, path-traced by Mitsuba under a key light, a rim light and a sky. Which vertices are
eyes is read from the skinning weights, so that any body in SMPL-X's format has them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.puppet import EXPRESSIONS
from gva_mi.body.smplx import BodyModel
from gva_mi.sculptor.portrait_poses import A_POSE, BODIES, Portrait, Viewpoint, faces, hands

VARIANT = "llvm_ad_rgb"
SKIN, SCLERA, IRIS = (0.66, 0.42, 0.32), (0.80, 0.79, 0.77), (0.05, 0.035, 0.025)  # linear albedo
BACKGROUND = 0.85  # linear
IRIS_ANGLE = 0.42  # radians from the direction of sight
SPREAD = 0.5  # pixels, standard deviation of a sample's
DISTANCE = 5.0  # of the camera, in heights of its view: far away, as a long lens shows it


def turntable(body: BodyModel, *, views: int = 8, size: int = 400, samples: int = 64) -> np.ndarray:
    """A body in the A-pose from all around, (size, W, 3) in [0, 1], sRGB."""
    draw, width = _PortraitRenderer(body), round(0.72 * size)
    vertices = draw.posed(Portrait(A_POSE)).numpy()
    middle = (vertices.min(0) + vertices.max(0)) / 2
    radius = np.linalg.norm((vertices - middle)[:, [0, 2]], axis=1).max()
    height = 1.10 * max(np.ptp(vertices[:, 1]), 2 * radius * size / width)  # one scale for all
    around = [
        Viewpoint(tuple(middle.tolist()), height, 2 * np.pi * k / views) for k in range(views)
    ]
    pictures = [draw(Portrait(A_POSE, view), width, size, samples) for view in around]
    return np.concatenate(pictures, axis=1)


def pose_sheet(body: BodyModel, *, size: int = 280, samples: int = 64) -> np.ndarray:
    """Poses of the whole body, hands and faces from close by, four in a row; (H, 4 size, 3)."""
    draw = _PortraitRenderer(body)
    near = [*hands(body), *faces(body)]
    rows = [(BODIES[:4], 4 / 3), (BODIES[4:], 4 / 3)]
    rows += [(near[k : k + 4], 1) for k in range(0, len(near), 4)]
    return np.concatenate([
        np.concatenate([draw(p, size, round(size * tall), samples) for p in row], axis=1)
        for row, tall in rows
    ])  # fmt: skip


class _PortraitRenderer:
    """Draws one body in any pose."""

    def __init__(self, body: BodyModel) -> None:
        import mitsuba as mi

        mi.set_variant(VARIANT)
        self._body = body
        self._color = _colors(body)
        self._shape = Shape(body.v_template.new_zeros(1))

    def __call__(self, portrait: Portrait, width: int, height: int, samples: int) -> np.ndarray:
        """One picture, (height, width, 3) in [0, 1], sRGB."""
        import mitsuba as mi

        vertices = self.posed(portrait).numpy()
        view = _framed(vertices, portrait, width / height)
        scene = mi.load_dict(_scene(self._mesh(vertices), view, width, height))
        light, coverage = _traced(scene, width, height, samples)
        linear = mi.TensorXf(light + (1 - coverage) * BACKGROUND)
        bitmap = mi.Bitmap(linear).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True)
        return np.asarray(bitmap, dtype=np.float32) / 255

    def posed(self, portrait: Portrait) -> torch.Tensor:
        """The body's surface, (V, 3)."""
        zero = self._body.v_template.new_zeros
        rotations, expression = zero(1, len(JOINTS), 3), zero(1, self._body.num_expressions)
        for name, rotation in portrait.rotations.items():
            rotations[0, JOINTS.index(name)] = torch.tensor(rotation)
        if portrait.expression and self._body.num_expressions == len(EXPRESSIONS):
            expression[0, EXPRESSIONS.index(portrait.expression)] = portrait.amount
        pose = Pose(rotations, zero(1, 3), expression)
        return self._body(pose, self._shape).vertices[0]

    def _mesh(self, vertices: np.ndarray) -> object:
        """Vertices (V, 3) as Mitsuba's mesh, with the colours of skin and eyes."""
        import mitsuba as mi

        faces = self._body.faces.numpy()
        properties = mi.Properties()
        color = {"type": "mesh_attribute", "name": "vertex_color"}
        properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": color})
        mesh = mi.Mesh("body", len(vertices), len(faces), properties, has_vertex_normals=True)
        mesh.add_attribute("vertex_color", 3, self._color.ravel())
        parameters = mi.traverse(mesh)
        parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
        parameters["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
        parameters.update()
        return mesh


def _colors(body: BodyModel) -> np.ndarray:
    """Albedo of each vertex, (V, 3) linear."""
    rest = body.rest(Shape(body.v_template.new_zeros(1)))
    color = np.tile(np.float32(SKIN), (len(rest.vertices), 1))
    for side in ("left", "right"):
        joint = JOINTS.index(f"{side}_eye_smplhf")
        ball = (body.weights[:, joint] > 0.5).numpy()
        sight = (rest.vertices - rest.joints[joint]).numpy()
        angle = np.arctan2(np.linalg.norm(sight[:, :2], axis=1), sight[:, 2])
        color[ball] = SCLERA
        color[ball & (angle < IRIS_ANGLE)] = IRIS
    return color


def _framed(vertices: np.ndarray, portrait: Portrait, aspect: float) -> Viewpoint:
    """Where a portrait is seen from; by default so that the whole body fits, with a margin."""
    if portrait.view is not None:
        return portrait.view
    across = vertices @ _turned((1.0, 0.0, 0.0), portrait.azimuth)
    height = max(np.ptp(vertices[:, 1]), np.ptp(across) / aspect)
    # The middle of what is seen: of the picture's width, of the height, and of the depth.
    ahead = vertices @ _turned((0.0, 0.0, 1.0), portrait.azimuth)
    middle = [(v.min() + v.max()) / 2 for v in (across, vertices[:, 1], ahead)]
    target = _turned(middle, portrait.azimuth)
    return Viewpoint(tuple(target.tolist()), 1.10 * height, portrait.azimuth)


def _scene(mesh: object, view: Viewpoint, width: int, height: int) -> dict:
    """Camera, lights and body as Mitsuba's dictionary."""
    import mitsuba as mi

    distance = DISTANCE * view.height
    flat = np.cos(view.elevation)
    away = [np.sin(view.azimuth) * flat, np.sin(view.elevation), np.cos(view.azimuth) * flat]
    target = np.array(view.target)
    light = lambda side, up, ahead, size, radiance: {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at(
            (target + view.height * _turned((side, up, ahead), view.azimuth)).tolist(),
            target.tolist(), (0.0, 1.0, 0.01),
        ) @ mi.ScalarTransform4f().scale(float(size * view.height)),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
    }  # fmt: skip
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3, "hide_emitters": True},
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(0.5 / DISTANCE))), "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(
                (target + distance * np.array(away)).tolist(), target.tolist(), (0, 1, 0)
            ),
            "film": {"type": "hdrfilm", "width": width, "height": height},
            "sampler": {"type": "independent"},
        },
        "body": mesh,
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.40}},
        "key": light(-1.6, 1.6, 1.8, 0.6, 13.0),
        "rim": light(1.9, 1.2, -1.4, 0.5, 9.0),
    }  # fmt: skip


def _traced(scene: object, width: int, height: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Light (height, width, 3), linear, and coverage (height, width, 1).

    Samples are added up in a fixed order, pixel by pixel, and then spread by a Gaussian, as a film
    does; but a film lets threads add theirs as they come, and rounds otherwise each time.
    """
    import drjit as dr
    import mitsuba as mi
    from scipy.ndimage import gaussian_filter

    sensor, count = scene.sensors()[0], width * height * samples
    sampler = sensor.sampler()
    sampler.seed(0, count)
    pixel = dr.arange(mi.UInt32, count) // samples
    corner = mi.Point2f(mi.Float(pixel % width), mi.Float(pixel // width))
    at = (corner + sampler.next_2d()) / mi.Point2f(width, height)
    ray, _ = sensor.sample_ray(0.0, 0.5, at, mi.Point2f(0.5))
    light, hit, _ = scene.integrator().sample(scene, sampler, ray)
    channels = [dr.select(hit, light[k], 0.0) for k in range(3)] + [dr.select(hit, 1.0, 0.0)]
    means = [np.asarray(dr.block_sum(c, samples)) / samples for c in channels]
    image = np.stack(means, axis=1).reshape(height, width, 4).astype(np.float32)
    image = gaussian_filter(image, (SPREAD, SPREAD, 0))
    return image[..., :3], image[..., 3:]


def _turned(point: Sequence[float], azimuth: float) -> np.ndarray:
    """A point turned around the vertical."""
    x, y, z = point
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    return np.array([x * cosine + z * sine, y, z * cosine - x * sine])
