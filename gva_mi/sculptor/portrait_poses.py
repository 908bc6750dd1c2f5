"""What the sheet of portraits shows: poses of the whole body, hands, faces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch

from gva_mi.body.gestures import GESTURES, AxisAngle, hand_rotations
from gva_mi.body.pose import JOINTS, Shape
from gva_mi.body.smplx import BodyModel

A_POSE: Mapping[str, AxisAngle] = {"left_shoulder": (0, 0, -0.85), "right_shoulder": (0, 0, 0.85)}


@dataclass(frozen=True)
class Viewpoint:
    """Where a picture is taken from."""

    target: tuple[float, float, float]  # metres, world
    height: float  # metres that the picture spans at the target
    azimuth: float = 0.0  # radians around the vertical; 0 is in front
    elevation: float = 0.06  # radians above the horizon


@dataclass(frozen=True)
class Portrait:
    """One picture: a pose, an expression, and where they are seen from."""

    rotations: Mapping[str, AxisAngle]  # by joint
    view: Viewpoint | None = None  # None shows the whole body
    azimuth: float = 0.0  # of a view of the whole body, radians
    expression: str = ""  # of puppet.EXPRESSIONS
    amount: float = 1.0  # of the expression


def _both(**left: AxisAngle) -> dict[str, AxisAngle]:
    """Rotations of left joints and their mirror images."""
    turned = {f"left_{name}": r for name, r in left.items()}
    return turned | {f"right_{name}": (r[0], -r[1], -r[2]) for name, r in left.items()}


def _left(gesture: str, **changes: object) -> dict[str, AxisAngle]:
    """The left hand in a gesture, some of whose fields are changed."""
    return hand_rotations(replace(GESTURES[gesture], **changes), "left")


FLAT: Mapping[str, AxisAngle] = {}
RELAXED = _left("rest", curl=(0.20, 0.24, 0.28, 0.32))
FIST = _left("fist")
POINT = _left("point", curl=(0.04, 1.0, 1.0, 1.0))
PINCH = _left("pinch", spread=0.0)
FOUR = _left("four", curl=(0.0, 0.0, 0.0, 0.0), spread=0.0)
TWO = _left("two", curl=(0.0, 0.0, 1.0, 1.0), spread=0.0)
TWO |= {"left_index1": (0, -0.18, 0), "left_middle1": (0, 0.14, 0)}
THUMB_UP = _left("thumb") | {"left_elbow": (-0.8, 0, 0), "left_wrist": (-0.7, 0, 0)}

BODIES = (
    Portrait(A_POSE | RELAXED, azimuth=0.5),
    Portrait(A_POSE | {"right_shoulder": (0, 0, 0.9), "right_elbow": (0, 1.9, 0.3),
                     "left_shoulder": (0, -0.9, 0.9), "left_elbow": (0, -0.6, 0.3)} | POINT),
    Portrait(_both(shoulder=(0, -0.5, -0.95), elbow=(0, -1.75, 0.1)) | FIST
           | hand_rotations(GESTURES["fist"], "right"), azimuth=-0.5),
    Portrait(_both(hip=(-1.75, 0.2, 0.15), knee=(2.0, 0, 0), ankle=(-0.35, 0, 0),
                 shoulder=(0, -1.35, -0.1))
           | {"spine1": (0.25, 0, 0), "spine2": (0.2, 0, 0)}, azimuth=0.9),
    Portrait({"left_hip": (-0.75, 0, 0), "left_knee": (0.35, 0, 0), "right_hip": (0.45, 0, 0),
            "right_knee": (0.75, 0, 0), "right_foot": (-0.4, 0, 0),
            "left_shoulder": (0.75, 0, -1.15), "left_elbow": (0, -1.0, 0),
            "right_shoulder": (-0.75, 0, 1.15), "right_elbow": (0, 1.0, 0)} | RELAXED, azimuth=1.2),
    Portrait(_both(shoulder=(0, 0, 0.75), collar=(0, 0, 0.45), elbow=(0, -0.2, 0)), azimuth=2.7),
    Portrait(A_POSE | {"pelvis": (0.7, 0, 0), "spine1": (0.45, 0, 0), "spine2": (0.35, 0, 0),
                     "left_hip": (-0.7, 0, 0), "right_hip": (-0.7, 0, 0),
                     "left_shoulder": (0, -1.4, -0.3), "right_shoulder": (0, 1.4, 0.3)},
           azimuth=1.4),
    Portrait({"left_hip": (-1.5, 0, 0.2), "left_knee": (1.9, 0, 0), "spine2": (0, 0.3, 0),
            "left_shoulder": (0, -0.35, -1.2), "right_shoulder": (0, 0.3, 1.15),
            "left_elbow": (0, -2.2, 0.4), "right_elbow": (0, 2.2, -0.4),
            "neck": (0, 0.4, 0.1), "head": (0, 0.2, 0)}, azimuth=-0.4),
)  # fmt: skip


def hands(body: BodyModel) -> list[Portrait]:
    """Eight pictures of the left hand, which stays where it is in the T-pose."""
    rest = body.rest(Shape(body.v_template.new_zeros(1))).joints
    middle = rest[JOINTS.index("left_middle1")] - torch.tensor([0.005, 0.008, 0.0])
    seen = lambda azimuth, elevation, up=0.0: Viewpoint(
        (middle[0].item(), middle[1].item() + up, middle[2].item()), 0.24, azimuth, elevation
    )
    above, below, ahead = seen(0.1, 1.3), seen(0.35, -1.1), seen(0.9, 0.25)
    pairs = [
        (FLAT, above), (FOUR, below), (FIST, seen(1.2, 0.1)), (FIST, below),
        (POINT, ahead), (PINCH, ahead), (TWO, below), (THUMB_UP, seen(0.25, 0.1, 0.035)),
    ]  # fmt: skip
    return [Portrait(hand, view) for hand, view in pairs]


def faces(body: BodyModel) -> list[Portrait]:
    """Eight pictures of the face, the head where it is in the T-pose."""
    rest = body.rest(Shape(body.v_template.new_zeros(1)))
    eyes = rest.joints[[JOINTS.index(f"{s}_eye_smplhf") for s in ("left", "right")]].mean(0)
    target = tuple((eyes - torch.tensor([0.0, 0.020, 0.04])).tolist())
    view = lambda azimuth: Viewpoint(target, 0.29, azimuth, 0.05)
    aside = {"left_eye_smplhf": (0, 0.4, 0), "right_eye_smplhf": (0, 0.4, 0)}
    return [
        Portrait({}, view(0.0)),
        Portrait({}, view(0.7)),
        Portrait({}, view(1.57)),
        Portrait({"jaw": (0.38, 0, 0)}, view(0.5)),
        Portrait({}, view(-0.4), expression="smile", amount=1.5),
        Portrait({"jaw": (0.10, 0, 0)}, view(0.0), expression="brows up", amount=2.0),
        Portrait({}, view(0.0), expression="blink"),
        Portrait(aside, view(0.4), expression="lips pushed out"),
    ]
