"""Pictures of any body without clothes: a turntable, and a sheet of poses, hands and faces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from gva_mi.body.built_in import EXPRESSIONS
from gva_mi.body.gestures import GESTURES, AxisAngle, put_hand
from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, SIDES, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera, look_at
from gva_mi.synthetic.cameras import camera_around
from gva_mi.synthetic.look import Fabric, linear
from gva_mi.synthetic.motion.actions import ACTIONS, POSES
from gva_mi.synthetic.people import STUDY
from gva_mi.synthetic.render import Renderer
from gva_mi.synthetic.subject import draw_subject

DISTANCE = 5.0  # distance of the camera, in heights of a close-up
SHOWN = 0.72  # width over height of a picture of the whole body
A_POSE: Mapping[str, AxisAngle] = {"left_shoulder": (0, 0, -0.85), "right_shoulder": (0, 0, 0.85)}
WHOLE = {  # actions, and the azimuth of their view
    "squat": 0.9, "step left": 1.2, "drink": 0.3, "reach": -0.5, "arms up": 2.7, "lunge": 1.2,
    "bow": 1.4,
}  # fmt: skip
HANDS = (  # gesture; azimuth and elevation of its view
    ("open", 0.1, 1.3), ("four", 0.35, -1.1), ("fist", 1.2, 0.1), ("fist", 0.35, -1.1),
    ("point", 0.9, 0.25), ("pinch", 0.9, 0.25), ("two", 0.35, -1.1), ("thumb", 0.1, 1.3),
)  # fmt: skip
_ASIDE = {"left_eye_smplhf": (0, 0.4, 0), "right_eye_smplhf": (0, 0.4, 0)}
FACES = (  # rotations, azimuth of the view, expression and its amount
    ({}, 0.0, "", 1.0), ({}, 0.7, "", 1.0), ({}, 1.57, "", 1.0),
    ({"jaw": (0.38, 0, 0)}, 0.5, "", 1.0), ({}, -0.4, "smile", 1.5),
    ({"jaw": (0.10, 0, 0)}, 0.0, "brows up", 2.0), ({}, 0.0, "blink", 1.0),
    (_ASIDE, 0.4, "lips pushed out", 1.0),
)  # fmt: skip
_GREY = (linear(96, 100, 106),) * 3
_PERSON = replace(STUDY["bruno"], betas=(0.0,), top=Fabric("smooth", _GREY, 1.0))


@dataclass(frozen=True)
class Portrait:
    """A pose with an expression, and its view; without a target, the whole body is shown."""

    rotations: Mapping[str, AxisAngle]  # by joint
    target: np.ndarray | None = None  # (3,) centre of a close-up, metres
    height: float = 1.0  # metres that a close-up spans
    azimuth: float = 0.0  # radians around the vertical; 0 is in front
    elevation: float = 0.0  # of a close-up, radians above the horizon
    expression: str = ""  # one of EXPRESSIONS
    amount: float = 1.0  # of the expression


def turntable(body: BodyModel, *, views: int = 8, size: int = 400, samples: int = 64) -> np.ndarray:
    """Render a body in the A-pose from all sides, (size, W, 3) in [0, 1], sRGB."""
    turns = [Portrait(A_POSE, azimuth=2 * np.pi * k / views) for k in range(views)]
    return _PortraitRenderer(body).row(turns, size, samples)


def pose_sheet(body: BodyModel, *, size: int = 280, samples: int = 64) -> np.ndarray:
    """Render eight poses, hands and faces, each in a row, (H, W, 3) in [0, 1], sRGB."""
    joints = body.rest(Shape(body.v_template.new_zeros(1))).joints.double().numpy()
    at = joints[JOINTS.index("left_middle1")] - (0.005, 0.008, 0)
    eyes = joints[[JOINTS.index(f"{side}_eye_smplhf") for side in SIDES]]
    face = eyes.mean(0) - (0, 0.020, 0.04)
    whole = [Portrait(A_POSE, azimuth=0.5)]
    for name, azimuth in WHOLE.items():
        action = (ACTIONS | POSES)[name]
        hands = _hand_rotations(action.left, "left") | _hand_rotations(action.right, "right")
        whole.append(Portrait(A_POSE | action.joints | hands, azimuth=azimuth))
    hands = [Portrait(_hand_rotations(name, "left"), at, 0.24, *view) for name, *view in HANDS]
    faces = [Portrait(A_POSE | turned, face, 0.29, view, 0.05, *e) for turned, view, *e in FACES]
    render = _PortraitRenderer(body)
    rows = [render.row(whole, round(size / SHOWN), samples)]
    rows += [render.row(portraits, size, samples) for portraits in (hands, faces)]
    return np.concatenate([row[:, : rows[1].shape[1]] for row in rows])


class _PortraitRenderer:
    """Render one body in any pose, under light from the direction of the view."""

    def __init__(self, body: BodyModel) -> None:
        self._body = body
        self._subject = draw_subject(body, _PERSON, clothes=False, hair=False)
        self._renderer = Renderer(self._subject)

    def row(self, portraits: list[Portrait], size: int, samples: int) -> np.ndarray:
        """Render pictures side by side, (size, W, 3)."""
        return np.concatenate([self._picture(p, size, samples) for p in portraits], axis=1)

    def _picture(self, portrait: Portrait, size: int, samples: int) -> np.ndarray:
        pose = Pose.rest(1, self._body.num_expressions)
        for name, rotation in portrait.rotations.items():
            pose.rotations[0, JOINTS.index(name)] = torch.tensor(rotation, dtype=torch.float32)
        if portrait.expression and self._body.num_expressions == len(EXPRESSIONS):
            pose.expression[0, EXPRESSIONS.index(portrait.expression)] = portrait.amount
        sine, cosine = np.sin(portrait.azimuth), np.cos(portrait.azimuth)
        R = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])  # turns the view to front
        surface = self._subject.skinned(self._body, pose)[0] @ R.T
        if portrait.target is None:
            color = self._renderer(surface, camera_around(surface, size), samples).color
            width = 2 * (round(SHOWN * size) // 2)
            return color[:, (size - width) // 2 :][:, :width]
        away = np.array([0, np.sin(portrait.elevation), np.cos(portrait.elevation)])
        target, centre, focal = R @ portrait.target, size / 2, DISTANCE * size
        T_camera_world = look_at(target + DISTANCE * portrait.height * away, target)
        camera = Camera(focal, focal, centre, centre, T_camera_world, size, size)
        return self._renderer(surface, camera, samples).color


def _hand_rotations(gesture: str, side: str) -> dict[str, AxisAngle]:
    """Return one of GESTURES on one ``side`` as rotations of its joints, by name."""
    rotations = np.zeros((1, len(JOINTS), 3))
    put_hand(rotations, side, GESTURES[gesture].values)
    hand = LEFT_HAND if side == "left" else RIGHT_HAND
    return {JOINTS[k]: tuple(rotations[0, k].tolist()) for k in range(hand.start, hand.stop)}
