"""The camera's motion is found where the backdrop shows it; light that moves is no motion."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, gaussian_filter, shift

from gva_mi.matting.camera import ShrunkPicture, camera_motion, camera_motions, moved_pixels

H, W, T, MARGIN = 420, 300, 7, 40
TIMES = np.linspace(-1, 1, T)
SWAY = np.stack([np.sin(TIMES), 0.4 * np.cos(2 * TIMES)], 1)  # x, y: largest 1


def backdrop(kind, random):
    """Return a wall (H, W) in [0, 1] with a margin around it."""
    size = H + 2 * MARGIN, W + 2 * MARGIN
    wall = np.full(size, 0.74)
    if kind == "vignette":
        y, x = np.mgrid[: size[0], : size[1]]
        wall -= 0.35 * (((x - size[1] / 2) / size[1]) ** 2 + ((y - size[0] / 2) / size[0]) ** 2)
    if kind == "bricks":
        rows, columns = np.mgrid[: size[0], : size[1]] // np.array([18, 40])[:, None, None]
        wall += 0.08 * random.normal(size=(size[0], size[1]))[rows, columns]
    return wall


def recording(kind, pixels=0.0, shadow=0.0, halo=0.0, seed=5):
    """Return T shrunk pictures of a person who walks and turns, before a camera that sways.

    ``shadow`` is the depth of a soft shadow beside the person, ``halo`` the brightness of a band
    around it.
    """
    random = np.random.default_rng(seed)
    wall, found = backdrop(kind, random), []
    y, x = np.mgrid[:H, :W] + 0.5
    for k, (right, down) in enumerate(SWAY * pixels):
        seen = shift(wall, (-down, -right), order=1, mode="nearest")
        seen = seen[MARGIN:-MARGIN, MARGIN:-MARGIN]
        middle, wide = W * (0.38 + 0.04 * k) - right, W * (0.1 + 0.03 * np.cos(2 * k))
        person = np.maximum(
            np.minimum(wide - abs(x - middle), np.minimum(y - 90, 385 - y)),
            28 - np.hypot(x - middle, y - 68),
        )
        person = np.clip(person + 0.5, 0, 1)
        away = np.hypot((x - middle - 0.2 * W) / (0.22 * W), (y - 250) / 110)
        seen = seen * (1 - shadow * np.exp(-(away**2)))
        seen = seen + halo * (distance_transform_edt(person < 0.5) < 11)
        clothes = 0.3 + 0.15 * np.sin(x / 5 + k) * np.sin(y / 8)
        picture = person * clothes + (1 - person) * seen + random.normal(0, 0.006, (H, W))
        picture = np.round(picture.clip(0, 1)[..., None].repeat(3, -1) * 255).astype(np.uint8)
        rough = np.round(gaussian_filter(person, 1.5) * 255).astype(np.uint8)
        found.append(ShrunkPicture.of(picture, rough))
    return found


def motions(pictures):
    return camera_motions(pictures.__getitem__, range(T))


@pytest.mark.parametrize("shadow", [0.0, 0.25])
@pytest.mark.parametrize("halo", [0.0, 3 / 255])
@pytest.mark.parametrize("kind", ["plain", "vignette", "bricks"])
def test_a_camera_that_stands_is_found_to_stand(kind, halo, shadow):
    found = motions(recording(kind, 0.0, shadow, halo))
    assert all(A is not None and (A == np.eye(3)).all() for A in found.values())


@pytest.mark.parametrize("shadow", [0.0, 0.25])
@pytest.mark.parametrize("pixels", [2.0, 8.0, 30.0])
def test_a_shift_is_found_before_bricks(pixels, shadow):
    found = motions(recording("bricks", pixels, shadow, 3 / 255))
    assert set(found) == set(range(T))
    middle = SWAY[T // 2]
    for k, (right, down) in enumerate(SWAY):
        true = -pixels * (np.array([right, down]) - middle)
        at_centre = found[k][:2, 2] * [W / 2, H / 2]
        assert at_centre == pytest.approx(true, abs=max(1.0, 0.04 * pixels))
    assert moved_pixels(found[0], (W, H)) == pytest.approx(0.84 * pixels, rel=0.1, abs=0.5)


def test_before_a_plain_wall_a_wild_start_is_no_motion():
    """A search that leaves the picture is lost only if there is something to find."""
    plain, bricks = recording("plain"), recording("bricks", 20.0)
    far = np.eye(3)
    far[0, 2] = 1.9
    assert (camera_motion(plain[0], plain[1], far) == np.eye(3)).all()
    assert camera_motion(bricks[0], bricks[1], far) is None
