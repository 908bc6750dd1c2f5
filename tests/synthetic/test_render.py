"""Rendering a ball, whose silhouette, normals and depth are known."""

import numpy as np
import pytest

from gva_mi.splat import Camera, look_at
from gva_mi.synthetic.cameras import camera_around
from gva_mi.synthetic.render import Renderer

pytest.importorskip("mitsuba")
RADIUS = 0.5
CAMERA = Camera(70, 70, 33.5, 30.25, look_at((0.4, 0.3, 3.0), (0.05, 0, 0)), 64, 60)


@pytest.fixture(scope="module")
def renderer(ball):
    return Renderer(ball)


@pytest.fixture(scope="module")
def picture(renderer, ball):
    return renderer(ball.vertices, CAMERA, 16, 0)


def rays(camera):
    """Return pixel directions (H, W, 3) with z = 1, and the ball's centre (3,), in the camera."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    d = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    return d, camera.T_camera_world[:3, 3]


def test_mask_normals_and_depth_of_a_ball(picture):
    d, centre = rays(CAMERA)
    a, b = (d**2).sum(-1), d @ centre
    discriminant = b**2 - a * (centre @ centre - RADIUS**2)
    depth = (b - np.sqrt(np.maximum(discriminant, 0))) / a
    inside = picture.mask == 1
    assert (discriminant[inside] > 0).all()
    assert abs(picture.mask.sum() / (discriminant > 0).sum() - 1) < 0.01
    normals = (d * depth[..., None] - centre) / RADIUS
    core = discriminant / a > (0.6 * RADIUS) ** 2  # away from the rim, where a pixel spans much
    assert (core & inside).sum() > 100
    assert np.abs(picture.depth - depth)[core].max() < 0.01
    assert ((picture.normals * normals).sum(-1)[core] > np.cos(0.03)).all()


def test_side_light_comes_from_the_left_and_the_sky_from_everywhere(ball):
    ahead = Camera(70, 70, 32, 30, look_at((0, 0, 3.0), (0, 0, 0)), 64, 60)
    halves = {}
    for light in ("usual", "side", "ambient"):
        seen = Renderer(ball, light=light)(ball.vertices, ahead, 16, 0)
        inside = seen.mask == 1
        color = np.where(inside, seen.color.mean(-1), np.nan)
        halves[light] = np.nanmean(color[:, :32]), np.nanmean(color[:, 32:])
    left, right = halves["side"]
    assert left > 1.25 * right > 0
    assert halves["ambient"][0] == pytest.approx(halves["ambient"][1], rel=0.02)
    assert halves["ambient"][0] < min(halves["usual"])
    assert right == pytest.approx(halves["ambient"][1], rel=0.05)  # nothing else reaches it
    rows = np.flatnonzero(inside.any(1))
    upper, lower = (color[part][inside[part]].mean() for part in np.array_split(rows, 2))
    assert upper > lower + 0.03  # the sky is brighter than the ground


def test_color_is_white_where_the_mask_is_zero_and_blended_where_it_is_soft(picture):
    assert (picture.color[picture.mask == 0] == 1).all()
    soft = (picture.mask > 0) & (picture.mask < 1)
    assert soft.any()
    blended = picture.color >= 1 - picture.mask[..., None] - 1e-6
    assert blended.all() and picture.color.max() <= 1


@pytest.mark.parametrize("azimuth, elevation", [(0, 0.06), (-2.6, 0.4)])
def test_the_camera_sees_the_whole_surface(ball, azimuth, elevation):
    camera = camera_around(ball.vertices + [3.0, 1.0, -2.0], 64, azimuth, elevation)
    pixels = camera.project(ball.vertices + [3.0, 1.0, -2.0])
    assert (pixels > 0).all() and (pixels < 64).all()
    assert np.ptp(pixels, axis=0).max() > 40
