"""A person who was rendered once: the picture, the mask and where the joints are."""

from dataclasses import dataclass

import numpy as np
import pytest


@dataclass(frozen=True)
class RenderedPerson:
    """The built-in body with both palms to the camera, the arms to the sides and down."""

    picture: np.ndarray  # (600, 480, 3) 8-bit, on white
    mask: np.ndarray  # (600, 480) in [0, 1]
    joints: dict[str, np.ndarray]  # (2,) pixels

    def on(self, picture, left, channels=(0, 1, 2)):
        """Put the person into a picture, its left border at ``left``, with swapped channels."""
        picture = picture.copy()
        low, high = max(0, left), min(picture.shape[1], left + self.mask.shape[1])
        part = slice(low - left, max(low, high) - left)
        inside = self.mask[:, part, None]
        color = 255 - (255 - self.picture[:, part].astype(float)) / np.maximum(inside, 1e-3)
        behind = picture[:, low : max(low, high)]
        mixed = inside * color.clip(0, 255)[..., list(channels)] + (1 - inside) * behind
        picture[:, low : max(low, high)] = mixed.round().astype(np.uint8)
        return picture


@pytest.fixture(scope="session")
def rendered_person(built_in_body):
    pytest.importorskip("mitsuba")
    from gva_mi.body.pose import JOINTS, Pose
    from gva_mi.splat import Camera, look_at
    from gva_mi.synthetic.person.identity import SyntheticPerson
    from gva_mi.synthetic.person.surface import draw_surface
    from gva_mi.synthetic.pictures.render import Moment, Renderer

    drawn = SyntheticPerson.draw(101, built_in_body.num_betas)
    person = draw_surface(built_in_body, drawn, bare=True)
    pose = Pose.rest(1)
    turns = {
        "left_shoulder": (0, 0, -0.7), "right_shoulder": (0, 0, 0.7), "left_elbow": (-1.4, 0, 0),
        "right_elbow": (-1.4, 0, 0), "right_hip": (-0.4, 0, 0), "right_knee": (0.6, 0, 0),
    }  # fmt: skip
    for name, turn in turns.items():
        pose.rotations[0, JOINTS.index(name)] = pose.rotations.new_tensor(turn)
    vertices = person.skinned(built_in_body, pose)[0]
    camera = Camera(1000, 1000, 240, 330, look_at((0, 0.1, 4.2), (0, -0.2, 0)), 480, 600)
    seen = Renderer(person).expose([Moment(vertices, camera)], 4, 0)
    joints = built_in_body(pose, person.shape).joints[0].numpy()
    picture = (255 * seen.color).round().astype(np.uint8)
    places = dict(zip(JOINTS, camera.project(joints), strict=True))
    return RenderedPerson(picture, seen.mask, places)
