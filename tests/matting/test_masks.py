"""Masks of a video hold at the outline, where a network's probabilities are rough."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from gva_mi.matting.camera import WorkGrid
from gva_mi.matting.hands import Bones
from gva_mi.matting.masks import video_masks
from gva_mi.matting.odds import (
    BRIGHTEST_SHADE,
    DARKEST_SHADOW,
    SHADOW_MEAN,
    SHADOW_MEAN_AT_FEET,
    ColorsByHeight,
    PersonColors,
    Shadows,
    log_odds,
)
from gva_mi.matting.plate import Plate, overlay_of
from gva_mi.subject.folder import SubjectWriter
from gva_mi.subject.landmarks import Landmarks, hand_names
from gva_mi.subject.pictures import in_8_bits, read_image

H, W, T = 96, 80, 10
NONE = Landmarks((), np.zeros((T, 0, 2)), *np.zeros((2, T, 0)), np.zeros((T, 0, 3)))


@pytest.fixture(scope="module")
def recording():
    """Return pictures, true masks and probabilities of a striped figure that walks past a wall.

    A shadow darkens the floor beside its feet.
    """
    random = np.random.default_rng(0)
    wall = gaussian_filter(random.uniform(0, 1, (H, W, 3)), (1, 1, 0))
    wall = 0.55 + 0.5 * (wall - wall.mean())
    wall[76:] *= [0.8, 0.6, 0.4]
    y, x = np.mgrid[:H, :W] + 0.5
    pictures, masks, probabilities = [], [], []
    for k in range(T):
        middle = 24 + 3.3 * k
        head = 8 - np.hypot(x - middle, y - 18)
        body = np.minimum(9 - np.abs(x - middle), np.minimum(y - 24, 84 - y))
        mask = np.clip(np.maximum(head, body) + 0.5, 0, 1)
        shadow = 1 - 0.5 * np.exp(-(((x - middle - 12) / 9) ** 2) - ((y - 85) / 5) ** 2)
        shirt = np.stack([0.7 + 0.1 * np.sin(y), 0.15 + 0 * y, 0.2 + 0.1 * np.sin(x)], -1)
        picture = mask[..., None] * shirt + (1 - mask[..., None]) * wall * shadow[..., None]
        picture = picture + random.normal(0, 0.01, picture.shape)
        pictures.append(np.round(picture.clip(0, 1) * 255).astype(np.uint8))
        masks.append(mask)
        rough = shift(gaussian_filter(mask, 2), (1.5, -2), order=1)
        probabilities.append(np.round(rough * 255).astype(np.uint8))
    return pictures, np.array(masks), probabilities


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


def found(folder):
    return np.array([read_image(folder / f"masks/{k:06d}.png", 1) for k in range(T)]) / 255


def test_masks_hold_at_the_outline_and_leave_the_shadow_out(recording, tmp_path):
    pictures, truth, rough = recording
    assert video_masks(pictures, rough, NONE, SubjectWriter(tmp_path)) == []
    masks = found(tmp_path)
    before = iou(np.array(rough) > 127, truth > 0.5)
    assert before < 0.87
    assert iou(masks > 0.5, truth > 0.5) > 0.985
    assert np.minimum(masks, truth).sum() / np.maximum(masks, truth).sum() > 0.96


def test_a_caption_over_the_feet_is_found_and_masks_continue_beneath(
    recording, tmp_path, monkeypatch
):
    """Letters over the person's way, and a logo in a corner, which hides nothing."""
    pictures, truth, rough = recording
    letters, logo = np.zeros((H, W), bool), np.zeros((H, W), bool)
    for column in range(8, 72, 7):
        letters[72:80, column : column + 3] = letters[75:77, column : column + 6] = True
    logo[4:9, 68:76:2] = True
    pictures = [np.where((letters | logo)[..., None], 255, x).astype(np.uint8) for x in pictures]
    rough = [np.where(letters, 20, x).astype(np.uint8) for x in rough]
    (note,) = video_masks(pictures, rough, NONE, SubjectWriter(tmp_path / "found"))
    assert "caption" in note
    overlay = read_image(tmp_path / "found/overlay.png", 1) > 127
    beneath = letters & (truth.mean(0) > 0.3)
    assert overlay[beneath].mean() > 0.95 and not overlay[:60].any()
    monkeypatch.setattr("gva_mi.matting.masks.overlay_of", lambda *given: None)
    assert video_masks(pictures, rough, NONE, SubjectWriter(tmp_path / "ignored")) == []
    assert not (tmp_path / "ignored/overlay.png").exists()
    off = {
        name: np.abs(found(tmp_path / name) - truth)[:, letters].mean()
        for name in ("found", "ignored")
    }
    assert off["found"] < 0.1 < 0.2 < off["ignored"], off


def test_stripes_of_clothes_that_lie_where_shelves_are_behind_are_no_caption():
    """A shirt's stripes, with folds, are as high as the shelves behind."""
    random = np.random.default_rng(0)
    y, x = np.mgrid[:120, :80]
    stripes, shelves = y // 4 % 2, (abs(y - 50) < 10) & (abs(x - 38) < 8)
    seen = []
    for k in range(24):
        person = (abs(y - 60) < 40) & (abs(x - 20 - k % 13 * 3) < 11)
        shirt = 0.4 + 0.2 * stripes + random.normal(0, 0.05, y.shape)
        grey = np.where(person, shirt, 0.5 + 0.2 * stripes * shelves)
        seen.append((in_8_bits(np.repeat(grey[..., None], 3, 2)), person.astype(float)))
    assert overlay_of(seen, 80.0) is None
    captioned = [(np.where(shelves[..., None], 255 * stripes[..., None], i), P) for i, P in seen]
    assert overlay_of(captioned, 80.0)[shelves].mean() > 0.95


def test_what_the_plate_does_not_explain_is_judged_by_the_colours_of_the_background():
    grey = np.full((4, 4, 3), 0.5, np.float32)
    plate = Plate(grey, np.full((4, 4), 0.02, np.float32), np.ones((4, 4), bool))
    blue = np.broadcast_to(np.float32([0, 0, 1]), (4, 4, 3))
    height, P, person = np.linspace(0, 1, 4), np.full((4, 4), 0.5), np.full((4, 4), 2.0)
    known = blue, P, height, plate, Shadows(), person
    odds = [log_odds(*known, h * np.ones((4, 4)), np.zeros((4, 4))) for h in (1.0, 8.0)]
    # Eq. 2 without the plate: p(I | background) = e h, with e = 0.01.
    assert odds[0] == pytest.approx(np.log(2 / 0.01), abs=0.02)
    assert odds[1] == pytest.approx(np.log(2 / 0.08), abs=0.02)


@pytest.mark.parametrize("deep", [0.0, 0.7])
def test_the_density_of_shadows_integrates_to_one(deep):
    s = np.linspace(DARKEST_SHADOW, BRIGHTEST_SHADE, 20_001)[None]
    for height, mean in ((0.5, SHADOW_MEAN), (0.95, SHADOW_MEAN_AT_FEET)):
        k = Shadows(deep, deep).density(s, np.array([height]))[0]
        darker = s[0] <= 1
        whole = np.trapezoid(k[darker], s[0][darker])
        missing = (1 - deep) * np.exp(
            (DARKEST_SHADOW - 1) / mean
        )  # the exponential's part below DARKEST_SHADOW
        assert whole == pytest.approx(1 - missing, abs=1e-3)


def test_dark_skin_before_wood_is_no_shadow_unless_the_video_has_deep_ones():
    wood = np.broadcast_to(np.float32([0.8, 0.5, 0.3]), (2, 2, 3))
    plate = Plate(wood, np.full((2, 2), 0.01, np.float32), np.ones((2, 2), bool))
    P, flat, height = np.full((2, 2), 0.5), np.ones((2, 2)), np.array([0.4, 0.5])
    odds = lambda s, deep: log_odds(
        s * wood, P, height, plate, Shadows(deep, deep), 100 * flat, flat, 0 * flat
    )
    assert (odds(0.35, 0.0) > 1).all()  # skin
    assert (odds(0.35, 0.7) < -1).all()  # the sun's shadow
    assert (odds(0.95, 0.0) < -2).all()  # a faint shadow


def test_frames_without_a_person_get_empty_masks_and_a_note(recording, tmp_path):
    pictures, _, rough = recording
    rough = [0 * P if k in (2, 3) else P for k, P in enumerate(rough)]
    (note,) = video_masks(pictures, rough, NONE, SubjectWriter(tmp_path / "some"))
    assert "2-3" in note
    masks = found(tmp_path / "some")
    assert [k for k in range(T) if not masks[k].any()] == [2, 3]
    (note,) = video_masks(pictures, [0 * P for P in rough], NONE, SubjectWriter(tmp_path / "none"))
    assert "0-9" in note and not found(tmp_path / "none").any()


def test_a_hand_held_camera_is_followed(recording, tmp_path):
    pictures, truth, rough = recording
    ways = [(round(3 * np.sin(k)), round(2 * np.cos(2 * k))) for k in range(T)]
    shaken = lambda images: [np.roll(x, way, (0, 1)) for x, way in zip(images, ways, strict=True)]
    (note,) = video_masks(shaken(pictures), shaken(rough), NONE, SubjectWriter(tmp_path))
    assert "the camera moves" in note
    assert iou(found(tmp_path) > 0.5, np.array(shaken(truth)) > 0.5) > 0.975


def test_bones_are_near_by_their_distance_and_certainty():
    names = ("right_elbow", "right_wrist", *hand_names("right"))
    pixels = np.full((1, len(names), 2), np.nan)
    pixels[0, :2] = (10.5, 20.5), (30.5, 20.5)  # centres of pixels; the fingers are not found
    certain = np.full(pixels.shape[:2], 0.8)
    sure = Landmarks(names, pixels, certain, 0 * certain, np.zeros((1, len(names), 3)))
    grid = WorkGrid((40, 60), (0, 0, 60, 40), (40, 60))
    n = Bones.of(sure, 0, grid).near((40, 60), radius=2.0)
    assert n[20, 10:31] == pytest.approx(0.8)
    assert n[22, 20] == pytest.approx(0.8 * np.exp(-0.5)) == pytest.approx(n[20, 32])
    assert not n[:14].any() and not n[27:].any() and not n[:, 37:].any()
    assert not Bones.of(NONE, 0, grid).near((40, 60), radius=2.0).any()


def test_a_hand_of_the_walls_colour_is_kept_by_its_bones_alone():
    """The network is in doubt, and a colour that the wall has denies the hand."""
    wall = np.full((4, 4, 3), 0.5, np.float32)
    plate = Plate(wall, np.full((4, 4), 0.02, np.float32), np.ones((4, 4), bool))
    at_bones = np.zeros((4, 4), np.float32)
    at_bones[:2] = 1
    given = wall, np.full((4, 4), 0.5), np.linspace(0, 1, 4), plate, Shadows()
    flat = np.ones((4, 4))
    without = log_odds(*given, 100 * flat, flat, 0 * at_bones)
    found = log_odds(*given, 100 * flat, flat, at_bones)
    assert (without < -2).all() and (found[:2] > 0).all()
    assert np.array_equal(found[2:], without[2:])


def test_hands_have_their_own_colours_near_their_bones_and_nowhere_else():
    image = np.zeros((64, 8, 3), np.uint8)
    image[40:44] = 200  # a hand beside the trunk, of a colour that is rare at this height
    height, bones = np.linspace(0, 1, 64), np.zeros((64, 8))
    bones[40:44] = 1
    colors, by_height = PersonColors(), ColorsByHeight()
    for _ in range(4):
        colors.add(image, np.ones((64, 8), bool), height, bones)
        by_height.add(image, np.ones((64, 8), bool), height)
    near, usual = colors.density(image, height, bones), by_height.density(image, height)
    assert (near[40:44] > 3 * usual[40:44]).all()
    assert np.array_equal(near[bones == 0], usual[bones == 0])
