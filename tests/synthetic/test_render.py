"""Rendering a ball, whose silhouette, normals and depth are known: on white, and in a room."""

import numpy as np
import pytest

from gva_mi.mesh.mesh_scene import sensor_of
from gva_mi.splat import Camera, look_at
from gva_mi.synthetic.pictures.finishes import Finish
from gva_mi.synthetic.pictures.lights import LIGHTS, Light
from gva_mi.synthetic.pictures.render import Moment, Renderer, faces_seen
from gva_mi.synthetic.pictures.room import Room, draw_room

mi = pytest.importorskip("mitsuba")
RADIUS = 0.5
CAMERA = Camera(70, 70, 33.5, 30.25, look_at((0.4, 0.3, 3.0), (0.05, 0, 0)), 64, 60)
PHONE = Camera(60, 60, 32, 32, look_at((0, 1.2, 3.5), (0, 0.6, 0)), 64, 64)
UP = np.array([0, 0.7, 0], np.float32)


@pytest.fixture(scope="module")
def picture(ball):
    return Renderer(ball).expose([Moment(ball.vertices, CAMERA)], 16, 0)


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


def test_side_light_comes_from_the_left_and_the_sky_from_everywhere(ball, monkeypatch):
    monkeypatch.setitem(LIGHTS, "ambient", Light(()))
    ahead = Camera(70, 70, 32, 30, look_at((0, 0, 3.0), (0, 0, 0)), 64, 60)
    halves = {}
    for light in ("usual", "side", "ambient"):
        seen = Renderer(ball, light=light).expose([Moment(ball.vertices, ahead)], 16, 0)
        inside = seen.mask == 1
        color = np.where(inside, seen.color.mean(-1), np.nan)
        halves[light] = np.nanmean(color[:, :32]), np.nanmean(color[:, 32:])
    left, right = halves["side"]
    assert left > 1.25 * right > 0
    assert halves["ambient"][0] == pytest.approx(halves["ambient"][1], rel=0.02)
    assert halves["ambient"][0] < min(halves["usual"])
    assert right == pytest.approx(halves["ambient"][1], rel=0.05)  # nothing else reaches it
    upper, lower = (np.nanmean(half) for half in np.array_split(color, [30]))
    assert upper > lower + 0.03  # the sky is brighter than the ground


def test_a_light_is_the_same_in_a_scene_of_mitsuba(ball):
    camera = Camera(70, 70, 32, 32, look_at((0.4, 1.0, 3.0), (0, 0.9, 0)), 64, 64)
    sphere = {"type": "sphere", "center": [0, 0.9, 0], "radius": RADIUS}
    white = {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}}
    path = {"type": "path", "max_depth": 2, "hide_emitters": True}
    for name in ("usual", "right"):
        moment = Moment(ball.vertices + np.float32([0, 0.9, 0]), camera)
        seen = Renderer(ball, light=name).expose([moment], 16, 0)
        scene = {"type": "scene", "integrator": path, "ball": sphere | white}
        lit = mi.load_dict(scene | LIGHTS[name].emitters())
        image = np.array(mi.render(lit, sensor=mi.load_dict(sensor_of(camera)), spp=64))
        inside = seen.mask == 1
        for half in (slice(0, 32), slice(32, 64)):
            ours, theirs = (x[:, half][inside[:, half]] for x in (decoded(seen.color), image))
            ratio = ours.mean(0) / theirs.mean(0)
            assert ratio == pytest.approx(0.5, rel=0.015), name  # the ball's albedo


def decoded(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def test_color_is_white_where_the_mask_is_zero_and_blended_where_it_is_soft(picture):
    assert (picture.color[picture.mask == 0] == 1).all()
    soft = (picture.mask > 0) & (picture.mask < 1)
    assert soft.any()
    blended = picture.color >= 1 - picture.mask[..., None] - 1e-6
    assert blended.all() and picture.color.max() <= 1


@pytest.fixture(scope="module")
def room(ball):
    return draw_room(np.random.default_rng(0), ball.look.person, ball.vertices + UP, [PHONE])


@pytest.fixture(scope="module")
def renderer(ball, room):
    return Renderer(ball, room)


def test_rays_leave_a_room_through_its_nearest_side(renderer, room):
    import mitsuba as mi  # whose variant the renderer sets

    rng = np.random.default_rng(1)
    origin = rng.uniform(room.low + 0.1, room.high - 0.1, (500, 3))
    direction = rng.normal(size=(500, 3))
    direction[:20, 1] = 0
    far, side, u, v = (
        np.array(x) for x in room.exit(mi.Point3f(origin.T), mi.Vector3f(direction.T))
    )
    point, bounds = origin + far[:, None] * direction, np.stack([room.low, room.high])
    axis, end = np.divmod(side.astype(int), 2)
    rows = np.arange(500)
    assert np.allclose(point[rows, axis], bounds[end, axis], atol=1e-3)
    assert (point > room.low - 1e-3).all() and (point < room.high + 1e-3).all()
    across = np.array([[2, 1], [0, 2], [0, 1]])[axis]
    assert np.allclose(np.stack([u, v], 1), np.take_along_axis(point, across, 1), atol=1e-3)


def test_a_room_surrounds_person_and_camera_and_keeps_its_furniture_away(room, ball):
    points = ball.vertices + UP
    assert (points > room.low).all() and (points < room.high).all()
    assert (PHONE.position > room.low).all() and (PHONE.position < room.high).all()
    assert len(room.vertices) > 100 and room.finish.max() == len(room.finishes) - 1
    gap = np.abs(room.vertices - points.mean(0)).max(1) - 0.5
    assert gap.min() > 0.1


def test_a_room_is_behind_the_person_and_does_not_change_the_silhouette(renderer, ball):
    stands = [Moment(ball.vertices + UP, PHONE)]
    inside, white = renderer.expose(stands, 16, 0), Renderer(ball).expose(stands, 16, 0)
    for name in ("mask", "normals", "depth"):
        assert np.array_equal(getattr(inside, name), getattr(white, name)), name
    beside = inside.color[inside.mask == 0]
    assert beside.min() > 0 and beside.std() > 0.05 and np.isfinite(inside.color).all()
    again = renderer.expose(stands, 16, 0)
    assert np.array_equal(again.color, inside.color)
    hidden = renderer.expose(stands, 16, 0, shown=False)
    assert (hidden.color[hidden.mask == 0] == 1).all()
    core = hidden.mask == 1
    assert np.abs(hidden.color - inside.color)[core].mean() < 0.05  # under the same light


def test_the_person_throws_a_shadow_on_the_floor(ball):
    plain = Finish((0.5, 0.5, 0.5), rough=0.0)
    nothing = np.zeros((0, 3), np.float32)
    bare = Room(np.array([-3, 0, -3.0]), np.array([3, 3, 4.0]), nothing, nothing[:, :2],
        np.zeros((0, 3), int), np.zeros(0, int), (plain,) * 6, (1.0, 1.0, 1.0))  # fmt: skip
    render = Renderer(ball, bare)
    at = lambda y: Moment(ball.vertices + [0, y, 0], PHONE)
    near, far = (render.expose([at(y)], 16, 0).color for y in (0.51, 9))
    column, row = np.floor(PHONE.project(np.array([0.0, 0, 0.3]))).astype(int)
    below = (slice(row - 1, row + 2), slice(column - 2, column + 3))
    assert near[below].mean() < 0.85 * far[below].mean()
    assert np.abs(near - far)[:4].mean() < 0.02  # not far away, on the wall


def test_an_open_shutter_blurs_along_the_motion(renderer, ball):
    moved = lambda x: Moment(ball.vertices + UP + np.float32([x, 0, 0]), PHONE)
    still = renderer.expose([moved(0.0)], 16, 0)
    seen = renderer.expose([moved(x) for x in (-0.3, -0.1, 0.1, 0.3)], 4, 0)
    assert seen.mask.sum() == pytest.approx(still.mask.sum(), rel=0.03)
    across, along = seen.mask[:, 32], seen.mask[32]
    assert (across > 0).sum() <= (still.mask[:, 32] > 0).sum()
    assert (along > 0).sum() > (still.mask[32] > 0).sum() + 6
    assert {0.25, 0.5, 0.75, 1.0} <= set(np.round(along, 2))


def test_each_pixel_names_the_face_that_its_centre_shows(ball, picture):
    """The seen faces are those whose centre is where the pixel looks; the mask is where one is."""
    face = faces_seen(ball.vertices, ball.faces, CAMERA)
    assert ((face >= 0) == (picture.mask > 0.5))[np.abs(picture.mask - 0.5) > 0.4].all()
    rows, columns = np.nonzero(face >= 0)
    centres = ball.vertices[ball.faces[face[rows, columns]]].mean(1)
    off = CAMERA.project(centres.astype(float)) - np.stack([columns, rows], 1) - 0.5
    assert np.linalg.norm(off, axis=1).max() < 3
    depth = (centres @ CAMERA.T_camera_world[:3, :3].T + CAMERA.T_camera_world[:3, 3])[:, 2]
    assert (depth < np.linalg.norm(CAMERA.position)).all()  # the near half
