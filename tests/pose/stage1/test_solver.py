"""Stage 1 of a video: known poses come back from their landmarks, whatever is missing.

The video is in numbers: landmarks projected from known poses before a camera that looks down.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape, mirrored_name
from gva_mi.core.errors import InputError
from gva_mi.observe.landmark_noise import LandmarkNoise
from gva_mi.observe.rig import LandmarkRig
from gva_mi.prior.body_height import Stature
from gva_mi.splat import Camera, look_at
from gva_mi.stage1.solver import KnownParameters, solve_stage1
from gva_mi.stage1.vertical_lines import Vertical
from gva_mi.subject.landmarks import BODY_LANDMARKS, Landmarks, hand_names

LIMBS = slice(1, 22)  # joints of the body without the root
FINGERS = slice(25, 55)
SIZE, FOCAL, FPS = (360, 640), 480.0, 10.0  # a phone upright: 67 degrees over the longer side


@dataclass(frozen=True)
class KnownRecording:
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


def as_networks_see(z, names):
    """Walk along the bones of ``LandmarkNoise`` from the left hip, each damped and biased."""
    zero = np.zeros((*z.shape, 3), np.float32)
    ones = np.ones(z.shape, np.float32)
    flat = Landmarks(names, zero[..., :2] + np.arange(len(names))[:, None], ones, ones, zero)
    noise = LandmarkNoise.of(replace(flat, metric=zero + np.arange(len(names))[:, None]), names)
    links = list(zip(noise.bones.tolist(), noise.gain.tolist(), noise.bias.tolist(), strict=True))
    links += [
        ((names.index(f"{side}_wrist"), names.index(f"{side}_hand_wrist")), 1.0, 0.0)
        for side in ("left", "right")
    ]
    seen = {names.index("left_hip"): z[:, names.index("left_hip")]}
    while True:
        new = {}
        for (i, j), gain, bias in links:
            for one, other, sign in ((i, j, 1), (j, i, -1)):
                if one in seen and other not in seen:
                    step = gain * (z[:, j] - z[:, i]) + bias
                    new[other] = seen[one] + sign * step
        if not new:
            break
        seen |= new
    return np.stack([seen.get(k, z[:, k]) for k in range(len(names))], axis=1)


def mirrored(landmarks):
    """Reflect landmarks in the picture's vertical axis: left becomes right."""
    names = [mirrored_name(name) for name in landmarks.names]
    pixels = landmarks.pixels * [-1, 1] + [SIZE[0], 0]
    return replace(landmarks, names=names, pixels=pixels, metric=landmarks.metric * [-1, 1, 1])


def video_of(body, pose, shape, camera):
    """Project every landmark of a posed body; depths are damped and biased as a network's are."""
    rig = LandmarkRig.of(body, (*BODY_LANDMARKS, *hand_names("left"), *hand_names("right")))
    T_world_rest = body(pose, shape).T_world_rest
    places = rig.places(T_world_rest, shape.betas, 0 * rig.rest).double().numpy()
    T = camera.T_camera_world
    metric = places @ T[:3, :3].T
    metric[..., 2] = as_networks_see(metric[..., 2], rig.names)
    hips = metric[:, [rig.names.index(f"{side}_hip") for side in ("left", "right")]]
    ones = np.ones(places.shape[:2])
    landmarks = Landmarks(
        rig.names, camera.project(places), ones, 0 * ones, metric - hips.mean(1, keepdims=True)
    )
    height = float(Stature.of(body).height(shape))
    return KnownRecording(landmarks, pose, shape, height, camera)


@pytest.fixture(scope="module")
def known_recording(built_in_body):
    """Twelve frames; the camera looks 20 degrees down."""
    pose, shape = moving(12), Shape(torch.tensor([0.5, 0, 0.5, 0.5]))
    lowest = built_in_body(pose, shape).vertices[..., 1].amin(1)
    pose.transl[:, 1] -= lowest  # the soles stand
    centre, down = np.array([0.0, 0.9, 0]), np.radians(20)
    eye = centre + 3.2 * np.array([0, np.sin(down), np.cos(down)])
    camera = Camera(FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2, look_at(eye, centre), *SIZE)
    return video_of(built_in_body, pose, shape, camera)


def without(landmarks, frames, prefix=""):
    """Remove what was found in some frames of the landmarks whose names start with a prefix."""
    gone = np.zeros(landmarks.confidence.shape, bool)
    some = [k for k, name in enumerate(landmarks.names) if name.startswith(prefix)]
    gone[np.ix_(frames, some)] = True
    return replace(landmarks, pixels=np.where(gone[..., None], np.nan, landmarks.pixels),
        metric=np.where(gone[..., None], np.nan, landmarks.metric),
        confidence=np.where(gone, 0, landmarks.confidence))  # fmt: skip


def solved(recording, body, landmarks=None, **options):
    """Solve a video whose camera and height are known."""
    fps = options.pop("fps", FPS)
    known = KnownParameters(**{"height": recording.height, "focal": recording.camera.fx} | options)
    return solve_stage1(landmarks or recording.landmarks, body, SIZE, fps, known)


def in_camera(body, recording):
    """Return joints (T, 55, 3) in the camera's axes, metres, of a solved video or a known one."""
    T = torch.from_numpy(np.array(recording.camera.T_camera_world))
    return body(recording.pose, recording.shape).joints.double() @ T[:3, :3].T + T[:3, 3]


def errors(found, recording, body):
    """Return distances (T, 55) of joints from the true ones, metres."""
    return (in_camera(body, found) - in_camera(body, recording)).norm(dim=2)


@pytest.fixture(scope="module")
def found(known_recording, built_in_body):
    return solved(known_recording, built_in_body)


def test_known_poses_come_back(found, known_recording, built_in_body):
    apart = errors(found, known_recording, built_in_body)
    assert apart[:, LIMBS].mean() < 0.04
    assert apart[:, FINGERS].mean() < 0.05


def test_keypoints_at_the_joints_put_the_legs_where_they_are_given(known_recording, built_in_body):
    """Knees and ankles of another program lie at the joints, its hips 4 cm lower than the body's.

    Landmarks of BlazePose lie a centimetre above the body's knees and ankles.
    """
    ours, camera = known_recording.landmarks, known_recording.camera
    limbs = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    given = [f"{side}_{limb}" for limb in limbs for side in ("left", "right")]
    legs = [JOINTS.index(name) for name in given[-4:]]
    joints = built_in_body(known_recording.pose, known_recording.shape).joints.double().numpy()
    marked = joints[:, [JOINTS.index(name) for name in given]]
    marked[:, [name.endswith("hip") for name in given], 1] -= 0.04
    pixels = ours.pixels.copy()
    pixels[:, ours.indices(given)] = camera.project(marked)
    below = {}
    for at_joints in (given, ()):
        seen = replace(ours, pixels=pixels, at_joints=at_joints)
        found = solved(known_recording, built_in_body, seen)
        legs_found = built_in_body(found.pose, found.shape).joints[:, legs].double().numpy()
        off = found.camera.project(legs_found) - camera.project(joints[:, legs])
        below[len(at_joints)] = np.median(off[..., 1])
    assert abs(below[12]) < 0.2 and below[0] > 0.4, below  # pixels; the person has 250


def test_the_world_is_upright_with_the_floor_at_zero(found, built_in_body):
    assert found.tilt == pytest.approx(20, abs=2.5)
    lowest = built_in_body(found.pose, found.shape).vertices[..., 1].amin(1)
    assert lowest.abs().max() < 0.02


def test_mirrored_landmarks_give_the_mirrored_poses(found, known_recording, built_in_body):
    flipped = solved(known_recording, built_in_body, mirrored(known_recording.landmarks))
    order = [JOINTS.index(mirrored_name(name)) for name in JOINTS]
    other = in_camera(built_in_body, flipped)[:, order]
    other = other * torch.tensor([-1.0, 1, 1])
    assert (other - in_camera(built_in_body, found)).norm(dim=2).max() < 0.01


def test_lost_frames_and_a_lost_hand_are_bridged(known_recording, built_in_body):
    landmarks = without(known_recording.landmarks, [5, 6])
    landmarks = without(landmarks, range(12), "left_hand")
    bridged = solved(known_recording, built_in_body, landmarks)
    apart = errors(bridged, known_recording, built_in_body)
    assert apart[:, LIMBS].mean() < 0.06


def test_a_camera_that_is_not_given_is_found(known_recording, built_in_body):
    found = solved(known_recording, built_in_body, height=None, focal=None)
    assert found.tilt == pytest.approx(20, abs=5)
    assert found.camera.fx == pytest.approx(known_recording.camera.fx, rel=0.12)
    lowest = built_in_body(found.pose, found.shape).vertices[..., 1].amin(1)
    assert lowest.abs().max() < 0.03


def test_lines_and_the_height_of_the_camera_say_which_way_is_up(known_recording, built_in_body):
    T = known_recording.camera.T_camera_world
    up, above = T[:3, :3] @ [0, 1, 0], -(T[:3, :3].T @ T[:3, 3])[1]
    lines = Vertical(-up[[0, 2]] / up[1], np.array([0.006, 0.006]))
    assert solved(known_recording, built_in_body, lines=lines).tilt == pytest.approx(20, abs=0.7)
    assert solved(known_recording, built_in_body, camera_height=above).tilt == pytest.approx(
        20, abs=1.2
    )


def test_a_video_of_nobody_is_refused(known_recording, built_in_body):
    with pytest.raises(InputError, match="no frame has a person"):
        solved(known_recording, built_in_body, without(known_recording.landmarks, range(12)))


def test_the_order_of_names_and_unknown_ones_do_not_matter(found, known_recording, built_in_body):
    recording = known_recording.landmarks
    order = [*np.random.default_rng(0).permutation(len(recording.names)), 0]
    arrays = ("pixels", "confidence", "spread", "metric")
    shuffled = {name: getattr(recording, name)[:, order] for name in arrays}
    names = (*(recording.names[k] for k in order[:-1]), "tail")
    again = solved(known_recording, built_in_body, replace(recording, names=names, **shuffled))
    assert torch.equal(again.pose.rotations, found.pose.rotations)
    assert torch.equal(again.pose.transl, found.pose.transl)
