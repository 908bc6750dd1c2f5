"""The real landmark networks on a rendered person."""

import numpy as np
import pytest
from PIL import Image

from gva_mi.core.errors import InputError
from gva_mi.networks.body_landmarks import BodyNetwork, SeenBody, mean_of_passes
from gva_mi.networks.person_tracker import PersonDetector, PersonTracker
from gva_mi.networks.video_landmarks import LANDMARK_NAMES, watch_video
from gva_mi.subject.landmarks import BODY_LANDMARKS, FACE_LANDMARKS

pytest.importorskip("ai_edge_litert")
JOINTS = ("shoulder", "elbow", "wrist", "knee", "ankle")
SWAP = {"left": "right", "right": "left"}
OTHER = [
    LANDMARK_NAMES.index("_".join(SWAP.get(word, word) for word in name.split("_")))
    for name in LANDMARK_NAMES
]
_FACE = LANDMARK_NAMES.index(FACE_LANDMARKS[0])
for one, other in (  # iBUG's numbers of points on the right and on the left
    *((17 + k, 26 - k) for k in range(5)), (31, 35), (32, 34), (36, 45), (37, 44), (38, 43),
    (39, 42), (40, 47), (41, 46), (48, 54), (49, 53), (50, 52), (59, 55), (58, 56), (60, 64),
    (61, 63), (67, 65),
):  # fmt: skip
    OTHER[_FACE + one - 17], OTHER[_FACE + other - 17] = _FACE + other - 17, _FACE + one - 17
_LEG = ("knee", "ankle", "heel", "foot_index")
TRUNK = [BODY_LANDMARKS.index(f"{side}_{part}") for part in ("shoulder", "hip") for side in SWAP]
LEGS = [BODY_LANDMARKS.index(f"{side}_{part}") for part in _LEG for side in SWAP]
GREY = np.full((600, 1000, 3), 180, np.uint8)


@pytest.fixture(scope="module")
def watched(rendered_person):
    """Landmarks and silhouettes of two equal pictures of the person."""
    silhouettes = []
    keep = lambda k, inside: silhouettes.append(inside)
    return watch_video([rendered_person.picture] * 2, keep), silhouettes


def at(watched, name, frame=1):
    return watched.landmarks.pixels[frame, LANDMARK_NAMES.index(name)]


def test_landmarks_are_near_the_joints_and_hands_hang_on_their_wrists(watched, rendered_person):
    recording, _ = watched
    height = np.ptp(np.flatnonzero(rendered_person.mask.any(1)))
    for side in ("left", "right"):
        for part in JOINTS:
            error = at(recording, f"{side}_{part}") - rendered_person.joints[f"{side}_{part}"]
            assert np.linalg.norm(error) < 0.025 * height, (side, part)
        for point, joint in (("wrist", "wrist"), ("index_mcp", "index1"), ("pinky_mcp", "pinky1")):
            error = (
                at(recording, f"{side}_hand_{point}") - rendered_person.joints[f"{side}_{joint}"]
            )
            assert np.linalg.norm(error) < 0.025 * height, (side, point)
    assert np.isfinite(recording.landmarks.metric[:, :_FACE]).all() and not recording.notes
    assert (recording.landmarks.confidence > 0.5).mean() > 0.95
    assert (
        recording.landmarks.spread > 0
    ).all() and recording.landmarks.spread.mean() < 0.02 * height


def test_the_face_is_found_where_it_is_and_nowhere_else(watched, rendered_person):
    """Eyes and mouth are at those of the body; there is none on the back of the head."""
    recording, _ = watched
    of = lambda *numbers: np.mean([at(recording, f"face_{n}") for n in numbers], axis=0)
    wide = np.linalg.norm(at(recording, "left_eye") - at(recording, "right_eye"))
    for side, corners in (("left", (42, 45)), ("right", (36, 39))):
        seen = rendered_person.joints[f"{side}_eye_smplhf"]
        assert np.linalg.norm(of(*corners) - seen) < 0.25 * wide
    assert of(51)[1] < of(62)[1] <= of(66)[1] < of(57)[1]
    head = rendered_person.joints["head"]
    hidden = rendered_person.picture.copy()
    hidden[: int(head[1]) + 10] = 120, 80, 60
    gone = watch_video([hidden] * 2).landmarks
    assert np.isnan(gone.pixels[:, _FACE:]).all() and not gone.confidence[:, _FACE:].any()


def test_silhouettes_overlap_the_mask(watched, rendered_person):
    true = rendered_person.mask > 0.5
    for inside in watched[1]:
        assert inside.shape == true.shape and 0 <= inside.min() and inside.max() <= 1
        found = inside > 0.5
        assert (found & true).sum() / (found | true).sum() > 0.9


def test_a_closer_look_sharpens_the_silhouette_and_leaves_what_lies_outside(rendered_person):
    picture, true = rendered_person.picture, rendered_person.mask
    network = BodyNetwork()
    body = PersonTracker(PersonDetector(), network, None).follow(picture)
    closer = network.see_closer(picture, body)
    rough, fine = (seen.probability(true.shape) for seen in (body, closer))
    y, x = np.indices(true.shape) + 0.5
    places = closer.closer[0].from_picture(np.stack([x, y], axis=-1))
    inside = ((places > 0) & (places < 1)).all(-1)
    assert np.allclose(rough[~inside], fine[~inside], atol=2e-3) and (~inside & (rough > 0.5)).any()
    before, after = (np.square(seen - true)[inside].mean() for seen in (rough, fine))
    assert after < 0.9 * before


def test_a_mirrored_picture_has_mirrored_landmarks(watched, rendered_person):
    mirrored = watch_video([rendered_person.picture[:, ::-1]] * 2).landmarks
    plain, width = watched[0].landmarks, rendered_person.picture.shape[1]
    moved = mirrored.pixels[1][OTHER] * (-1, 1) + (width, 0) - plain.pixels[1]
    assert np.median(np.abs(moved)) < 2 and np.linalg.norm(moved, axis=-1).max() < 12
    metric = mirrored.metric[1][OTHER] * (-1, 1, 1) - plain.metric[1]
    assert np.median(np.abs(metric[:_FACE])) < 0.02


@pytest.mark.parametrize("parts", [LEGS, TRUNK], ids=["legs", "trunk"])
def test_parts_that_one_pass_takes_for_the_other_side_s_are_not_averaged(parts):
    """The pass counts that is near the picture before; elsewhere the mean does."""
    points = np.random.default_rng(0).uniform(0, 100, (39, 2))
    swapped, metric = points + 1, np.zeros((39, 3))
    for left, right in np.reshape(parts, (-1, 2)):
        swapped[[left, right]] = points[[right, left]]
    body = lambda places, z: SeenBody(places, np.ones(39), np.zeros(39), metric + z, 1.0, ())
    for passes in ([body(points, 0), body(swapped, 1)], [body(swapped, 1), body(points, 0)]):
        merged = mean_of_passes(passes, body(points + 2, 0))
        assert np.array_equal(merged.points[parts], points[parts])
        assert (merged.metric[parts] == 0).all() and (merged.spread[parts] > 1).all()
        rest = np.setdiff1d(np.arange(39), parts)
        assert np.allclose(merged.points[rest], points[rest] + 0.5)
    alone = mean_of_passes(passes, None)
    assert np.allclose(alone.points[parts], (points + swapped)[parts] / 2)


def test_same_pictures_same_bits(watched, rendered_person):
    silhouettes = []
    again = watch_video([rendered_person.picture] * 2, lambda k, inside: silhouettes.append(inside))
    for name in ("pixels", "confidence", "spread", "metric"):
        one, other = (getattr(recording.landmarks, name) for recording in (again, watched[0]))
        assert np.array_equal(one, other, equal_nan=True), name
    assert np.array_equal(silhouettes, watched[1])


def test_the_person_is_kept_while_another_one_walks_past_in_front(rendered_person):
    """The other one comes from the right and leaves to the left; both are 240 pixels wide."""
    lefts = [1000 - 80 * k for k in range(19)]
    recording = [
        rendered_person.on(rendered_person.on(GREY, 260), left, (2, 0, 1)) for left in lefts
    ]
    found = watch_video(recording)
    hips = found.landmarks.pixels[:, [LANDMARK_NAMES.index(f"{s}_hip") for s in SWAP], 0].mean(1)
    off = np.abs(hips - 260 - rendered_person.joints["pelvis"][0])
    assert np.nanmax(off) < 50 and np.isfinite(off).sum() >= 12
    assert np.isfinite(off[[0, 1, 2, -3, -2, -1]]).all()
    assert any("several people" in note for note in found.notes)
    lost = np.flatnonzero(np.isnan(off))
    assert bool(len(lost)) == any("was not found" in note for note in found.notes)


@pytest.mark.parametrize("left", [200, 1200])
def test_a_small_person_in_a_wide_picture_is_found(left, rendered_person):
    """The person fills a fifth of the height, and a twentieth of the width."""
    whole = Image.fromarray(rendered_person.on(GREY[:, :480], 0))
    wide = np.full((900, 1600, 3), 180, np.uint8)
    wide[500:680, left : left + 144] = np.asarray(whole.resize((144, 180)))
    found = watch_video([wide] * 2).landmarks
    for side in ("left", "right"):
        for part in JOINTS:
            true = 0.3 * rendered_person.joints[f"{side}_{part}"] + (left, 500)
            error = found.pixels[1, LANDMARK_NAMES.index(f"{side}_{part}")] - true
            assert np.linalg.norm(error) < 0.05 * 150, (side, part)


def test_people_are_numbered_from_the_left(rendered_person):
    both = rendered_person.on(rendered_person.on(GREY, -20), 540, (2, 0, 1))
    alone = rendered_person.on(GREY, 100)
    x = []
    for person in (1, 2):
        found = watch_video([alone, both], person=person)
        x.append(found.landmarks.pixels[:, 0, 0])
    assert np.isnan(x[1][0]) and np.isfinite(x[0]).all()  # one person is no second one
    assert x[1][1] - x[0][1] > 400


def test_a_lost_person_is_found_again(rendered_person):
    recording = [rendered_person.picture, np.full_like(rendered_person.picture, 255)] * 2
    silhouettes = []
    found = watch_video(recording, lambda k, inside: silhouettes.append(inside.max()))
    assert np.isfinite(found.landmarks.pixels[:, 0, 0]).tolist() == [True, False] * 2
    assert (found.landmarks.confidence[1] == 0).all() and silhouettes[1] == 0 < silhouettes[2]
    assert "frames where the person was not found: 1, 3" in found.notes


def test_a_person_who_leaves_is_not_replaced_by_another_one_who_stays(rendered_person):
    """Both wear the same. The other one is 500 pixels away, and comes nearer."""
    beside = [rendered_person.on(GREY, left) for left in (540, 540, 500, 460, 420, 380)]
    both = [rendered_person.on(picture, -20) for picture in beside[:2]]
    found = watch_video([*both, *beside[2:]], person=1).landmarks.pixels[:, 0, 0]
    assert np.isfinite(found).tolist() == [True] * 2 + [False] * 4


def test_a_video_without_anybody_is_refused():
    with pytest.raises(InputError, match="finds a person in no picture of the video"):
        watch_video([GREY] * 2)
