"""A film in numbers: landmarks projected from known poses before a camera that looks down."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.data.landmarks import Landmarks
from gva_mi.pose.film.rig import LandmarkRig
from gva_mi.pose.stature import Stature
from gva_mi.splat import Camera, look_at

SIZE, FOCAL, FPS = (360, 640), 600.0, 10.0


@dataclass(frozen=True)
class KnownFilm:
    """Landmarks, and what they were made from."""

    landmarks: Landmarks
    pose: Pose
    shape: Shape
    height: float
    camera: Camera


def moving(frames):
    """Poses in which the person turns, waves and bends the knees, feet near the ground."""
    pose = Pose.rest(frames)
    t = torch.linspace(0, 1, frames)

    def bend(joint, axis, values):
        pose.rotations[:, JOINTS.index(joint), axis] = values

    bend("pelvis", 1, 0.9 * torch.sin(3 * t))
    bend("left_shoulder", 2, -0.9 + 0.5 * torch.sin(5 * t))
    bend("right_shoulder", 2, 0.9 + 0.4 * torch.sin(4 * t))
    bend("left_elbow", 1, -0.9 - 0.5 * torch.sin(4 * t))
    bend("right_elbow", 1, 0.7 + 0.4 * torch.cos(6 * t))
    squat = 0.3 + 0.25 * torch.sin(6 * t)
    for side in ("left", "right"):
        bend(f"{side}_hip", 0, -squat)
        bend(f"{side}_knee", 0, 2 * squat)
        bend(f"{side}_ankle", 0, -squat)
        for finger in ("index", "middle", "ring", "pinky"):
            for k in (1, 2, 3):
                bend(f"{side}_{finger}{k}", 2, (-0.4 if side == "left" else 0.4) * (1 + t))
    return pose


def film_of(body, pose, shape, camera):
    """Project every landmark of a posed body; the metres are exact, too."""
    rig = LandmarkRig.of(body)
    places = rig.places(body(pose, shape).T_world_rest, shape.betas).double().numpy()
    T = camera.T_camera_world
    metric = places @ T[:3, :3].T
    hips = metric[:, [rig.names.index(f"{side}_hip") for side in ("left", "right")]]
    ones = np.ones(places.shape[:2])
    landmarks = Landmarks(
        rig.names, camera.project(places), ones, 0 * ones, metric - hips.mean(1, keepdims=True)
    )
    height = float(Stature.of(body).height(shape))
    return KnownFilm(landmarks, pose, shape, height, camera)


@pytest.fixture(scope="session")
def known_film(built_in_body):
    """Twelve frames; the camera looks 20 degrees down."""
    pose, shape = moving(12), Shape(torch.tensor([0.5, 0, 0.5, 0.5]))
    lowest = built_in_body(pose, shape).vertices[..., 1].amin(1)
    pose.transl[:, 1] -= lowest  # the soles stand
    centre, down = np.array([0.0, 0.9, 0]), np.radians(20)
    eye = centre + 3.2 * np.array([0, np.sin(down), np.cos(down)])
    camera = Camera(FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2, look_at(eye, centre), *SIZE)
    return film_of(built_in_body, pose, shape, camera)


def without(landmarks, frames, prefix=""):
    """Remove what was found in some frames of the landmarks whose names start with a prefix."""
    gone = np.zeros(landmarks.confidence.shape, bool)
    some = [k for k, name in enumerate(landmarks.names) if name.startswith(prefix)]
    gone[np.ix_(frames, some)] = True
    return replace(
        landmarks,
        pixels=np.where(gone[..., None], np.nan, landmarks.pixels),
        metric=np.where(gone[..., None], np.nan, landmarks.metric),
        confidence=np.where(gone, 0, landmarks.confidence),
    )
