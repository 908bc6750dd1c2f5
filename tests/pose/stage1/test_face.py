"""The face of a video: a known head, jaw and expression come back from its landmarks."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.body_file import BUILT_IN_BODY, EXPRESSIONS, read_body
from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.observe.face_points import FacePoints
from gva_mi.splat import Camera, look_at
from gva_mi.stage1.face import NO_FACE, with_face
from gva_mi.stage1.solver import Stage1Solution
from gva_mi.subject.landmarks import FACE_LANDMARKS, Landmarks

HEAD, JAW = JOINTS.index("head"), JOINTS.index("jaw")
FRAMES, FPS, TALKS = 40, 20.0, 30  # the face is seen in the first frames only
SMILE = EXPRESSIONS.index("smile")
CAMERA = Camera(900, 900, 270, 200, look_at((0, 0.5, 2.2), (0, 0.35, 0)), 540, 960)


@dataclass(frozen=True)
class Talk:
    """Somebody who talks and smiles to the camera, and stage 1, whose head is off by 8 degrees."""

    true: Pose
    solved: Stage1Solution
    landmarks: Landmarks


def one_turn(pose, joint):
    return roma.rotvec_to_rotmat(pose.rotations[:, joint].double())


def off(pose, other):
    """Degrees by which heads differ (T,)."""
    return torch.rad2deg(roma.rotmat_geodesic_distance(one_turn(pose, HEAD), one_turn(other, HEAD)))


@pytest.fixture(scope="module")
def talk(built_in_body):
    t = torch.arange(FRAMES) / FPS
    true = Pose.rest(FRAMES)
    true.rotations[:, HEAD, 1] = 0.2 * torch.sin(4 * t)
    true.rotations[:, JAW, 0] = 0.15 * (1 - torch.cos(9 * t))
    true.expression[:, SMILE] = 1.5 * torch.sin(5 * t)
    shape = Shape(torch.linspace(-1, 1, 10))
    at = nearest_vertices(built_in_body)
    places = CAMERA.project(built_in_body(true, shape).vertices[:, at].double().numpy())
    places += np.random.default_rng(0).normal(0, 0.2, places.shape)
    places[TALKS:] = np.nan
    seen = np.isfinite(places[..., 0]).astype(float)
    landmarks = Landmarks(FACE_LANDMARKS, places, seen, 0 * seen, np.full((*seen.shape, 3), np.nan))
    given = Pose(true.rotations.clone(), true.transl, 0 * true.expression)
    given.rotations[:, JAW] = 0
    given.rotations[:, HEAD] += torch.tensor([0.12, -0.07, 0.02])
    solved = Stage1Solution(given, shape, CAMERA, 0.0)
    return Talk(true, solved, landmarks)


def nearest_vertices(body):
    """The vertices of the landmarks, by their places at rest."""
    return torch.cdist(FacePoints.of(body).rest.float(), body.v_template).argmin(1)


def mouth(pose, body):
    """How far the lips are apart (T,), metres; their mean thickness at rest does not count."""
    rotations = torch.zeros_like(pose.rotations)
    rotations[:, JAW] = pose.rotations[:, JAW]
    alone = Pose(rotations, 0 * pose.transl, pose.expression)
    upper, lower = nearest_vertices(body)[
        [FACE_LANDMARKS.index("face_62"), FACE_LANDMARKS.index("face_66")]
    ]
    y = body(alone, Shape(torch.zeros(10))).vertices[..., 1]
    return y[:, upper] - y[:, lower] - (body.v_template[upper, 1] - body.v_template[lower, 1])


def test_a_known_head_jaw_and_expression_come_back(talk, built_in_body):
    found, notes = with_face(talk.solved, talk.landmarks, built_in_body, FPS)
    assert not notes and found.pose.expression.shape == (FRAMES, 10)
    seen = slice(TALKS)
    before, after = (off(pose, talk.true)[seen].mean() for pose in (talk.solved.pose, found.pose))
    assert before > 7.5 and after < 0.4 * before  # the rest could be the person's own face
    parted, opened = (mouth(pose[seen], built_in_body) for pose in (found.pose, talk.true))
    assert opened.max() > 0.01 and (parted - opened).abs().mean() < 0.15 * opened.mean()
    assert found.pose.rotations[:, JAW, 0].min() >= 0
    smile, smiled = (pose.expression[seen, SMILE] for pose in (found.pose, talk.true))
    assert np.corrcoef(smile, smiled - smiled.median())[0, 1] > 0.95
    others = [j for j in range(len(JOINTS)) if j not in (HEAD, JAW)]
    assert torch.equal(found.pose.rotations[:, others], talk.solved.pose.rotations[:, others])


def test_without_a_face_the_body_s_solution_returns_and_nothing_jumps(talk, built_in_body):
    """Half a second's memory: 10 frames after the last face, a third of the correction is left."""
    found, _ = with_face(talk.solved, talk.landmarks, built_in_body, FPS)
    moved = off(found.pose, talk.solved.pose)
    assert moved[-1] < 0.5 * moved[TALKS - 1]
    assert moved.diff().abs().max() < 0.2 * moved.max()
    assert found.pose.rotations[:, JAW, 0].diff().abs().max() < 0.1


def test_a_video_without_a_face_and_a_body_without_one_stay_as_they_are(talk, built_in_body):
    nobody = replace(talk.landmarks, confidence=0 * talk.landmarks.confidence)
    assert with_face(talk.solved, nobody, built_in_body, FPS) == (talk.solved, [])
    others = replace(talk.landmarks, names=tuple(f"x{name}" for name in FACE_LANDMARKS))
    assert with_face(talk.solved, others, built_in_body, FPS) == (talk.solved, [])
    plain = BodyModel(read_body(BUILT_IN_BODY) | {"num_expressions": np.array(0)})
    assert with_face(talk.solved, talk.landmarks, plain, FPS) == (talk.solved, [NO_FACE])


def without_jaw(**others):
    """The built-in body whose jaw moves nothing; the face's landmarks are marked, as in SMPL-X."""
    arrays = dict(read_body(BUILT_IN_BODY))
    body = BodyModel(arrays)
    at = nearest_vertices(body).numpy()
    corner = [np.argwhere(arrays["f"] == k)[0] for k in at]
    weights = arrays["weights"].copy()
    weights[:, HEAD] += weights[:, JAW]
    weights[:, JAW] = 0
    arrays["lmk_faces_idx"] = np.array([face for face, _ in corner])
    arrays["lmk_bary_coords"] = np.eye(3, dtype=np.float32)[[k for _, k in corner]]
    return BodyModel(arrays | {"weights": weights} | others)


def test_a_mouth_that_does_not_move_stays_closed(talk, built_in_body):
    """Head and expression are found all the same; without any expression, the head alone."""
    shapes = read_body(BUILT_IN_BODY)["shapedirs"].copy()
    shapes[..., 10:] = 0
    for others, smiles in (({}, True), ({"shapedirs": shapes}, False)):
        body = without_jaw(**others)
        at = nearest_vertices(body)
        places = CAMERA.project(body(talk.true, talk.solved.shape).vertices[:, at].double().numpy())
        places[TALKS:] = np.nan
        found, _ = with_face(talk.solved, replace(talk.landmarks, pixels=places), body, FPS)
        assert torch.equal(found.pose.rotations[:, JAW], talk.solved.pose.rotations[:, JAW])
        before, after = (off(x, talk.true)[:TALKS].mean() for x in (talk.solved.pose, found.pose))
        assert after < 0.4 * before
        assert found.pose.expression.isfinite().all() and found.pose.expression.any() == smiles
    plain = without_jaw(lmk_faces_idx=None)
    assert with_face(talk.solved, talk.landmarks, plain, FPS) == (talk.solved, [NO_FACE])


def test_a_face_that_is_always_turned_away_changes_nothing(talk, built_in_body):
    """A network may take the back of a head for a face."""
    rotations = talk.solved.pose.rotations.clone()
    rotations[:, 0, 1] = np.pi
    away = replace(talk.solved, pose=replace(talk.solved.pose, rotations=rotations))
    assert with_face(away, talk.landmarks, built_in_body, FPS) == (away, [])
