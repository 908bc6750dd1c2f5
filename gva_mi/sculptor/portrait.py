"""Pictures of a bare body, to judge it by eye: a turntable, and a sheet of poses, hands and faces.

Smooth-shaded, path-traced by Mitsuba under a key light, a rim light and a sky. Eyes are told by
their skinning weights, so that any body in SMPL-X's format has them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.puppet import EXPRESSIONS
from gva_mi.body.smplx import BodyModel

VARIANT = "llvm_ad_rgb"
SKIN, SCLERA, IRIS = (0.66, 0.42, 0.32), (0.80, 0.79, 0.77), (0.05, 0.035, 0.025)  # linear albedo
BACKGROUND = 0.85  # linear
IRIS_ANGLE = 0.42  # radians from the direction of sight

Rotation = tuple[float, float, float]  # axis-angle, radians

A_POSE: Mapping[str, Rotation] = {"left_shoulder": (0, 0, -0.85), "right_shoulder": (0, 0, 0.85)}


@dataclass(frozen=True)
class View:
    """Where a picture is taken from."""

    target: tuple[float, float, float]  # metres, world
    height: float  # metres that the picture spans at the target
    azimuth: float = 0.0  # radians around the vertical; 0 is in front
    elevation: float = 0.06  # radians above the horizon


@dataclass(frozen=True)
class Figure:
    """One picture of the sheet."""

    rotations: Mapping[str, Rotation]  # by joint
    view: View | None = None  # None shows the whole body
    azimuth: float = 0.0  # of a whole body's view, radians
    expression: str = ""  # of puppet.EXPRESSIONS
    amount: float = 1.0  # of the expression


def turntable(body: BodyModel, *, views: int = 8, size: int = 400, samples: int = 64) -> np.ndarray:
    """A body in the A-pose from all around, (size, W, 3) in [0, 1], sRGB."""
    draw, width = _Painter(body), round(0.72 * size)
    vertices = draw.posed(Figure(A_POSE)).numpy()
    middle = (vertices.min(0) + vertices.max(0)) / 2
    radius = np.linalg.norm((vertices - middle)[:, [0, 2]], axis=1).max()
    height = 1.10 * max(np.ptp(vertices[:, 1]), 2 * radius * size / width)  # one scale for all
    around = [View(tuple(middle.tolist()), height, 2 * np.pi * k / views) for k in range(views)]
    pictures = [draw(Figure(A_POSE, view), width, size, samples) for view in around]
    return np.concatenate(pictures, axis=1)


def sheet(body: BodyModel, *, size: int = 280, samples: int = 64) -> np.ndarray:
    """Poses of the whole body, hands and faces from close by, four in a row; (H, 4 size, 3)."""
    draw = _Painter(body)
    near = [*_hands(body), *_faces(body)]
    rows = [(BODIES[:4], 4 / 3), (BODIES[4:], 4 / 3)]
    rows += [(near[k : k + 4], 1) for k in range(0, len(near), 4)]
    return np.concatenate([
        np.concatenate([draw(f, size, round(size * tall), samples) for f in row], axis=1)
        for row, tall in rows
    ])  # fmt: skip


def _both(**left: Rotation) -> dict[str, Rotation]:
    """Rotations of left joints and their mirror images."""
    turned = {f"left_{name}": r for name, r in left.items()}
    return turned | {f"right_{name}": (r[0], -r[1], -r[2]) for name, r in left.items()}


def _fingers(curl: Mapping[str, float], thumb: tuple[Rotation, ...], side: str = "left") -> dict:
    """A hand from how far each finger curls (1: into the palm) and the thumb's three rotations."""
    sign = 1 if side == "left" else -1
    hand = {}
    for finger, amount in curl.items():
        for knuckle, angle in enumerate((1.35, 1.75, 1.15), start=1):
            hand[f"{side}_{finger}{knuckle}"] = (0, 0, -sign * amount * angle)
    for knuckle, (x, y, z) in enumerate(thumb, start=1):
        hand[f"{side}_thumb{knuckle}"] = (x, sign * y, sign * z)
    return hand


_LONG = ("index", "middle", "ring", "pinky")
_REST_THUMB = ((0.1, 0.2, -0.1), (0, 0.1, 0), (0, 0.1, 0))
_FOLDED_THUMB = ((0.41, 0.27, -0.42), (0.16, 0.53, -0.10), (0.37, 1.12, -0.24))
FLAT = _fingers({}, ())
RELAXED = _fingers(dict(zip(_LONG, (0.20, 0.24, 0.28, 0.32), strict=True)), _REST_THUMB)
FIST = _fingers(dict.fromkeys(_LONG, 1.0), _FOLDED_THUMB)
POINT = _fingers({"index": 0.04, "middle": 1, "ring": 1, "pinky": 1}, _FOLDED_THUMB)
PINCH = _fingers(
    {"index": 0.52, "middle": 0.25, "ring": 0.18, "pinky": 0.12},
    ((0.75, 0.15, -0.30), (0, 0.25, -0.05), (0, 0.35, -0.05)),
)
FOUR = _fingers({}, _FOLDED_THUMB)
TWO = _fingers({"index": 0, "middle": 0, "ring": 1, "pinky": 1}, _FOLDED_THUMB)
TWO |= {"left_index1": (0, -0.18, 0), "left_middle1": (0, 0.14, 0)}
THUMB_UP = _fingers(
    dict.fromkeys(_LONG, 1.0), ((-0.16, -0.37, 0.12), (-0.10, -0.36, 0.06), (-0.06, -0.20, 0.04))
) | {"left_elbow": (-0.8, 0, 0), "left_wrist": (-0.7, 0, 0)}  # fmt: skip

BODIES = (
    Figure(A_POSE | RELAXED, azimuth=0.5),
    Figure(A_POSE | {"right_shoulder": (0, 0, 0.9), "right_elbow": (0, 1.9, 0.3),
                     "left_shoulder": (0, -0.9, 0.9), "left_elbow": (0, -0.6, 0.3)} | POINT),
    Figure(_both(shoulder=(0, -0.5, -0.95), elbow=(0, -1.75, 0.1)) | FIST
           | _fingers(dict.fromkeys(_LONG, 1.0), _FOLDED_THUMB, "right"), azimuth=-0.5),
    Figure(_both(hip=(-1.75, 0.2, 0.15), knee=(2.0, 0, 0), ankle=(-0.35, 0, 0),
                 shoulder=(0, -1.35, -0.1))
           | {"spine1": (0.25, 0, 0), "spine2": (0.2, 0, 0)}, azimuth=0.9),
    Figure({"left_hip": (-0.75, 0, 0), "left_knee": (0.35, 0, 0), "right_hip": (0.45, 0, 0),
            "right_knee": (0.75, 0, 0), "right_foot": (-0.4, 0, 0),
            "left_shoulder": (0.75, 0, -1.15), "left_elbow": (0, -1.0, 0),
            "right_shoulder": (-0.75, 0, 1.15), "right_elbow": (0, 1.0, 0)} | RELAXED, azimuth=1.2),
    Figure(_both(shoulder=(0, 0, 0.75), collar=(0, 0, 0.45), elbow=(0, -0.2, 0)), azimuth=2.7),
    Figure(A_POSE | {"pelvis": (0.7, 0, 0), "spine1": (0.45, 0, 0), "spine2": (0.35, 0, 0),
                     "left_hip": (-0.7, 0, 0), "right_hip": (-0.7, 0, 0),
                     "left_shoulder": (0, -1.4, -0.3), "right_shoulder": (0, 1.4, 0.3)},
           azimuth=1.4),
    Figure({"left_hip": (-1.5, 0, 0.2), "left_knee": (1.9, 0, 0), "spine2": (0, 0.3, 0),
            "left_shoulder": (0, -0.35, -1.2), "right_shoulder": (0, 0.3, 1.15),
            "left_elbow": (0, -2.2, 0.4), "right_elbow": (0, 2.2, -0.4),
            "neck": (0, 0.4, 0.1), "head": (0, 0.2, 0)}, azimuth=-0.4),
)  # fmt: skip


def _hands(body: BodyModel) -> list[Figure]:
    """Eight pictures of the left hand, which stays where it is in the T-pose."""
    rest = body.rest(Shape(body.v_template.new_zeros(1))).joints
    middle = rest[JOINTS.index("left_middle1")] - torch.tensor([0.005, 0.008, 0.0])
    from_ = lambda azimuth, elevation, up=0.0: View(
        (middle[0].item(), middle[1].item() + up, middle[2].item()), 0.24, azimuth, elevation
    )
    above, below, ahead = from_(0.1, 1.3), from_(0.35, -1.1), from_(0.9, 0.25)
    pairs = [
        (FLAT, above), (FOUR, below), (FIST, from_(1.2, 0.1)), (FIST, below),
        (POINT, ahead), (PINCH, ahead), (TWO, below), (THUMB_UP, from_(0.25, 0.1, 0.035)),
    ]  # fmt: skip
    return [Figure(hand, view) for hand, view in pairs]


def _faces(body: BodyModel) -> list[Figure]:
    """Eight pictures of the face, the head where it is in the T-pose."""
    rest = body.rest(Shape(body.v_template.new_zeros(1)))
    eyes = rest.joints[[JOINTS.index(f"{s}_eye_smplhf") for s in ("left", "right")]].mean(0)
    target = tuple((eyes - torch.tensor([0.0, 0.020, 0.04])).tolist())
    view = lambda azimuth: View(target, 0.29, azimuth, 0.05)
    aside = {"left_eye_smplhf": (0, 0.4, 0), "right_eye_smplhf": (0, 0.4, 0)}
    return [
        Figure({}, view(0.0)),
        Figure({}, view(0.7)),
        Figure({}, view(1.57)),
        Figure({"jaw": (0.38, 0, 0)}, view(0.5)),
        Figure({}, view(-0.4), expression="smile", amount=1.5),
        Figure({"jaw": (0.10, 0, 0)}, view(0.0), expression="brows up", amount=2.0),
        Figure({}, view(0.0), expression="blink"),
        Figure(aside, view(0.4), expression="lips pushed out"),
    ]


class _Painter:
    """Draws one body in any pose."""

    def __init__(self, body: BodyModel) -> None:
        import mitsuba as mi

        mi.set_variant(VARIANT)
        self._body = body
        self._color = _colors(body)
        self._shape = Shape(body.v_template.new_zeros(1))

    def __call__(self, figure: Figure, width: int, height: int, samples: int) -> np.ndarray:
        """One picture, (height, width, 3) in [0, 1], sRGB."""
        import mitsuba as mi

        vertices = self.posed(figure).numpy()
        view = _framed(vertices, figure, width / height)
        scene = mi.load_dict(_scene(self._mesh(vertices), view, width, height))
        image = mi.render(scene, spp=samples, seed=0)
        light, coverage = np.split(np.asarray(image), [3], axis=2)
        linear = mi.TensorXf(light + (1 - coverage) * BACKGROUND)
        bitmap = mi.Bitmap(linear).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True)
        return np.asarray(bitmap, dtype=np.float32) / 255

    def posed(self, figure: Figure) -> torch.Tensor:
        """The body's surface, (V, 3)."""
        zero = self._body.v_template.new_zeros
        rotations, expression = zero(1, len(JOINTS), 3), zero(1, self._body.num_expressions)
        for name, rotation in figure.rotations.items():
            rotations[0, JOINTS.index(name)] = torch.tensor(rotation)
        if figure.expression and self._body.num_expressions == len(EXPRESSIONS):
            expression[0, EXPRESSIONS.index(figure.expression)] = figure.amount
        pose = Pose.from_rotations(rotations, zero(1, 3), expression)
        return self._body(pose, self._shape).vertices[0]

    def _mesh(self, vertices: np.ndarray) -> object:
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


def _framed(vertices: np.ndarray, figure: Figure, aspect: float) -> View:
    """The figure's view; one of the whole body spans what there is of it, with a margin."""
    if figure.view is not None:
        return figure.view
    across = vertices @ _turned((1.0, 0.0, 0.0), figure.azimuth)
    height = max(np.ptp(vertices[:, 1]), np.ptp(across) / aspect)
    # The middle of what is seen: of the picture's width, of the height, and of the depth.
    ahead = vertices @ _turned((0.0, 0.0, 1.0), figure.azimuth)
    middle = [(v.min() + v.max()) / 2 for v in (across, vertices[:, 1], ahead)]
    target = _turned(middle, figure.azimuth)
    return View(tuple(target.tolist()), 1.10 * height, figure.azimuth)


def _scene(mesh: object, view: View, width: int, height: int) -> dict:
    import mitsuba as mi

    distance = 5.0 * view.height  # from afar, as a long lens shows it
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
            "fov": float(np.degrees(2 * np.arctan(0.5 / 5.0))), "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(
                (target + distance * np.array(away)).tolist(), target.tolist(), (0, 1, 0)
            ),
            "film": {"type": "hdrfilm", "width": width, "height": height,
                     "pixel_format": "rgba", "rfilter": {"type": "gaussian"}},
            "sampler": {"type": "independent"},
        },
        "body": mesh,
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.40}},
        "key": light(-1.6, 1.6, 1.8, 0.6, 13.0),
        "rim": light(1.9, 1.2, -1.4, 0.5, 9.0),
    }  # fmt: skip


def _turned(point: Sequence[float], azimuth: float) -> np.ndarray:
    """A point turned around the vertical."""
    x, y, z = point
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    return np.array([x * cosine + z * sine, y, z * cosine - x * sine])
