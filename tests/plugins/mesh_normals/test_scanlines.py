"""The exact reference of the boundary term: its envelope, and known areas."""

import ast
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

MASK = 3
ROOT = Path(__file__).parents[3]


def boundary(references, mesh, sensor, lines=2000, seed=0):
    lens, generator = references.lens(sensor), np.random.default_rng(seed)
    return references.boundary(mesh, lens, lines, generator)


def frontal(size=32):
    """An orthographic view along -z of the square from -1 to 1."""
    to_world = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    return mi.load_dict({"type": "orthographic", "to_world": to_world, "film": film})


def polygon(corners, z=0.0):
    """A flat fan: vertices (V, 3) and faces (F, 3)."""
    v = np.column_stack([np.array(corners, float), np.full(len(corners), z)])
    return v, np.array([[0, k, k + 1] for k in range(1, len(v) - 1)])


def highest(x, u, at):
    """By looking at every segment at each place: the highest, -1 for none."""
    t = (at[:, None] - x[:, 0]) / (x[:, 1] - x[:, 0])
    height = np.where((t >= 0) & (t <= 1), u[:, 0] + t * (u[:, 1] - u[:, 0]), -np.inf)
    return np.where(np.isfinite(height).any(1), height.argmax(1), -1)


@pytest.mark.parametrize("count", [1, 2, 40])
def test_envelope_is_the_highest_segment_everywhere(references, count):
    generator = np.random.default_rng(count)
    x = np.sort(generator.uniform(0, 10, (count, 2)), axis=1)
    u = generator.normal(size=(count, 2))
    starts, owners = references.upper_envelope(x, u)
    assert (np.diff(starts) >= 0).all() and len(starts) == len(owners) + 1
    at = generator.uniform(starts[0], starts[-1], 5000)
    found = owners[np.searchsorted(starts, at, side="right") - 1]
    np.testing.assert_array_equal(found, highest(x, u, at))


def test_envelope_of_segments_that_share_an_end_or_hide_or_cross_at_one_place(references):
    meet = np.array([[0.0, 1], [1, 2], [1, 3]]), np.array([[0.0, 1], [1, 0], [1, -3]])
    assert references.upper_envelope(*meet)[1].tolist() == [0, 1, 2]
    hidden = np.array([[0.0, 3], [1, 2]]), np.array([[1.0, 1], [0, 0.5]])
    assert set(references.upper_envelope(*hidden)[1].tolist()) == {0}
    star = np.array([[0.0, 2]] * 3), np.array([[-1.0, 1], [0, 0], [1, -1]])
    starts, owners = references.upper_envelope(*star)
    assert owners.tolist() == [2, 0] and starts == pytest.approx([0, 1, 2])


@pytest.mark.parametrize("corners", [
    [(-0.5, -0.4), (0.6, -0.4), (0.6, 0.5), (-0.5, 0.5)],
    [(0.01, -0.7), (0.8, 0.02), (-0.03, 0.6), (-0.7, 0.1)],
    [(-0.8, -0.011), (0.7, 0.0), (-0.6, 0.013)],
])  # fmt: skip
def test_area_grows_by_twice_itself_as_a_polygon_swells(references, corners):
    v, f = polygon(corners)
    doubled = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])[:, 2]
    pixels = 16**2 * np.abs(doubled).sum() / 2
    change = boundary(references, references.MovingMesh(v, f, v), frontal())
    assert change[..., MASK].sum() == pytest.approx(2 * pixels, rel=2e-3)


def test_what_stands_behind_the_camera_is_refused(scenes, references):
    v, f = scenes.sphere()
    with pytest.raises(ValueError, match="before the camera"):
        boundary(references, references.MovingMesh(v + [0, 0, 9], f, v), scenes.camera(16))


@pytest.mark.parametrize("name", ["moving_mesh", "scanlines"])
def test_references_share_nothing_with_the_plugin(name):
    """Read from the imports: of the plugin's side only the making of a Mitsuba scene."""
    source = (ROOT / "gva_mi/gradcheck" / f"{name}.py").read_text()
    imported = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            imported |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
    ours = {x for x in imported if x.startswith("gva_mi") and "gva_mi.gradcheck" not in x}
    assert ours <= {
        "gva_mi.splat.Camera", "gva_mi.mesh.mesh_scene.load_plugins",
        "gva_mi.mesh.mesh_scene.scene_of",
    }  # fmt: skip
