"""The fixture ``splats``: small scenes of ellipsoids, sensors, and the same Gaussians."""

from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gva_mi.splat import Camera, Gaussians

SIZE = 32  # pixels
STEP = 3e-4  # of differences; all sizes are about 1
CROP = {"crop_offset_x": 5, "crop_offset_y": 3, "crop_width": 21, "crop_height": 26}


@pytest.fixture(scope="session")
def splats(scenes):  # whose fixture sets the variant and registers the plugins
    names = (arrays, unit, ellipsoids, scene, gaussians, sensor, integrator, picture, camera_of)
    names += (weights, total, loss, agree_three_ways)
    return SimpleNamespace(**{f.__name__: f for f in names}, SENSORS=SENSORS, CROP=CROP, SIZE=SIZE)


def arrays(n, degree, seed=0, scales=(0.08, 0.3), opacities=(0.3, 0.9)):
    """Make Gaussians about the origin, wxyz."""
    rng = np.random.default_rng(seed)
    return {"means": rng.uniform(-0.8, 0.8, (n, 3)), "quats": rng.normal(size=(n, 4)),
        "scales": rng.uniform(*scales, (n, 3)), "opacities": rng.uniform(*opacities, n),
        "sh": rng.normal(size=(n, (degree + 1) ** 2, 3)) * 0.4}  # fmt: skip


def unit(quats):
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def ellipsoids(g):
    """Convert to a Mitsuba shape, xyzw."""
    tensor = lambda x: mi.TensorXf(np.ascontiguousarray(x, np.float32))
    return {"type": "ellipsoids", "centers": tensor(g["means"]), "scales": tensor(g["scales"]),
        "quaternions": tensor(unit(g["quats"])[:, [1, 2, 3, 0]]),
        "opacities": tensor(g["opacities"][:, None]),
        "sh_coeffs": tensor(g["sh"].reshape(len(g["sh"]), -1))}  # fmt: skip


def scene(g, **others):
    return mi.load_dict({"type": "scene", "splats": ellipsoids(g)} | others)


def gaussians(g):
    """Convert to the kernels' Gaussians."""
    as_tensor = lambda x: mi.TensorXf(np.ascontiguousarray(x, np.float32))
    return Gaussians(**{k: as_tensor(unit(x) if k == "quats" else x) for k, x in g.items()})


def sensor(kind="perspective", film=None, **parameters):
    to_world = mi.ScalarTransform4f().look_at([0.4, 0.6, 4.0], [0, 0, 0], [0, 1, 0])
    if kind == "orthographic":
        to_world = to_world @ mi.ScalarTransform4f().scale([1.3, 1.1, 2.0])
    box = {"type": "box"}
    return mi.load_dict({"type": kind, "to_world": to_world,
        "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": box} | (film or {}),
        "sampler": {"type": "independent", "sample_count": 1}} | parameters)  # fmt: skip


SENSORS = {
    "perspective": lambda: sensor(fov=40.0),
    "window": lambda: sensor(
        fov=35.0,
        fov_axis="y",
        principal_point_offset_x=0.07,
        principal_point_offset_y=-0.11,
        film=CROP | {"width": 40},
    ),
    "orthographic": lambda: sensor("orthographic", film=CROP),
}


def integrator(**parameters):
    return mi.load_dict({"type": "gaussian_splat", "srgb_primitives": False} | parameters)


def picture(scene, view, **parameters):
    return np.array(mi.render(scene, sensor=view, integrator=integrator(**parameters)))


def camera_of(view):
    """Compute the camera from the sensor's own parameters, in float64."""
    p = mi.traverse(view)
    full, window = np.array(p["film.size"]), np.array(p["film.crop_size"])
    corner, M = np.array(p["film.crop_offset"]), np.array(p["to_world"].matrix, np.float64)
    M = M.reshape(4, 4)
    scale = np.linalg.norm(M[:3, :3], axis=0)
    T = np.diag([-1.0, -1.0, 1.0, 1.0]) @ np.linalg.inv(M @ np.diag([*(1 / scale), 1]))
    center = full / 2 - corner
    if view.class_name() == "PerspectiveCamera":
        f = full[0] / 2 / np.tan(np.radians(p["x_fov"][0]) / 2) * np.ones(2)
        offset = [p[f"principal_point_offset_{axis}"][0] for axis in "xy"]
        return Camera(*f, *(center - full * offset), T, *(int(n) for n in window))
    f = full[0] / 2 / scale[:2]
    return Camera(*f, *center, T, *(int(n) for n in window), "ortho")


def weights(shape):
    """Make smooth weights of every channel; opposite sides do not cancel."""
    y, x = np.mgrid[: shape[0], : shape[1]] / shape[0] - 0.5
    ramps = [x + 0.5 * y + 1, y - 0.3 * x + 1, 0.5 + x * y, 2 * x - y + 0.5, 0.3 + 0.1 * x]
    return np.stack(ramps[: shape[2]], axis=-1).astype(np.float32)


def total(image):
    """Evaluate the loss on the host, in float64."""
    return (np.array(image).astype(np.float64) * weights(image.shape)).sum()


def loss(image):
    return dr.sum(image * mi.TensorXf(weights(image.shape)), axis=None)


def agree_three_ways(render, make, parameters, name):
    """Assert that backward, forward and differences along u -> make(u) agree at u = 0."""
    found = []
    for direction in ("backward", "forward"):
        u = dr.opaque(mi.Float, 0)
        dr.enable_grad(u)
        parameters[name] = make(u)
        parameters.update()
        image = render(parameters)
        if direction == "backward":
            dr.backward(loss(image))
            found.append(dr.grad(u)[0])
        else:
            dr.forward(u)
            found.append(total(dr.grad(image)))
    values = []
    for u in (STEP, -STEP):
        parameters[name] = make(mi.Float(u))
        parameters.update()
        values.append(total(render(parameters)))
    backward, forward = found
    assert forward == pytest.approx(backward, rel=1e-5)
    assert (values[0] - values[1]) / (2 * STEP) == pytest.approx(backward, rel=3e-3)
