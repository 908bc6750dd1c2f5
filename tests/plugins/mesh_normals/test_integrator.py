"""Images and derivatives of ``mesh_normals``: primal, forward and backward over small scenes."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

MASK = (3,)
FINE = 610  # rays per pixel of the reference: a Fibonacci number fills the lattice most evenly
SPACE = {"type": "mesh_normals", "space": "world"}
SCENES = ["sphere", "torus", "occluding", "facets", "intersecting", "mirrored", "open", "fin"]


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
    moves = [np.concatenate(move).astype(np.float32) for move in directions(parts).values()]
    several = view.tangents(mi.Vector3f(move.T) for move in moves)
    for move, same in zip(moves, several, strict=True):
        tangent = np.array(view.tangent(mi.Vector3f(move.T)))
        np.testing.assert_array_equal(np.array(same), tangent)
        scale = np.abs(tangent * image).sum() + 1e-3
        assert abs(dot(tangent, image) - dot(adjoint, move)) < 2e-5 * scale


def errors(scenes, references, name, sensor, lines, points):
    """Relative errors of the mask, the normals and depth inside, and their boundary terms.

    Each is that of a vector: the derivatives of several linear functions of the image.
    """
    mesh, lens = scenes.moving(name), references.lens(sensor)
    exact = [references.interior(mesh, lens, 1e-5, points),
        references.boundary(mesh, lens, lines, np.random.default_rng(0))]  # fmt: skip
    scene, *_ = scenes.load(name)
    plugin = {"type": "mesh_normals", "channels": "normal, mask, depth"}
    view = mi.load_dict(plugin).view(scene, sensor, 16)
    motion = mi.Vector3f(mesh.motion.T.astype(np.float32))
    parts = [np.array(part, np.float64) for part in view.tangent_parts(motion)]
    found = {}
    for what, channels in (("normal", slice(0, 3)), ("mask", slice(3, 4)), ("depth", slice(4, 5))):
        w = scenes.weightings(sensor.film().size()[0])[..., channels]
        for term, a, b in zip(("interior", "boundary"), parts, exact, strict=True):
            a, b = ((w * x[..., channels]).sum((1, 2, 3)) for x in (a, b))
            found[what, term] = np.linalg.norm(a - b), np.linalg.norm(b)
    assert found.pop(("mask", "interior")) == (0, 0)
    if np.all(mesh.facets):
        # Normals of facets change only as the facets turn: too little to be a scale.
        error, _ = found.pop(("normal", "interior"))
        assert error < 0.02 * found["normal", "boundary"][1]
    return {key: error / scale for key, (error, scale) in found.items()}


# Together: outer contours, occlusion, facets, lines of intersection, borders, three faces an edge.
QUICK = ["occluding", "facets", "mirrored", "orthographic intersecting", "orthographic fin"]


@pytest.mark.parametrize("name", QUICK)
def test_gradients_match_the_references(scenes, references, name):
    *kind, name = name.split()
    found = errors(scenes, references, name, scenes.camera(48, *kind), 1000, 34)
    assert max(found.values()) < 0.05, found


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
@pytest.mark.parametrize("name", SCENES)
def test_gradients_match_the_references_closely_on_many_pixels(scenes, references, name, kind):
    found = errors(scenes, references, name, scenes.camera(192, kind), 4000, 144)
    assert max(found.values()) < 0.03, found


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


def test_ellipsoids_are_not_looked_at(scenes, integrator):
    """One scene feeds both plugins: also where its mesh has moved, or stands behind them."""
    v, f = scenes.torus()
    tensor = lambda *rows: mi.TensorXf(np.array(rows, np.float32))
    before_it = {"type": "ellipsoids", "centers": tensor([0, 0, 1], [0.2, 0, 1]),
        "scales": tensor([0.3] * 3, [0.3] * 3), "quaternions": tensor([0, 0, 0, 1], [0, 0, 0, 1]),
        "opacities": tensor([1], [1]), "sh_coeffs": tensor([1, 1, 1], [1, 1, 1])}  # fmt: skip
    sensor, weight = scenes.camera(), mi.TensorXf(scenes.weights(48))
    found = []
    for others in ({}, {"a": before_it}):
        scene = mi.load_dict({"type": "scene", **others, "m": scenes.mesh("m", v, f)})
        parameters = mi.traverse(scene)
        for shift in (0.0, 0.1):
            parameters["m.vertex_positions"] = mi.Float((v + shift).ravel().astype(np.float32))
            parameters.update()
            view = integrator.view(scene, sensor, 1)
            found.append((np.array(view.image()), np.array(view.adjoint(weight))))
    for alone, among in zip(found[:2], found[2:], strict=True):
        assert alone[0][..., 3].any()
        np.testing.assert_array_equal(alone[0], among[0])
        np.testing.assert_array_equal(alone[1], among[1])
    with pytest.raises(ValueError, match="the scene has no mesh"):
        integrator.view(mi.load_dict({"type": "scene", "a": before_it}), sensor)


def test_what_cannot_be_rendered_is_refused(scenes, integrator):
    v, f = scenes.sphere()
    scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", v, f)})
    with pytest.raises(ValueError, match="triangle mesh"):
        integrator.view(mi.load_dict({"type": "scene", "s": {"type": "sphere"}}), scenes.camera())
    with pytest.raises(ValueError, match="sample_border"):
        gaussian = {"rfilter": {"type": "gaussian"}, "sample_border": True}
        integrator.view(scene, scenes.camera(**gaussian))
    with pytest.raises(ValueError, match="'perspective' or 'orthographic'"):
        film = {"type": "hdrfilm", "rfilter": {"type": "box"}}
        integrator.view(scene, mi.load_dict({"type": "thinlens", "aperture_radius": 1.0,
                                             "fov": 40.0, "film": film}))  # fmt: skip
    for wrong in ({"edge_density": 0.0}, {"channels": "normals"}, {"space": "object"}):
        with pytest.raises(RuntimeError, match=f"{next(iter(wrong))} must be"):
            mi.load_dict({"type": "mesh_normals", **wrong})


def test_channels_come_in_the_order_asked_for(scenes):
    scene, _, parts = scenes.load("occluding")
    sensor = scenes.camera()
    every = mi.load_dict(SPACE | {"channels": "depth, normal, mask"})
    assert every.aov_names()[:3] == ["depth", "normal.X", "normal.Y"]
    image = np.array(every.view(scene, sensor).image())
    plain = np.array(mi.load_dict({"type": "mesh_normals"}).view(scene, sensor).image())
    R = np.array(sensor.world_transform().matrix).reshape(4, 4)[:3, :3] * [-1, -1, 1]
    np.testing.assert_allclose(image[..., 1:4], plain[..., :3] @ R.T, atol=1e-6)
    np.testing.assert_array_equal(image[..., 4], plain[..., 3])
    seen = image[..., 4] > 0
    assert ((image[..., 0] > 0) == seen).all()
    v = parts[0][0]  # the sphere is nearer
    nearest = ((v - [0.3, 0.4, 3.0]) @ (-np.array([0.3, 0.4, 3.0]) / 3.0414)).min()
    assert image[seen, 0].min() == pytest.approx(nearest, abs=0.01)


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
@pytest.mark.parametrize("space", ["camera", "world"])
def test_moving_the_sensor(scenes, kind, space):
    """Its gradient is that of differences, forward and backward, through ``mi.render``."""
    scene, *_ = scenes.load("occluding")
    integrator = mi.load_dict(
        {"type": "mesh_normals", "channels": "normal, mask, depth", "space": space}
    )
    sensor = scenes.camera(48, kind)
    scene_parameters, parameters = mi.traverse(scene), mi.traverse(sensor)
    T = mi.Matrix4f(parameters["to_world"].matrix)
    dr.eval(T)
    weight = mi.TensorXf(scenes.weightings(48)[0])
    axis = dr.normalize(mi.Vector3f(0.3, 1.0, -0.4))

    def loss(x, spp):
        motion = mi.Transform4f().translate(x * mi.Vector3f(0.5, -0.4, 0.6)).rotate(axis, 15 * x)
        parameters["to_world"] = mi.AffineTransform4f(motion @ mi.Transform4f(T))
        parameters.update()
        image = mi.render(scene, parameters, sensor=sensor, integrator=integrator, spp=spp)
        return dr.sum(image * weight, axis=None).array

    eps = 4e-3
    difference = (loss(mi.Float(eps), FINE)[0] - loss(mi.Float(-eps), FINE)[0]) / (2 * eps)
    gradients = []
    for run in (lambda x, y: dr.forward_from(x) or dr.grad(y), lambda x, y: dr.backward(y)):
        x = mi.Float(0)
        dr.enable_grad(x)
        y = loss(x, 16)
        forward = run(x, y)
        gradients.append((dr.grad(x) if forward is None else forward)[0])
    assert gradients[0] == pytest.approx(gradients[1], rel=1e-3)
    assert gradients[1] == pytest.approx(difference, rel=0.04)
    assert not any(dr.grad_enabled(value) for _, value in scene_parameters)


@pytest.mark.parametrize("name", ["tent", pytest.param("lanczos", marks=pytest.mark.slow)])
def test_reconstruction_filters(scenes, integrator, name):
    """The image is Mitsuba's own, and the gradient that of differences."""
    scene, parameters, parts = scenes.load("torus")
    sensor = scenes.camera(32, rfilter={"type": name})
    builtin = mi.load_dict({"type": "aov", "aovs": "d:depth"})
    mine = mi.load_dict({"type": "mesh_normals", "channels": "depth, mask"})
    image = np.array(mi.render(scene, sensor=sensor, integrator=mine, spp=256))
    theirs = np.array(mi.render(scene, sensor=sensor, integrator=builtin, spp=4096))[..., -1]
    eye = np.array(sensor.world_transform().matrix).reshape(4, 4)[:3, 3]
    assert np.abs(image[..., 0] - theirs).max() < 0.06 * np.linalg.norm(eye)

    weight = scenes.weights(32)
    view = integrator.view(scene, sensor, 16)
    g = np.array(view.adjoint(mi.TensorXf(weight)), np.float64).T
    v = parts[0][0]
    motion = np.stack([1 + v[:, 1], 0.5 - v[:, 0], v[:, 0]], axis=1)
    tangent = np.array(view.tangent(mi.Vector3f(motion.T.astype(np.float32))))
    assert dot(tangent, weight) == pytest.approx(dot(g, motion), rel=1e-4)
    images = []
    for step in (6e-3, -6e-3):
        scenes.move(parameters, [v + step * motion])
        images.append(np.array(integrator.view(scene, sensor, FINE).image(), np.float64))
    assert dot(g, motion) == pytest.approx(dot((images[0] - images[1]) / 12e-3, weight), rel=0.03)


def test_an_edge_that_passes_the_sensor_is_cut_at_its_near_plane(scenes, integrator):
    """A long strip under the camera, from before the image to behind the eye, moves sideways."""
    v = np.array([[-0.4, -0.3, 6.0], [0.5, -0.3, 6.0], [0.5, -0.3, -3.0], [-0.4, -0.3, -3.0]])
    f = np.array([[0, 1, 2], [0, 2, 3]])
    scene = mi.load_dict({"type": "scene", "m0": scenes.mesh("m0", v, f)})
    parameters, sensor = mi.traverse(scene), scenes.camera()
    weight, move = scenes.weights(48, MASK), np.array([1.0, 0.0, 0.0])
    g = np.array(integrator.view(scene, sensor, 16).adjoint(mi.TensorXf(weight))).T
    images = []
    for step in (4e-3, -4e-3):
        scenes.move(parameters, [v + step * move])
        images.append(np.array(integrator.view(scene, sensor, FINE).image(), np.float64))
    difference = dot((images[0] - images[1]) / 8e-3, weight)
    assert abs(difference) > 1
    assert dot(g, np.tile(move, (4, 1))) == pytest.approx(difference, rel=0.03)
