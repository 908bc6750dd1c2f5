"""A long lens, another one in each frame: thresholds and paths in metres are those before one."""

import numpy as np
from samples.data_sets import SMPLX
from samples.estimates import without_hands

from gva_mi.readers.estimators import VideoInfo, read_estimator
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody
from gva_mi.readers.track import Track, every_frame
from gva_mi.splat import Camera
from gva_mi.subject.check import check_intrinsics
from gva_mi.subject.lens import seen_alike

SIZE = (900, 900)
BOXES = np.array([(374, 0), (406, -47), (378, -6), (395, 20), (360, 5), (390, 40)])  # width, aside


def lenses(boxes=BOXES):
    """As of SMPLer-X: 5000 px for a crop of 192, the axis in the middle of the detector's box."""
    K = np.tile(np.eye(3), (len(boxes), 1, 1))
    K[:, 0, 0] = K[:, 1, 1] = 5000 / 192 * boxes[:, 0]
    K[:, 0, 2], K[:, 1, 2] = 468 + boxes[:, 1], 410 + 0.4 * boxes[:, 1]
    return K


def before(K, place):
    """Pelvises (n, 3) that lenses (n, 3, 3) show where one of 1273 px, centred, shows ``place``."""
    usual = np.hypot(*SIZE)
    place = np.broadcast_to(place, (len(K), 3))
    u = place[:, :2] / place[:, 2:] * usual + 450
    z = K[:, 0, 0] / (usual / place[:, 2])  # as many pixels a metre
    return np.column_stack([(u - K[:, :2, 2]) / K[:, 0, 0, None] * z[:, None], z])


STANDS = before(lenses(), [0.1, -0.05, 4.0])


def test_the_same_picture_before_another_lens():
    """Pixel, and pixels a metre; back again it is the same place."""
    K, other = lenses(), np.array([[1300.0, 0, 440], [0, 1250, 460], [0, 0, 1]])
    K[:, 1, 1] *= 1.03
    moved = seen_alike(STANDS, K, other)
    pixels = lambda K, x: np.einsum("...ij,...j->...i", K, x)[..., :2] / x[..., 2:]
    scale = lambda K, x: np.sqrt(K[..., 0, 0] * K[..., 1, 1]) / x[..., 2]
    assert np.allclose(pixels(K, STANDS), pixels(other, moved))
    assert np.allclose(scale(K, STANDS), scale(other, moved))
    assert np.allclose(seen_alike(moved, other, K), STANDS)


def written(folder, K, pelvises):
    """A person who stands still."""
    return without_hands(folder, K, np.tile([np.pi, 0, 0], (len(K), 1)), pelvises - SMPLX)


def test_who_stands_still_is_one_person_and_does_not_move(tmp_path):
    """Through the file's own lenses the pelvis moves by metres."""
    assert np.linalg.norm(np.diff(STANDS, axis=0), axis=1).max() > 2
    folder = written(tmp_path / "x", lenses(), STANDS)
    found, (track,) = read_estimator("auto", folder, VideoInfo(SIZE))
    assert found == "smplerx" and len(track.frames) == 6
    assert np.allclose(track.places, STANDS) and np.allclose(track.K, lenses())
    options = MotionOptions(fps=30, source_fps=30)
    motion = read_motion(folder, TargetBody.read(None), options)
    assert motion.pose.transl.norm(dim=1).max() < 1e-4
    assert any("each frame has another lens" in note for note in motion.notes)


def test_missing_frames_are_filled_on_the_way_through_the_picture():
    K = lenses()
    track = Track("0", np.array([0, 1, 4, 5]), np.zeros((4, 55, 3)), STANDS[[0, 1, 4, 5]], None,
                  K[[0, 1, 4, 5]], "SMPL-X", False)  # fmt: skip
    whole, _, _ = every_frame("x", track, 6)
    pixels = np.einsum("nij,nj->ni", whole.K, whole.places)
    pixels = pixels[:, :2] / pixels[:, 2:]
    assert np.allclose(pixels, pixels[0]) and np.allclose(
        whole.K[2, 0, 0], K[[1, 4], 0, 0] @ [2, 1] / 3
    )
    assert np.allclose(whole.K[:, 0, 0] / whole.places[:, 2], K[0, 0, 0] / STANDS[0, 2])


def test_check_takes_no_axis_of_a_box_for_a_mistake():
    """Who stands at the picture's border, in SMPLer-X's form; but K of another size is named."""
    beside = lenses(BOXES + [0, -300])
    cameras = lambda K: [Camera.from_matrices(x, np.eye(4), *SIZE) for x in K]
    assert np.abs(beside[:, 0, 2] / 900 - 0.5).min() > 0.2
    assert not list(check_intrinsics(cameras(beside)))
    halved = np.tile(np.diag([600.0, 600, 1]), (6, 1, 1))
    halved[:, :2, 2] = 225
    (problem,) = check_intrinsics(cameras(halved))
    assert problem.what == "principal point"
