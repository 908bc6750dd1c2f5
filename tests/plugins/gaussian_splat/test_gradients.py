"""Derivatives of ``gaussian_splat`` agree: backward, forward, differences, and the kernels."""

import mitsuba as mi
import numpy as np
import pytest

PARAMETERS = ["data", "opacities", "sh_coeffs"]


@pytest.fixture(params=["window", "orthographic"])
def view(request, splats):
    return splats.SENSORS[request.param]()


@pytest.fixture
def smooth(splats):
    """A scene without cut-offs: every ellipsoid covers the picture, and none hides the rest.

    Where alpha falls to 1/255 inside the picture, differences contain a step that is not
    differentiated.
    """
    return splats.arrays(12, 2, scales=(1.2, 2.0), opacities=(0.15, 0.4))


@pytest.mark.parametrize("name", PARAMETERS)
def test_by_the_shapes_parameters(splats, smooth, view, name):
    scene = splats.scene(smooth)
    parameters = mi.traverse(scene)
    key = f"splats.{name}"
    start = np.array(parameters[key])
    along = np.random.default_rng(1).normal(size=start.shape).astype(np.float32)
    method = splats.integrator(srgb_primitives=True, depth=True)
    splats.agree_three_ways(
        lambda p: mi.render(scene, p, view, method),
        lambda u: mi.Float(start) + u * mi.Float(along),
        parameters,
        key,
    )


def test_by_the_sensors_pose(splats, smooth, view):
    scene = mi.load_dict({"type": "scene", "view": view, "splats": splats.ellipsoids(smooth)})
    parameters = mi.traverse(scene)
    start = mi.Transform4f(view.world_transform().matrix)
    method = splats.integrator(srgb_primitives=True)
    splats.agree_three_ways(
        lambda p: mi.render(scene, p, view, method),
        lambda u: mi.AffineTransform4f(
            mi.Transform4f().translate([u, 0.5 * u, -0.7 * u]).rotate([0.2, 1, 0.3], 57 * u) @ start
        ),
        parameters,
        "view.to_world",
    )


@pytest.mark.parametrize("name", ["x_fov", "principal_point_offset_y"])
def test_by_the_sensors_lens(splats, smooth, name):
    view = splats.SENSORS["window"]()
    scene = mi.load_dict({"type": "scene", "view": view, "splats": splats.ellipsoids(smooth)})
    parameters = mi.traverse(scene)
    start, key = parameters[f"view.{name}"][0], f"view.{name}"
    method = splats.integrator()
    splats.agree_three_ways(
        lambda p: mi.render(scene, p, view, method), lambda u: start + 10 * u, parameters, key
    )
