"""Meshes as other programs write them: faces without area, seams, hard edges, turned normals."""

import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import ConvexHull

SPACE = {"type": "mesh_normals", "space": "world"}


@pytest.fixture(scope="module")
def integrator(scenes):
    return mi.load_dict({"type": "mesh_normals"})


def globe(rings=12, segments=16, radius=0.5):
    """A latitude-longitude grid of vertices: poles of many vertices, a seam, and flat faces."""
    theta = np.pi * np.arange(rings + 1) / rings
    phi = 2 * np.pi * (np.arange(segments + 1) % segments) / segments
    axes = np.sin(theta)[:, None] * np.cos(phi), np.cos(theta)[:, None] + 0 * phi
    vertices = np.stack([*axes, np.sin(theta)[:, None] * np.sin(phi)], -1)
    vertices[[0, -1]] = [[[0, 1, 0]], [[0, -1, 0]]]
    at = lambda i, j: i * (segments + 1) + j
    quads = [(at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j))
             for i in range(rings) for j in range(segments)]  # fmt: skip
    return radius * vertices.reshape(-1, 3), np.array(
        [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    )


def growth(scenes, vertices, motion):
    """By how many pixels the convex outline of moving points grows; in float64."""
    sensor = scenes.camera()
    pose = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
    focal = 24 / np.tan(np.radians(17))

    def area(step):
        x = (vertices + step * motion - pose[:3, 3]) @ pose[:3, :3]
        return ConvexHull(focal * x[:, :2] / x[:, 2:]).volume  # of two dimensions: the area

    return (area(1e-5) - area(-1e-5)) / 2e-5


def mask_growth(scenes, integrator, vertices, faces, motion):
    scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", vertices, faces)})
    view = integrator.view(scene, scenes.camera(), 4)
    change = view.tangent(mi.Vector3f(motion.T.astype(np.float32)))
    return float(np.array(change, np.float64)[..., 3].sum())


def with_flat_faces(vertices, faces, how):
    """Add faces whose corners lie on a line at the first edge of every face.

    ``beside``: with a new point in the middle of the edge, and nothing else. ``split``: the face on
    one side is cut there, and the flat face lies between the halves and the other side's edge.
    ``twice``: a half is split again, and has a flat face of its own. ``wound``: these are wound the
    other way.
    """
    v, f = [tuple(x) for x in vertices], [tuple(x) for x in faces]

    def middle(a, b):
        v.append(tuple((np.array(v[a]) + v[b]) / 2))
        return len(v) - 1

    for a, b, c in f[:]:
        m = middle(a, b)
        flat = [(a, b, m)]
        if how != "beside":
            f.remove((a, b, c))
            q = middle(a, m) if how != "split" else m
            f += [(m, b, c), (a, q, c), (q, m, c)] if q != m else [(m, b, c), (a, m, c)]
            flat += [(a, m, q)] if q != m else []
        f += [x[::-1] for x in flat] if how == "wound" else flat
    return np.array(v), np.array(f)


def test_the_outline_of_a_globe_with_poles_of_many_vertices(scenes, integrator):
    vertices, faces = globe()
    for motion in (vertices, np.tile([0.0, 0.0, 1.0], (len(vertices), 1))):
        exact = growth(scenes, vertices, motion)
        found = mask_growth(scenes, integrator, vertices, faces, motion)
        assert found == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("how", ["beside", "split", "twice", "wound"])
def test_faces_on_a_line_leave_the_outline_as_it_is(scenes, integrator, how):
    vertices, faces = with_flat_faces(*scenes.sphere(2, 4), how)
    crossed = np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2)))
    assert (np.linalg.norm(crossed, axis=1) < 1e-9).sum() >= 8
    for motion in (vertices, vertices * [0.3, -1, 0.5]):
        exact = growth(scenes, vertices, motion)
        found = mask_growth(scenes, integrator, vertices, faces, motion)
        assert found == pytest.approx(exact, rel=1e-5)


def test_useless_faces_change_nothing(scenes, integrator):
    vertices, faces = scenes.torus()
    more = faces[::7][:, [(0, 0, 1), (0, 1, 1), (2, 2, 2)]]
    weight, found = mi.TensorXf(scenes.weights(48)), []
    for every in (faces, np.concatenate([faces, more.reshape(-1, 3)])):
        scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", vertices, every)})
        view = integrator.view(scene, scenes.camera(), 1)
        found.append((np.array(view.image()), np.array(view.adjoint(weight))))
    for a, b in zip(*found, strict=True):
        assert np.abs(a - b).max() < 1e-5 * np.abs(a).max()


def test_a_face_may_lose_its_area_on_the_way(scenes, integrator):
    """The edges follow the vertices: the same as a mesh that was made so."""
    vertices, faces = scenes.sphere(2, 4)
    vertices, faces = with_flat_faces(vertices, faces, "split")
    open_ = vertices.copy()
    open_[-8:] *= 1.1
    scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", open_, faces)})
    parameters, weight = mi.traverse(scene), mi.TensorXf(scenes.weights(48))
    adjoint = lambda: np.array(integrator.view(scene, scenes.camera(), 1).adjoint(weight))
    before = adjoint()
    for place in (vertices, open_):
        parameters["m.vertex_positions"] = mi.Float(place.ravel().astype(np.float32))
        parameters.update()
        found = adjoint()
    np.testing.assert_array_equal(found, before)


def cylinder(path, sides=12, seam=True, normals=None, caps=False, turn=0.0):
    """A cylinder as .obj, split along a seam of textures; ``normals``: round, flat or none."""
    angle = 2 * np.pi * np.arange(sides) / sides
    lines = [f"v {0.4 * np.cos(a)} {y} {0.4 * np.sin(a)}" for y in (-0.5, 0.5) for a in angle]
    lines += [f"vt {k / sides} {y}" for y in (0, 1) for k in range(sides + 1)] + ["vt 2 2"]
    shift = np.pi / sides if normals == "flat" else 0
    lines += [f"vn {np.cos(a + shift)} 0 {np.sin(a + shift)}" for a in angle]

    def corner(k, y, side):
        t = k + y * (sides + 1) if seam else k % sides + y * (sides + 1)
        n = side if normals == "flat" else k % sides
        return f"{k % sides + y * sides + 1}/{t + 1}" + (f"/{n + 1}" if normals else "")

    for k in range(sides):
        a, b, c, d = (corner(j, y, k) for j, y in ((k, 0), (k, 1), (k + 1, 1), (k + 1, 0)))
        lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
        if caps:
            apart = lambda j, y: f"{j % sides + y * sides + 1}/{2 * sides + 3}"
            lines.append(f"f {apart(0, 1)} {apart(k + 1, 1)} {apart(k, 1)}")
    path.write_text("\n".join(lines) + "\n")
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], turn)
    return mi.load_dict({"type": "obj", "filename": str(path), "to_world": turned})


def pictures(scenes, mesh):
    """Ours and Mitsuba's normals, world space, and the pixels that show one facet each."""
    scene = mi.load_dict({"type": "scene", "m": mesh})
    sensor = scenes.camera(32)
    ours = np.array(mi.render(scene, sensor=sensor, integrator=mi.load_dict(SPACE), spp=4))
    theirs = mi.load_dict({"type": "aov", "aovs": "n:sh_normal"})
    theirs = np.array(mi.render(scene, sensor=sensor, integrator=theirs, spp=64))[..., -3:]
    inside = np.linalg.norm(theirs, axis=2) > 0.9999
    assert inside.sum() > 50
    return ours[..., :3], theirs, inside & (ours[..., 3] == 1)


@pytest.mark.parametrize("normals", [None, "round"])
def test_a_seam_of_textures_is_no_crease(scenes, integrator, tmp_path, normals):
    """The seam, turned to the camera, shows what the same cylinder shows without one."""
    found = []
    for seam in (False, True):
        mesh = cylinder(tmp_path / f"{seam}.obj", seam=seam, normals=normals)
        assert mesh.vertex_count() == 24 + 2 * seam
        parameters = mi.traverse(mesh)
        x, y, z = np.array(parameters["vertex_positions"]).reshape(-1, 3).T
        turned = np.stack([-z, y, x], 1)
        parameters["vertex_positions"] = mi.Float(turned.ravel())
        parameters.update()
        scene = mi.load_dict({"type": "scene", "m": mesh})
        view = integrator.view(scene, scenes.camera(), 1)
        inner = np.array(view.tangent(mi.Vector3f(np.stack([0 * x, y, 0 * x]))))
        found.append((np.array(view.image()), inner))
    for a, b in zip(*found, strict=True):
        assert np.abs(a - b).max() < 1e-5 * np.abs(a).max()


def test_hard_edges_of_a_file_stay(scenes, tmp_path):
    """Facets of 30 degrees by the file's normals, and the rim of a lid that textures split."""
    ours, theirs, inside = pictures(scenes, cylinder(tmp_path / "a.obj", normals="flat"))
    assert np.abs(ours - theirs)[inside].max() < 1e-3
    mesh = cylinder(tmp_path / "b.obj", caps=True, turn=50.0)
    scene = mi.load_dict({"type": "scene", "m": mesh})
    ours = mi.render(scene, sensor=scenes.camera(32), integrator=mi.load_dict(SPACE), spp=1)
    axis = np.array([0, np.cos(np.radians(50)), np.sin(np.radians(50))])
    along = (np.array(ours)[..., :3] @ axis)[np.array(ours)[..., 3] == 1]
    assert ((along > 0.9) | (np.abs(along) < 1e-3)).all()
    assert (along > 0.9).sum() > 50 and (along < 0.9).sum() > 50


def test_normals_point_where_mitsubas_do(scenes):
    turn = mi.ScalarTransform4f().rotate([0.36, 0.48, 0.8], 40)
    for shape, more in (
        ("cube", {}), ("cube", {"flip_normals": True}), ("rectangle", {"flip_normals": True}),
        ("cube", {"to_world": turn.scale([-0.4, 0.5, 0.5])}), ("cube", {"face_normals": True}),
        ("cube", {"face_normals": True, "flip_normals": True}),
        ("cube", {"to_world": turn.scale([-0.4, 0.5, 0.5]), "flip_normals": True}),
    ):  # fmt: skip
        more = {"to_world": turn.scale(0.5)} | more
        ours, theirs, inside = pictures(scenes, mi.load_dict({"type": shape, **more}))
        assert np.abs(ours - theirs)[inside].max() < 0.01, (shape, more)


def test_a_closed_mesh_wound_inside_out_has_derivatives_too(scenes, integrator):
    """It shows the same outside, with normals of the other sign."""
    vertices, faces = scenes.torus()
    motion = mi.Vector3f((vertices * [0.3, 1.0, -0.5]).T.astype(np.float32))
    found = []
    for wound in (faces, faces[:, ::-1]):
        scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", vertices, wound)})
        parts = integrator.view(scene, scenes.camera(), 16).tangent_parts(motion)
        found.append([np.array(x, np.float64) for x in parts])
    signs, weightings = np.array([-1, -1, -1, 1]), scenes.weightings(48, 4)
    for a, b in zip(*found, strict=True):
        a, b = ((weightings * x).sum((1, 2)) for x in (a, signs * b))
        assert np.linalg.norm(a - b) < 0.02 * np.linalg.norm(a)


def test_a_sheet_with_a_back_has_normals(scenes, integrator):
    """Faces that repeat others the other way round: either side may be seen, never NaN."""
    vertices = 0.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0.2], [-1, 1, 0.0]])
    front, weight = np.array([[0, 1, 2], [0, 2, 3]]), mi.TensorXf(scenes.weights(48, (3,)))
    found = []
    for faces in (front, np.concatenate([front, front[:, ::-1]])):
        scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", vertices, faces)})
        view = integrator.view(scene, scenes.camera(), 1)
        found.append((np.array(view.image()), np.array(view.adjoint(weight))))
    (one, grad), (both, grad_both) = found
    assert np.minimum(abs(one - both), abs(one + both))[..., :3].max() < 1e-5
    np.testing.assert_allclose(grad_both, grad, rtol=1e-4, atol=1e-4)


def everything(scenes, integrator, scene):
    """Image, gradient and forward derivative of a scene."""
    view = integrator.view(scene, scenes.camera(), 4)
    waves = np.sin(np.arange(3 * view.surface.topology.vertex_count, dtype=np.float32))
    tangent = view.tangent(mi.Vector3f(waves.reshape(3, -1)))
    return [
        np.array(x) for x in (view.image(), view.adjoint(mi.TensorXf(scenes.weights(48))), tangent)
    ]


def show(scene, positions):
    parameters = mi.traverse(scene)
    parameters["m.vertex_positions"] = mi.Float(np.ravel(positions).astype(np.float32))
    parameters.update()


def soup(vertices, faces):
    """The same surface, where no two faces share a vertex."""
    return vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)


def states(vertices, faces):
    """Positions of a closed mesh of split vertices, as an optimiser may move them."""
    rng = np.random.default_rng(0)
    yield vertices
    yield vertices * [1.1, 0.9, 1.0]  # together
    yield vertices + rng.normal(scale=0.02, size=vertices.shape)  # each on its own
    yield vertices * [1, 1, -1]  # turned inside out
    flat = vertices.copy()
    flat[faces[0, 0]] = flat[faces[0, 1:]].mean(0)
    yield flat
    flat[faces[0, 0]] = 2 * flat[faces[0, 1]] - flat[faces[0, 2]]  # another side is the longest
    yield flat
    near = vertices.copy()
    near[faces[1]] = near[faces[-1]]  # two faces come together
    yield near
    yield vertices


@pytest.mark.parametrize("kind", ["split", "smooth normals", "facets", "hard edges", "mirrored"])
def test_what_was_rendered_before_changes_no_bit(scenes, tmp_path, kind):
    """A scene that was rendered in other states is a new scene, also after other meshes."""

    def made():
        if kind in ("split", "facets"):
            return scenes.mesh("m", *soup(*scenes.torus(12, 8)), facets=kind == "facets")
        if kind == "mirrored":
            return mi.load_dict(
                {"type": "cube", "to_world": mi.ScalarTransform4f().scale([-0.4, 0.5, 0.5])}
            )
        return cylinder(tmp_path / "m.obj", 8,
            normals="round" if kind == "smooth normals" else "flat", caps=True)  # fmt: skip

    load = lambda: mi.load_dict({"type": "scene", "m": made()})
    kept, integrator = load(), mi.load_dict({"type": "mesh_normals"})
    everything(scenes, integrator, kept)  # with the file's normals, if there are any
    parameters = mi.traverse(kept)
    vertices, faces = (
        np.array(parameters[f"m.{x}"]).reshape(-1, 3) for x in ("vertex_positions", "faces")
    )
    for number, positions in enumerate(states(vertices.astype(np.float64), faces)):
        show(kept, positions)
        new = load()
        show(new, positions)
        fresh = everything(scenes, mi.load_dict({"type": "mesh_normals"}), new)
        for a, b in zip(everything(scenes, integrator, kept), fresh, strict=True):
            np.testing.assert_array_equal(a, b, err_msg=f"{kind}, state {number}")


def test_meshes_of_one_buffer_of_faces_are_told_apart(scenes, integrator):
    """Their seams differ, and their numbers in Mitsuba do; so do scenes of one mesh or of both."""
    vertices, faces = soup(*scenes.torus(12, 8))
    buffer, meshes = mi.UInt32(faces.ravel()), []
    for k, place in enumerate((vertices, vertices + np.arange(len(vertices))[:, None] % 7 / 200)):
        meshes.append(scenes.mesh(f"m{k}", place, faces))
        parameters = mi.traverse(meshes[-1])
        parameters["faces"] = buffer
        parameters.update()
    assert meshes[0].faces_buffer().index == meshes[1].faces_buffer().index
    for shown in ([0], [1], [0, 1], [1, 0], [0]):
        scene = mi.load_dict({"type": "scene"} | {f"s{k}": meshes[k] for k in shown})
        fresh = everything(scenes, mi.load_dict({"type": "mesh_normals"}), scene)
        for a, b in zip(everything(scenes, integrator, scene), fresh, strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_seam_that_opens_is_a_border(scenes):
    """The area of two triangles changes with a corner by half the opposite side, turned by 90°."""
    whole = np.array([[-5, -5], [3, -5], [3, 3], [-5, -5], [3, 3], [-5, 3]]) / 10
    faces, size = np.arange(6).reshape(2, 3), 64
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    look = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    sensor = mi.load_dict({"type": "orthographic", "to_world": look, "film": film})
    as_3d = lambda x: np.pad(x, ((0, 0), (0, 1)))
    scene = mi.load_dict({"type": "scene", "m": scenes.mesh("m", as_3d(whole), faces)})
    integrator, ones = (mi.load_dict({"type": "mesh_normals", "channels": "mask"}),
        mi.TensorXf(np.ones((size, size, 1), np.float32)))  # fmt: skip
    for apart in (0.0, 0.25, 0.0):
        x = whole + apart * np.array([[0, 0]] * 3 + [[-0.8, 1.0]] * 3)
        show(scene, as_3d(x))
        found = np.array(integrator.view(scene, sensor, 64).adjoint(ones)).T[:, :2]
        a, b = (x[np.roll(faces, -k, axis=1).ravel()] for k in (1, 2))
        exact = (size / 2) ** 2 / 2 * np.stack([a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]], 1)
        if apart == 0:  # copies of one place move as one
            one = np.array([0, 1, 2, 0, 2, 3])
            found, exact = (np.stack([np.bincount(one, y) for y in v.T]) for v in (found, exact))
        assert np.linalg.norm(found - exact) < 0.02 * np.linalg.norm(exact)
