"""Images and derivatives of ``mesh_normals``: primal, forward and backward over small scenes."""

import gva_mi  # noqa: F401  chooses libLLVM before Dr.Jit is imported

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

NORMALS, MASK = (0, 1, 2), (3,)
FINE = 610  # rays per pixel of the reference: a Fibonacci number fills the lattice most evenly
SCENES = ["sphere", "torus", "occluding", "facets"]


@pytest.fixture(scope="module")
def integrator(scenes):
    return mi.load_dict({"type": "mesh_normals"})


def directions(parts):
    """Ways to move all vertices: along, toward the camera, and a shear of the first mesh alone."""
    bent = [np.zeros_like(v) for v, *_ in parts]
    v = parts[0][0]
    bent[0] = np.stack([0.6 * v[:, 1] + v[:, 2], v[:, 0] * v[:, 1], v[:, 0]], axis=1)
    closer = [np.zeros_like(v) for v, *_ in parts]
    closer[0] += [0.0, 0.0, 1.0]
    aside = [np.tile([1.0, 0.5, 0.0], (len(v), 1)) for v, *_ in parts]
    return {"aside": aside, "closer": closer, "shear": bent}


def dot(a, b):
    return float((np.asarray(a, np.float64) * np.asarray(b, np.float64)).sum())


def test_sphere_shows_its_analytic_normals(scenes, integrator):
    v, f = scenes.sphere(60, 90)
    scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", v, f)})
    sensor = scenes.camera(32)
    image = np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=1))
    hits = image[..., 3] > 0
    ray, _ = sensor.sample_ray(0, 0, centres(32), mi.Point2f(0.5))
    o, d = np.array(ray.o).T, np.array(ray.d).T
    b = (o * d).sum(1)
    root = b**2 - (o**2).sum(1) + 0.25
    point = o + (-b - np.sqrt(np.maximum(root, 0)))[:, None] * d
    R = np.array(sensor.world_transform().matrix).reshape(4, 4)[:3, :3]
    expected = (2 * point @ R * [-1, -1, 1]).reshape(32, 32, 3)
    assert (hits == (root > 0).reshape(32, 32)).mean() > 0.99
    inside = (root > 0.02).reshape(32, 32)
    assert np.abs(image[..., :3] - expected)[inside].max() < 0.02


def centres(size):
    y, x = np.mgrid[:size, :size]
    return mi.Point2f(np.stack([x.ravel() + 0.5, y.ravel() + 0.5]).astype(np.float32) / size)


def test_nothing_seen_is_zero(scenes, integrator):
    v, f = scenes.sphere()
    scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", v + [50, 0, 0], f)})
    view = integrator.view(scene, scenes.camera(16), 1)
    assert not np.array(view.image()).any()
    assert not np.array(view.adjoint(mi.TensorXf(scenes.weights(16)))).any()


def test_spp_averages_towards_the_area_of_a_pixel(scenes, integrator):
    scene, *_ = scenes.load("torus")
    mask = [
        np.array(mi.render(scene, sensor=scenes.camera(24), integrator=integrator, spp=spp))[..., 3]
        for spp in (1, 64, 256)
    ]
    assert set(np.unique(mask[0])) == {0.0, 1.0}
    assert np.abs(mask[1] - mask[2]).max() < 0.05


def test_crop_is_a_part_of_the_whole(scenes, integrator):
    scene, *_ = scenes.load("occluding")
    whole = np.array(integrator.view(scene, scenes.camera(48), 1).image())
    window = dict(crop_offset_x=10, crop_offset_y=6, crop_width=24, crop_height=30)
    part = np.array(integrator.view(scene, scenes.camera(48, **window), 1).image())
    np.testing.assert_allclose(part, whole[6:36, 10:34], atol=2e-4)


@pytest.mark.parametrize("name", SCENES)
def test_forward_and_backward_are_transposes(scenes, integrator, name):
    scene, _, parts = scenes.load(name)
    view = integrator.view(scene, scenes.camera(), 1)
    image = scenes.weights(48)
    adjoint = np.array(view.adjoint(mi.TensorXf(image))).T
    for move in directions(parts).values():
        move = np.concatenate(move).astype(np.float32)
        tangent = np.array(view.tangent(mi.Vector3f(move.T)))
        scale = np.abs(tangent * image).sum() + 1e-3
        assert abs(dot(tangent, image) - dot(adjoint, move)) < 2e-5 * scale


def compare(scenes, integrator, name, size, spp, steps=(6e-3,)):
    """Yields channels, interior, boundary, central difference, and its total variation."""
    scene, parameters, parts = scenes.load(name)
    sensor = scenes.camera(size)
    view = integrator.view(scene, sensor, spp)
    terms = {
        channels: view.adjoint_parts(mi.TensorXf(scenes.weights(size, channels)))
        for channels in (MASK, NORMALS)
    }
    terms = {key: [np.array(term).T for term in pair] for key, pair in terms.items()}
    for move in directions(parts).values():
        difference = np.zeros((size, size, 4))
        for step in (*steps, *(-step for step in steps)):
            scenes.move(parameters, [v + step * d for (v, *_), d in zip(parts, move, strict=True)])
            image = np.array(integrator.view(scene, sensor, FINE).image(), np.float64)
            difference += image / (2 * step * len(steps))
        for channels, pair in terms.items():
            change = difference * scenes.weights(size, channels)
            interior, boundary = (dot(term, np.concatenate(move)) for term in pair)
            yield channels, interior, boundary, change.sum(), np.abs(change).sum()


@pytest.mark.parametrize("name", SCENES)
def test_gradients_match_central_differences(scenes, integrator, name):
    for _, interior, boundary, difference, variation in compare(scenes, integrator, name, 48, 16):
        tolerance = 0.03 * max(abs(interior), abs(boundary)) + 0.03 * variation
        assert abs(interior + boundary - difference) < tolerance


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_gradients_match_closely_on_many_pixels(scenes, integrator, name):
    """Interior and boundary of the normals cancel in part: the larger of them sets the scale.

    Several steps: where an edge lies along a row of pixels, one difference is off by its samples.
    """
    steps = (3e-3, 4e-3, 5e-3)
    for channels, interior, boundary, difference, variation in compare(
        scenes, integrator, name, 256, 16, steps
    ):
        bound = 0.03 if channels == MASK else 0.05
        scale = max(abs(interior), abs(boundary), variation / 4)
        assert abs(interior + boundary - difference) < bound * scale


def test_without_the_boundary_the_mask_has_no_gradient(scenes, integrator):
    scene, *_ = scenes.load("torus")
    view = integrator.view(scene, scenes.camera(), 1)
    interior, boundary = view.adjoint_parts(mi.TensorXf(scenes.weights(48, MASK)))
    assert not np.array(interior).any() and np.array(boundary).any()


def test_split_vertices_are_no_border(scenes, integrator):
    v, f = scenes.torus()
    joined = mi.load_dict({"type": "scene", "m0": scenes.mesh("m0", v, f)})
    soup = v[f.ravel()], np.arange(f.size).reshape(-1, 3)
    split = mi.load_dict({"type": "scene", "m0": scenes.mesh("m0", *soup)})
    grad = mi.TensorXf(scenes.weights(48, MASK))
    moved = []
    for scene in (joined, split):
        g = np.array(integrator.view(scene, scenes.camera(), 1).adjoint(grad)).T
        moved.append(g.astype(np.float64).sum(0))
    np.testing.assert_allclose(moved[0], moved[1], rtol=1e-4, atol=1e-4)


def test_open_meshes_have_borders(scenes, integrator):
    """A single square moved aside: its mask's gradient is that of four border edges."""
    v = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    f = np.array([[0, 1, 2], [0, 2, 3]])
    scene = mi.load_dict({"type": "scene", "m0": scenes.mesh("m0", v, f)})
    parameters, sensor = mi.traverse(scene), scenes.camera()
    weight = scenes.weights(48, MASK)
    g = np.array(integrator.view(scene, sensor, 1).adjoint(mi.TensorXf(weight))).T
    images = []
    for sign in (1, -1):
        scenes.move(parameters, [v + sign * 4e-3 * np.array([1.0, 0.3, 0])])
        images.append(np.array(integrator.view(scene, sensor, FINE).image(), np.float64))
    difference = dot((images[0] - images[1]) / 8e-3, weight)
    assert dot(g, np.tile([1.0, 0.3, 0], (4, 1))) == pytest.approx(difference, rel=0.03)


@pytest.mark.parametrize("name", ["torus", "occluding"])
def test_mi_render_backward_and_forward(scenes, integrator, name):
    scene, parameters, parts = scenes.load(name)
    sensor, weight = scenes.camera(), mi.TensorXf(scenes.weights(48))
    keys = [f"m{k}.vertex_positions" for k in range(len(parts))]
    expected = np.array(integrator.view(scene, sensor, 1).adjoint(weight)).T
    dr.enable_grad([parameters[key] for key in keys])
    parameters.update()
    image = mi.render(scene, params=parameters, sensor=sensor, integrator=integrator, spp=1)
    dr.backward(dr.sum(image * weight, axis=None))
    got = np.concatenate([np.array(dr.grad(parameters[key])).reshape(-1, 3) for key in keys])
    np.testing.assert_array_equal(got, expected)

    shift = dr.opaque(mi.Float, 0)
    dr.enable_grad(shift)
    for (v, *_), key in zip(parts, keys, strict=True):
        along_x = np.tile([1.0, 0.0, 0.0], len(v)).astype(np.float32)
        parameters[key] = mi.Float(v.ravel().astype(np.float32)) + shift * mi.Float(along_x)
    parameters.update()
    image = mi.render(scene, params=parameters, sensor=sensor, integrator=integrator, spp=1)
    dr.forward(shift)
    total = np.abs(expected[:, 0]).sum()
    assert (
        abs(dot(np.array(dr.grad(image)), scenes.weights(48)) - expected[:, 0].sum()) < 1e-4 * total
    )


def test_the_same_call_gives_the_same_bits(scenes, integrator):
    scene, *_ = scenes.load("occluding")
    weight = mi.TensorXf(scenes.weights(48))
    runs = []
    for threads in (dr.thread_count(), 1, dr.thread_count()):
        before = dr.thread_count()
        dr.set_thread_count(threads)
        view = integrator.view(scene, scenes.camera(), 4)
        runs.append((np.array(view.image()), np.array(view.adjoint(weight))))
        dr.set_thread_count(before)
    for image, grad in runs[1:]:
        np.testing.assert_array_equal(image, runs[0][0])
        np.testing.assert_array_equal(grad, runs[0][1])


def test_other_faces_are_noticed(scenes, integrator):
    sensor = scenes.camera(24)
    for name in ("sphere", "torus", "sphere"):
        scene, *_ = scenes.load(name)
        fresh = mi.load_dict({"type": "mesh_normals"})
        a, b = (np.array(which.view(scene, sensor, 1).image()) for which in (integrator, fresh))
        np.testing.assert_array_equal(a, b)


def test_what_cannot_be_rendered_is_refused(scenes, integrator):
    v, f = scenes.sphere()
    scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", v, f)})
    with pytest.raises(ValueError, match="triangle mesh"):
        integrator.view(mi.load_dict({"type": "scene", "s": {"type": "sphere"}}), scenes.camera())
    with pytest.raises(ValueError, match="filter must be 'box'"):
        integrator.view(scene, scenes.camera(rfilter={"type": "gaussian"}))
    with pytest.raises(ValueError, match="'perspective'"):
        film = {"type": "hdrfilm", "rfilter": {"type": "box"}}
        integrator.view(scene, mi.load_dict({"type": "orthographic", "film": film}))
    with pytest.raises(RuntimeError, match="edge_density"):
        mi.load_dict({"type": "mesh_normals", "edge_density": 0.0})
