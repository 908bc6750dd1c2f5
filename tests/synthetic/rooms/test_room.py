"""A ball in a room: seen as on white, behind it the room, below it a shadow."""

import numpy as np
import pytest

from gva_mi.splat import Camera, look_at
from gva_mi.synthetic.render import Moment, Renderer
from gva_mi.synthetic.rooms.finishes import Finish
from gva_mi.synthetic.rooms.room import Room, draw_room

pytest.importorskip("mitsuba")
CAMERA = Camera(60, 60, 32, 32, look_at((0, 1.2, 3.5), (0, 0.6, 0)), 64, 64)
UP = np.array([0, 0.7, 0], np.float32)


@pytest.fixture(scope="module")
def room(ball):
    return draw_room(np.random.default_rng(0), ball.look, ball.vertices + UP, [CAMERA])


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
    assert (CAMERA.position > room.low).all() and (CAMERA.position < room.high).all()
    assert len(room.vertices) > 100 and room.finish.max() == len(room.finishes) - 1
    gap = np.abs(room.vertices - points.mean(0)).max(1) - 0.5
    assert gap.min() > 0.1


def test_a_room_is_behind_the_person_and_does_not_change_the_silhouette(renderer, ball):
    inside = renderer(ball.vertices + UP, CAMERA, 16, 0)
    white = Renderer(ball)(ball.vertices + UP, CAMERA, 16, 0)
    for name in ("mask", "normals", "depth"):
        assert np.array_equal(getattr(inside, name), getattr(white, name)), name
    beside = inside.color[inside.mask == 0]
    assert beside.min() > 0 and beside.std() > 0.05 and np.isfinite(inside.color).all()
    again = renderer(ball.vertices + UP, CAMERA, 16, 0)
    assert np.array_equal(again.color, inside.color)
    hidden = renderer.expose([Moment(ball.vertices + UP, CAMERA)], 16, 0, shown=False)
    assert (hidden.color[hidden.mask == 0] == 1).all()
    core = hidden.mask == 1
    assert np.abs(hidden.color - inside.color)[core].mean() < 0.05  # under the same light


def test_the_person_throws_a_shadow_on_the_floor(ball):
    plain = Finish((0.5, 0.5, 0.5), rough=0.0)
    nothing = np.zeros((0, 3), np.float32)
    bare = Room(
        np.array([-3, 0, -3.0]), np.array([3, 3, 4.0]), nothing, nothing[:, :2],
        np.zeros((0, 3), int), np.zeros(0, int), (plain,) * 6, (1.0, 1.0, 1.0),
    )  # fmt: skip
    render = Renderer(ball, bare)
    near, far = (render(ball.vertices + [0, y, 0], CAMERA, 16, 0).color for y in (0.51, 9))
    column, row = np.floor(CAMERA.project(np.array([0.0, 0, 0.3]))).astype(int)
    below = (slice(row - 1, row + 2), slice(column - 2, column + 3))
    assert near[below].mean() < 0.85 * far[below].mean()
    assert np.abs(near - far)[:4].mean() < 0.02  # not far away, on the wall


def test_an_open_shutter_blurs_along_the_motion(renderer, ball):
    moved = lambda x: Moment(ball.vertices + UP + np.float32([x, 0, 0]), CAMERA)
    still = renderer.expose([moved(0.0)], 16, 0)
    seen = renderer.expose([moved(x) for x in (-0.3, -0.1, 0.1, 0.3)], 4, 0)
    assert seen.mask.sum() == pytest.approx(still.mask.sum(), rel=0.03)
    across, along = seen.mask[:, 32], seen.mask[32]
    assert (across > 0).sum() <= (still.mask[:, 32] > 0).sum()
    assert (along > 0).sum() > (still.mask[32] > 0).sum() + 6
    assert {0.25, 0.5, 0.75, 1.0} <= set(np.round(along, 2))


def test_a_room_is_as_quiet_beside_the_person_as_around(renderer, ball):
    """Fewer rays beside the person must not show as a rectangle of noise."""
    seen = [renderer(ball.vertices + UP, CAMERA, 16, seed) for seed in range(6)]
    noise = np.std([image.color.mean(-1) for image in seen], axis=0)
    bare = seen[0].mask == 0
    rows, columns = (np.flatnonzero((~bare).any(axis)) for axis in (1, 0))
    window = np.zeros_like(bare)
    window[rows[0] - 1 : rows[-1] + 2, columns[0] - 1 : columns[-1] + 2] = True
    inside, outside = noise[bare & window].mean(), noise[bare & ~window].mean()
    assert outside < 0.02 and outside < 2.5 * inside
