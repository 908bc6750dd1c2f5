"""``gaussian_splat`` in a scene's light: its proxy, and sensors that see it and past it."""

import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import torch

SKY = {"type": "constant", "radiance": 1.0}


def diffuse(albedo):
    return mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}})


@pytest.fixture(scope="module")
def proxy(scenes):
    """A function: albedo, and a place, to a mesh that sees itself."""

    def make(albedo=0.5, shift=0.0, shape="torus"):
        vertices, faces = getattr(scenes, shape)()
        properties = mi.Properties()
        properties["bsdf"] = diffuse(albedo)
        mesh = mi.Mesh("proxy", len(vertices), len(faces), props=properties)
        params = mi.traverse(mesh)
        params["vertex_positions"] = mi.Float(np.ravel(vertices + shift).astype(np.float32))
        params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
        params.update()
        return mesh

    return make


def light(mesh, depth, spp=64, **emitters):
    from gva_mi_plugins.gaussian_splat.lighting import ProxyLight, on_host

    scene = mi.load_dict({"type": "scene", "proxy": mesh} | emitters)
    vertices, faces = (on_host(mi.traverse(mesh)[x]) for x in ("vertex_positions", "faces"))
    baked = ProxyLight.of(scene, vertices, faces.astype(int))
    path = mi.load_dict({"type": "path", "max_depth": depth})
    return np.array(baked.on_vertices(path, spp))


def test_direct_light_does_not_depend_on_albedo_and_a_white_sky_gives_at_most_1(proxy):
    dark, bright = (light(proxy(albedo), 2, sky=SKY) for albedo in (0.2, 0.8))
    np.testing.assert_allclose(dark, bright, rtol=1e-5)
    assert dark.min() >= 0 and dark.max() < 1.05  # noise
    assert dark.min() < 0.7 < 0.9 < np.quantile(dark, 0.9)  # the inside of the ring is darker


def test_a_furnace_returns_its_albedo(proxy):
    """A convex surface in a sky of 1 shows its albedo, and so does a white one of any shape."""
    ball = light(proxy(0.7, shape="sphere"), 8, spp=256, sky=SKY)
    assert np.mean(ball) == pytest.approx(1, abs=0.01)
    assert np.mean(light(proxy(0.999), 200, spp=256, sky=SKY)) == pytest.approx(1, abs=0.01)


def test_light_is_linear_in_the_emitters(proxy):
    lamp = lambda x: {"type": "point", "position": [2, 2, 2], "intensity": x}
    once, twice = (light(proxy(), 3, lamp=lamp(x), sky=SKY | {"radiance": x}) for x in (0.5, 1.0))
    np.testing.assert_array_equal(2 * once, twice)


def test_vertices_take_the_light_of_median_brightness_around_them():
    from gva_mi_plugins.gaussian_splat.lighting import ProxyLight

    ring = np.array([[0, 1, 2], [1, 0, 2], [2, 0, 1]])
    light = mi.TensorXf([[1, 1, 1], [9, 0, 3], [0, 0, 1]])  # a firefly, and a fold
    assert ProxyLight(None, ring)._without_specks(light).numpy().tolist() == [[1, 1, 1]] * 3


def wall(**parts):
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(9),
    } | parts


def test_the_camera_sees_an_emitting_wall_as_without_the_proxy(splats, proxy):
    lamp = wall(emitter={"type": "area", "radiance": {"type": "rgb", "value": [0.5, 0.6, 0.7]}})
    others = mi.load_dict({"type": "scene", "wall": lamp})
    whole = mi.load_dict({"type": "scene", "wall": lamp, "proxy": proxy()})
    view, path = splats.sensor(fov=40.0), mi.load_dict({"type": "path"})
    past = mi.load_dict({"type": "behind_person", "view": view})
    past.others = others
    picture = lambda scene, sensor: np.array(mi.render(scene, sensor=sensor, integrator=path))
    np.testing.assert_array_equal(picture(whole, past), picture(others, view))
    assert (picture(whole, view) != picture(others, view)).any()


def test_a_proxy_far_away_changes_nothing_and_a_near_one_casts_a_shadow(splats, proxy):
    lamp = {"type": "directional", "direction": [0.4, -0.3, -1], "irradiance": 2.0}
    g, view = splats.arrays(40, 1), splats.sensor(fov=40.0)
    path = {"type": "path", "max_depth": 2}

    def picture(**parts):
        how = {"proxy": "proxy"} if parts else {}
        scene = splats.scene(g, wall=wall(), lamp=lamp, **parts)
        method = splats.integrator(meshes="depth", nested=path, **how)
        return np.array(mi.render(scene, sensor=view, integrator=method, spp=1))

    alone = picture()
    far, near = (picture(proxy=proxy(shift=[0, y, 0])) for y in (300, 0))
    np.testing.assert_allclose(far, alone, atol=1e-6)
    darker = near < 0.9 * alone
    assert 0.01 < darker.mean() < 0.5
    assert (near <= alone + 1e-5).all()


def test_without_light_ellipsoids_are_black_and_as_opaque_as_before(splats, proxy):
    g = splats.arrays(40, 1)
    view = splats.sensor(fov=40.0, film={"pixel_format": "rgba"})
    scene = splats.scene(g, proxy=proxy(), dark=SKY | {"radiance": 0.0})
    lit = splats.integrator(
        meshes="lit", proxy="proxy", nested={"type": "path", "hide_emitters": True}
    )
    image = np.array(mi.render(scene, sensor=view, integrator=lit, spp=1))
    alone = splats.picture(splats.scene(g), splats.sensor(fov=40.0, film={"pixel_format": "rgba"}))
    assert not image[..., :3].any()
    np.testing.assert_array_equal(image[..., 3], alone[..., 3])


def test_lit_colours_are_albedo_times_light(splats, proxy):
    """Ellipsoids on a convex proxy, under a white sky, show their albedo."""
    g = splats.arrays(60, 1, scales=(0.05, 0.1))
    g["means"] *= 0.5 / np.linalg.norm(g["means"], axis=1, keepdims=True)
    g["sh"][:, 1:] = 0
    g["sh"] = np.clip(g["sh"], -0.8, 0.8)
    view = splats.sensor(fov=40.0)
    scene = splats.scene(g, proxy=proxy(shape="sphere"), sky=SKY)
    lit = splats.integrator(meshes="lit", proxy="proxy", bake=256)
    image = np.array(mi.render(scene, sensor=view, integrator=lit, spp=1))
    expected = splats.picture(splats.scene(g), view, background=mi.ScalarColor3f(1.0))
    assert np.abs(image - expected).max() < 0.03


@pytest.mark.parametrize("parameters, message", [
    ({"meshes": "lit"}, "needs proxy"), ({"proxy": "proxy"}, "need meshes"),
    ({"meshes": "lit", "proxy": "bal"}, "id of a mesh .* got 'bal'; its shapes are .*proxy"),
])  # fmt: skip
def test_errors(splats, proxy, parameters, message):
    with pytest.raises((RuntimeError, ValueError), match=message):
        method = splats.integrator(**parameters)
        method.render(splats.scene(splats.arrays(4, 0), proxy=proxy(), sky=SKY), splats.sensor())


def test_the_example_of_light_lights_any_splats_with_a_mesh(scenes, splats, tmp_path, monkeypatch):
    """Two files as programs of others write them: ellipsoids on a ball, and the ball."""
    from gva_mi.splat import Gaussians
    from gva_mi.splat.formats.ply import save_ply

    page = (Path(__file__).parents[3] / "docs/plugins.md").read_text()
    page = page.partition("## Ellipsoids in the light")[2].partition("\n## ")[0]
    monkeypatch.chdir(tmp_path)
    g = splats.arrays(2000, 0, scales=(0.02, 0.05), opacities=(0.9, 0.95))
    g["means"] *= 0.8 / np.linalg.norm(g["means"], axis=1, keepdims=True)
    save_ply(
        tmp_path / "splats.ply", Gaussians(**{k: torch.from_numpy(x).float() for k, x in g.items()})
    )
    ball = scenes.mesh("ball", *scenes.sphere(radius=0.8))
    ball.add_attribute("vertex_color", 3, [0.5] * (3 * ball.vertex_count()))
    ball.write_ply("mesh.ply")
    (program,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names, small = {}, program.replace("320", "80").replace("256", "64").replace("spp=64", "spp=4")
    exec(compile(small, "plugins.md", "exec"), names)
    lit, kept = (np.array(names[name]) for name in ("lit", "kept"))
    ball = lit[25:35, 35:45].mean(0).mean(-1)
    assert ball[:3].mean() > 1.5 * ball[-3:].mean()  # the lamp is to the left
    assert np.abs(lit - kept)[60:].max() < 1e-4 < np.abs(lit - kept)[32].max()  # the same floor
    shadow = kept[45:60].mean(-1)
    assert shadow.min() < 0.3 * shadow.max()
