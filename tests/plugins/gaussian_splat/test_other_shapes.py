"""``gaussian_splat`` with ``meshes`` = ``depth``: ellipsoids among surfaces."""

import mitsuba as mi
import numpy as np
import pytest

from gva_mi.splat.drjit_render import render

SKY = {"type": "constant", "radiance": {"type": "rgb", "value": [0.3, 0.5, 0.9]}}


def strip(left, right, z):
    """An upright rectangle between two values of x."""
    place = mi.ScalarTransform4f().translate([(left + right) / 2, 0, z])
    return {"type": "rectangle", "to_world": place.scale([(right - left) / 2, 4, 1])}


def ball(center=(0.2, 0, 0), radius=0.5, color=(0.7, 0.4, 0.2)):
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(color)}}
    return {"type": "sphere", "center": list(center), "radius": radius, "bsdf": bsdf}


def ahead(splats, **film):
    """A sensor that looks along -z from (0, 0, 4)."""
    to_world = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    return splats.sensor(fov=40.0, to_world=to_world, film=film)


def among(splats, **parameters):
    return splats.integrator(meshes="depth", nested={"type": "direct"}, **parameters)


@pytest.mark.parametrize("name", ["window", "orthographic"])
def test_depth_is_along_the_sensors_axis(splats, name):
    from gva_mi_plugins.gaussian_splat.scene import OtherShapes

    view, radius = splats.SENSORS[name](), 0.8
    scene = splats.scene(splats.arrays(1, 0), ball=ball((0, 0, 0), radius))
    camera = splats.camera_of(view)
    depth = np.array(OtherShapes.of(scene, view).depth(camera))
    hit = np.isfinite(depth)
    v, u = np.nonzero(hit)
    x, y = (u + 0.5 - camera.cx) / camera.fx, (v + 0.5 - camera.cy) / camera.fy
    z = depth[hit]
    points = np.stack([x, y, z + 0 * x], 1)
    if name != "orthographic":
        points[:, :2] *= z[:, None]
    T = np.linalg.inv(camera.T_camera_world)
    world = points @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(np.linalg.norm(world, axis=1), radius, atol=1e-4)
    assert 0.1 < hit.mean() < 0.9
    # the nearer of the two points
    normal = (camera.T_camera_world[:3, :3] @ world.T).T
    assert (normal[:, 2] < 0.1).all()


def shown_alone(splats, view, scene, **parts):
    """Return the nested integrator's picture without ellipsoids, and the surfaces' depth."""
    from gva_mi_plugins.gaussian_splat.scene import OtherShapes

    surfaces = mi.load_dict({"type": "scene", **parts})
    image = mi.render(surfaces, sensor=view, integrator=mi.load_dict({"type": "direct"}), spp=4)
    return np.array(image), OtherShapes.of(scene, view).depth(splats.camera_of(view))


@pytest.mark.parametrize("srgb", [False, True])
def test_composition(splats, srgb):
    """I = C + (1 - alpha) L in the primitives' space; alpha is that of both together."""
    g, view = splats.arrays(40, 1), ahead(splats, pixel_format="rgba")
    scene = splats.scene(g, ball=ball(), sky=SKY)
    method = among(splats, srgb_primitives=srgb)
    image = np.array(mi.render(scene, sensor=view, integrator=method, spp=4))
    L, limit = shown_alone(splats, view, scene, ball=ball(), sky=SKY)
    image_g = render(splats.gaussians(g), splats.camera_of(view), depth_limit=limit)
    C, through = image_g.color.numpy(), 1 - image_g.alpha.numpy()[..., None]
    to_srgb = lambda x: np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    convert = to_srgb if srgb else lambda x: x
    expected = C + through * convert(L[..., :3])
    np.testing.assert_allclose(convert(image[..., :3]), expected, atol=1e-5)
    np.testing.assert_allclose(image[..., 3:], 1 - through * (1 - L[..., 3:]), atol=1e-5)
    assert 0.1 < through.mean() < 0.9


def test_a_surface_may_move_and_the_scene_stays_unchanged(splats):
    g, view, method = splats.arrays(40, 1), ahead(splats), among(splats)
    g["means"][:, 2] *= 0.1
    scene = splats.scene(g, wall=strip(-9, 9, 1.0), sky=SKY)
    parameters = mi.traverse(scene)
    path = mi.load_dict({"type": "direct"})
    before = np.array(mi.render(scene, sensor=view, integrator=path, seed=3))
    hidden = np.array(mi.render(scene, sensor=view, integrator=method))
    after = np.array(mi.render(scene, sensor=view, integrator=path, seed=3))
    np.testing.assert_array_equal(before, after)
    parameters["wall.to_world"] = mi.Transform4f().translate([0, 0, -3]).scale([9, 9, 1])
    parameters.update()
    shown = np.array(mi.render(scene, sensor=view, integrator=method))
    fresh = splats.scene(g, wall=strip(-9, 9, -3.0), sky=SKY)
    expected = np.array(mi.render(fresh, sensor=view, integrator=among(splats)))
    assert np.abs(shown - hidden).max() > 0.1
    assert np.median(np.abs(shown - expected)) < 1e-6


PARAMETERS = ["splats.data", "splats.opacities", "splats.sh_coeffs", "wall.bsdf.reflectance.value"]


@pytest.mark.parametrize("name", PARAMETERS)
def test_derivatives(splats, name):
    """Backward, forward and differences agree, for the ellipsoids and the wall behind them."""
    g = splats.arrays(12, 1, seed=2, scales=(1.2, 2.0), opacities=(0.15, 0.4))
    g["means"][:, 2] = np.abs(g["means"][:, 2])
    wall = strip(-9, 9, -1.0) | {"bsdf": {"type": "diffuse"}}
    view, method = ahead(splats), among(splats, srgb_primitives=True)
    scene = splats.scene(g, wall=wall, sky=SKY)
    parameters = mi.traverse(scene)
    start, kind = np.array(parameters[name]), type(parameters[name])
    along = np.random.default_rng(1).normal(size=start.shape).astype(np.float32)
    splats.agree_three_ways(
        lambda p: mi.render(scene, p, view, method, spp=64),
        lambda u: kind(start) + u * kind(along),
        parameters,
        name,
    )


def test_other_films_than_rgb_raise(splats):
    scene = splats.scene(splats.arrays(4, 1), ball=ball(), sky=SKY)
    with pytest.raises(ValueError, match="RGB or RGBA"):
        among(splats).render(scene, ahead(splats, pixel_format="luminance"))
    cube = splats.scene(splats.arrays(4, 1), cube={"type": "cube"})
    nested = {"type": "mesh_normals"}  # of four channels
    with pytest.raises(ValueError, match="RGB or RGBA"):
        splats.integrator(meshes="depth", nested=nested).render(cube, ahead(splats))
