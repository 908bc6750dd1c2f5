"""An avatar in a Mitsuba scene."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
import torch

from gva_mi.avatar.stage import Proxy, Stage, StageOptions
from gva_mi.fit.renders import render_layer

rgb = lambda *values: {"type": "rgb", "value": list(values)}


@pytest.fixture(scope="module")
def scene_of(body_camera):
    """A function of further parts to a scene around the built-in body, seen by its camera."""
    from gva_mi.mesh.mesh_scene import load_plugins, sensor_of

    load_plugins()
    import mitsuba as mi

    floor = mi.ScalarTransform4f().translate([0, -1.4, 0]).rotate([1, 0, 0], -90).scale(3)

    def make(**parts):
        return {
            "type": "scene",
            "sensor": sensor_of(body_camera) | {"sampler": {"type": "multijitter"}},
            "floor": {
                "type": "rectangle", "to_world": floor,
                "bsdf": {"type": "diffuse", "reflectance": rgb(0.5, 0.5, 0.5)},
            },
            "sky": {"type": "constant", "radiance": rgb(0.6, 0.7, 0.9)},
        } | parts  # fmt: skip

    return make


def test_kept_light_keeps_the_persons_pixels_to_the_bit(known, turning, scene_of):
    from gva_mi_plugins.gaussian_splat.scene import SensorCamera

    pose = turning(3)[0][1]
    stage = Stage(scene_of(), known)
    stage.place(pose)
    color, alpha = (np.array(x) for x in stage.person(stage.gaussians(pose)))
    layer = render_layer(known, pose, SensorCamera.of(stage.others.sensor).camera)
    np.testing.assert_array_equal(color, layer[..., :3])
    np.testing.assert_array_equal(alpha, layer[..., 3])
    assert alpha.max() > 0.9


def test_a_person_who_is_elsewhere_in_the_scene_is_seen_from_there(known, scene_of):
    """Moving the avatar's world and the scene together changes nothing."""
    import mitsuba as mi

    from gva_mi.body.pose import Pose

    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [1, 0, 2]
    scene = scene_of()
    whole = Stage(scene, known, StageOptions("scene", bake=4)).render(Pose.rest())
    moved = mi.ScalarTransform4f(T)
    turned = {k: scene[k] | {"to_world": moved @ scene[k]["to_world"]} for k in ("sensor", "floor")}
    stage = Stage(scene | turned, known, StageOptions("scene", bake=4), T_scene_avatar=T)
    assert np.abs(np.array(stage.render(Pose.rest()) - whole)).mean() < 2e-3


def test_a_plane_mirror_shows_the_person_as_a_camera_behind_it_sees_it(known, turning, scene_of):
    """All of the picture is a mirror, in a grey sky; who stands behind it has no image."""
    import mitsuba as mi
    from gva_mi_plugins.gaussian_splat.integrator import to_srgb
    from gva_mi_plugins.gaussian_splat.scene import SensorCamera

    def mirrored(at):
        to_world = mi.ScalarTransform4f().translate(at.tolist()).rotate([0, 1, 0], 20).scale(9)
        mirror = {"type": "rectangle", "to_world": to_world, "bsdf": {"type": "conductor"}}
        sky = {"type": "constant", "radiance": rgb(0.2, 0.2, 0.2)}
        parts = scene_of(sky=sky, floor=mirror)
        return Stage(parts, known, StageOptions("kept", spp=1))

    pose, at = turning(3)[0][1], np.array([0.0, 0, -1.2])
    stage = mirrored(at)
    n = np.array([np.sin(np.radians(20)), 0, np.cos(np.radians(20))])
    M = np.eye(4)
    M[:3, :3] -= 2 * np.outer(n, n)
    M[:3, 3] = 2 * (n @ at) * n
    camera = SensorCamera.of(stage.others.sensor).camera
    picture = to_srgb(mi.TensorXf([0.2])).numpy()
    for T in (camera.T_camera_world @ M, camera.T_camera_world):
        layer = render_layer(known, pose, replace(camera, T_camera_world=T))
        assert layer[..., 3].max() > 0.9
        picture = layer[..., :3] + (1 - layer[..., 3:]) * picture
    np.testing.assert_allclose(np.array(stage.render(pose)), picture, atol=2e-3)

    stage = mirrored(-at)
    (mirror,) = stage.others.mirrors
    assert not stage.person(stage.gaussians(pose), mirror)[1].numpy().any()


@pytest.mark.parametrize("name", ["sky.radiance.value", "floor.bsdf.reflectance.value", "albedo"])
def test_gradients_by_light_and_reflectances(known, turning, scene_of, name):
    import mitsuba as mi

    pose = turning(3)[0][0]
    scene = scene_of(integrator={"type": "prb", "max_depth": 3})
    stage = Stage(scene, known, StageOptions("scene", bake=64, spp=64))
    start = stage.albedo if name == "albedo" else stage.params[name]
    start = type(start)(start)  # a copy: parameters are changed in place

    def total(u):
        moved = start * (1 + u)
        if name == "albedo":
            stage.albedo = moved
        else:
            stage.params[name] = moved
        return dr.mean(stage.render(pose, seed=3), axis=None)

    u = mi.Float(0)
    dr.enable_grad(u)
    dr.backward(total(u))
    step = 0.02
    ahead, back = (total(mi.Float(x)).array[0] for x in (step, -step))
    assert dr.grad(u)[0] == pytest.approx((ahead - back) / (2 * step), rel=5e-3)


def test_the_videos_shadows_are_not_counted_twice(known, turning, scene_of):
    """Under a white sky, in the pose of the video, the person has the colours of the video."""
    from gva_mi.avatar.stage import BRIGHTEST, LEAST_SKY

    pose = turning(3)[0][1]
    sky = {"type": "constant", "radiance": rgb(1, 1, 1)}
    outside = {k: v for k, v in scene_of(sky=sky).items() if k != "floor"}
    direct = {"type": "path", "max_depth": 2}
    stage = Stage(outside | {"path": direct}, known, StageOptions("scene"), filmed=pose)
    stage.place(pose)
    light, albedo = (x.numpy() for x in (stage.light(), stage.albedo))
    relative = light / light.mean()
    srgb = (0.5 + 0.28209479 * known.canonical.sh.detach().numpy()[:, 0]).clip(0)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    chosen = (relative > LEAST_SKY) & (albedo < BRIGHTEST) & (albedo > 0.02)
    off = np.abs((albedo * relative)[chosen] / linear[chosen] - 1)
    assert np.median(off) < 2e-3 and off.mean() < 0.02  # light and texture vary around a vertex
    assert relative.min() < 0.7 and chosen.mean() > 0.7


def test_the_proxy_is_the_outer_skin(known):
    """Also where it was re-initialised: with or without the surface of that time."""
    from gva_mi.avatar.reinit import ReinitOptions, reinitialise
    from gva_mi.avatar.surface import with_fingers

    found = reinitialise(known, ReinitOptions(alpha=0.04), torch.manual_seed(0))
    again = type(known).from_record(known.record())
    again.set_skin_weights(found.skin)
    proxy = Proxy.of(again, found.surface)
    moved = (proxy.vertices - found.skin.vertices).norm(dim=1)  # by smoothing
    assert moved.median() < 0.002 and moved.quantile(0.95) < 0.01
    assert len(proxy.faces) == len(with_fingers(found.surface, known.rig).faces)
    anew = Proxy.of(again).vertices
    assert torch.cdist(anew, proxy.vertices).min(1).values.mean() < 0.02
