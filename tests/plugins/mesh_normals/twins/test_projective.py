"""The cross-check: two ways to the same image and the same gradients."""

import gva_mi  # noqa: F401  chooses libLLVM before Dr.Jit is imported

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest


@pytest.fixture(scope="module")
def projective(scenes):
    return mi.load_dict({"type": "mesh_normals_projective"})


@pytest.mark.parametrize("name", ["torus", "occluding", "facets", "open"])
def test_the_image_is_the_same(scenes, projective, name):
    scene, *_ = scenes.load(name)
    sensor, mine = scenes.camera(24), mi.load_dict({"type": "mesh_normals"})
    a, b = (
        np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=1024))
        for integrator in (projective, mine)
    )
    assert np.abs(a - b).max() < 0.08  # random rays in pixels with an edge
    assert np.abs(a - b).mean() < 2e-3


@pytest.mark.parametrize("name", ["sphere", "torus", "occluding", "open"])
def test_the_gradient_is_the_same(scenes, projective, name):
    """Backward through ``mi.render``: by the motions of the parts and by the vertices' places."""
    size = 24
    scene, parameters, parts = scenes.load(name)
    sensor, weight = scenes.camera(size), mi.TensorXf(scenes.weights(size))
    keys = [f"m{k}.vertex_positions" for k in range(len(parts))]
    dr.enable_grad([parameters[key] for key in keys])
    parameters.update()
    found = []
    for integrator in (projective, mi.load_dict({"type": "mesh_normals"})):
        dr.clear_grad([parameters[key] for key in keys])
        image = mi.render(scene, parameters, sensor=sensor, integrator=integrator, spp=1024)
        dr.backward(dr.sum(image * weight, axis=None))
        by_motion = []
        for key, (vertices, *_) in zip(keys, parts, strict=True):
            grad = np.array(dr.grad(parameters[key]), np.float64).reshape(-1, 3)
            by_motion += [grad[:, axis].sum() for axis in range(3)]
            by_motion += list((grad[:, :, None] * vertices[:, None]).sum(0).ravel())
        found.append(np.array(by_motion))
    assert np.linalg.norm(found[0] - found[1]) < 0.05 * np.linalg.norm(found[1])


def test_forward_mode_is_the_same(scenes, projective):
    size = 16
    scene, parameters, ((vertices, *_),) = scenes.load("sphere")
    sensor, images = scenes.camera(size), []
    for integrator in (projective, mi.load_dict({"type": "mesh_normals"})):
        x = mi.Float(0)
        dr.enable_grad(x)
        along = np.tile([1.0, 0.4, 0.2], len(vertices)).astype(np.float32)
        start = mi.Float(vertices.ravel().astype(np.float32))
        parameters["m0.vertex_positions"] = start + x * mi.Float(along)
        parameters.update()
        image = mi.render(scene, parameters, sensor=sensor, integrator=integrator, spp=1024)
        dr.forward(x)
        images.append(np.array(dr.grad(image)))
    assert np.abs(images[1]).max() > 1
    assert np.linalg.norm(images[0] - images[1]) < 0.1 * np.linalg.norm(images[1])


def test_what_cannot_be_rendered_is_refused(scenes, projective):
    scene, *_ = scenes.load("sphere")
    with pytest.raises(ValueError, match="'perspective'"):
        projective.render(scene, scenes.camera(8, "orthographic"))
    with pytest.raises(ValueError, match="'box'"):
        projective.render(scene, scenes.camera(8, rfilter={"type": "gaussian"}))
