"""The first view of browsers, cameras that fit into their pictures, and films between views."""

import numpy as np

from gva_mi.fit.renders import CameraPath, shots
from gva_mi.viewer.cameras import film, fitted


def test_browsers_start_with_render_s_camera(known, motion, place, looking):
    usual = shots(CameraPath("static"), known.rig, motion)[0].camera
    camera = looking(place.position, usual.width, usual.height).to_camera()
    assert np.allclose(camera.T_camera_world, usual.T_camera_world, atol=1e-6)
    assert np.allclose(camera.K, usual.K)
    centre = known.rig.vertices.numpy()
    low, high = centre.min(0), centre.max(0)
    assert (place.look_at > low).all() and (place.look_at < high).all()
    assert np.allclose(usual.project(place.look_at), (usual.cx, usual.cy), atol=1e-4)


def test_a_fitted_camera_centres_the_whole_picture(camera):
    size = (100, 48)
    found = fitted(camera, *size)
    assert (found.width, found.height) == size
    scale = min(size) / 48
    points = np.random.default_rng(0).normal(size=(9, 3))
    moved = (camera.project(points) - 24) * scale + (size[0] // 2, size[1] // 2)
    assert np.abs(found.project(points) - moved).max() < 1.01


def around(place, looking, degrees, rise=0.0, distance=3.0):
    """A view from beside the person."""
    side = np.cross(place.up, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    ahead = np.cross(side, place.up)
    a, e = np.radians([degrees, rise])
    away = np.cos(e) * (np.sin(a) * side + np.cos(a) * ahead) + np.sin(e) * place.up
    return looking(place.look_at + distance * away)


def test_a_film_passes_every_view(place, looking):
    views = [around(place, looking, *x) for x in ((0, 0), (60, 20, 2), (150, 80), (170, -30, 5))]
    cameras = film(views, place.up, 13, 80, 64)
    for view, camera in zip(views, cameras[::4], strict=True):
        assert np.allclose(camera.T_camera_world, view.to_camera().T_camera_world, atol=1e-6)
        assert np.allclose(camera.K, view.to_camera().K)


def test_a_film_keeps_its_distance_and_takes_the_short_way(place, looking):
    cameras = film([around(place, looking, x) for x in (170, -170, -100)], place.up, 21, 80, 64)
    away = np.stack([camera.position for camera in cameras]) - place.look_at
    assert np.allclose(np.linalg.norm(away, axis=1), 3)
    assert np.allclose(away @ place.up, 0, atol=1e-6)
    steps = np.linalg.norm(np.diff(away, axis=0), axis=1)
    assert steps.sum() < 3 * np.radians(90) + 1e-6  # 20 degrees and 70, not 340
    middles = [camera.project(place.look_at) for camera in cameras]
    assert np.allclose(middles, (40, 32), atol=1e-4)
