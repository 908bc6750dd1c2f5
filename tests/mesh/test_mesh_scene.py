"""A mesh before the camera: OpenCV conventions through Mitsuba, gradients into torch."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from gva_mi.body.pose import Shape
from gva_mi.mesh.mesh_scene import MeshScene, scene_of, sensor_of
from gva_mi.splat import Camera


@pytest.mark.parametrize("fy", [150.0, 190.0])
def test_a_ball_is_seen_where_the_camera_projects_it(camera, fy):
    rotation = camera.T_camera_world
    view = Camera(150.0, fy, 37.0, 22.0, rotation, 80, 56)
    where = camera.position + rotation[:3, :3].T @ [0.1, 0.05, 2.0]
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    vertices, faces = torch.tensor(ball.vertices + where).float(), torch.tensor(ball.faces)
    image = MeshScene(faces, vertices).render(vertices, view).numpy()
    mask, normals = image[..., 3], image[image[..., 3] > 0][:, :3]
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5 and normals[:, 2].max() < 0
    rows, columns = np.nonzero(mask)
    for axis, places in enumerate((columns, rows)):  # x to the right, y down
        assert np.corrcoef(places, normals[:, axis])[0, 1] > 0.95
    seen = np.array([columns.mean() + 0.5, rows.mean() + 0.5])
    assert np.abs(seen - view.project(where)).max() < 0.15
    assert np.ptp(rows) / np.ptp(columns) == pytest.approx(fy / 150, abs=0.2)


def test_gradient_is_that_of_the_pose_it_was_rendered_in(scene, body, camera, true_pose):
    """Also where another pose was rendered before the backward pass."""
    shape = Shape(torch.zeros(10))
    vertices = [body(true_pose[k], shape).vertices[0].detach() for k in range(2)]
    weight = torch.linspace(-1, 1, 96)[None, :, None].expand(96, 96, 4)

    def gradient(other):
        leaf = vertices[0].clone().requires_grad_()
        image = scene.render(leaf, camera)
        if other:
            scene.render(vertices[1], camera)
        (image * weight).sum().backward()
        return leaf.grad

    assert gradient(False).abs().sum() > 0
    assert torch.equal(gradient(False), gradient(True))


def test_the_mask_alone_is_that_of_the_whole_picture(scene, body, camera, true_pose):
    """Its pixels and its gradient, although neither normals nor the interior are computed."""
    vertices = body(true_pose[0], Shape(torch.zeros(10))).vertices[0].detach().requires_grad_()
    weight = torch.linspace(-1, 1, 96)[None, :, None].expand(96, 96, 1)
    whole, alone = scene.render(vertices, camera), scene.render(vertices, camera, normals=False)
    assert torch.equal(alone, whole[..., 3:])
    grads = [
        torch.autograd.grad((mask * weight).sum(), vertices)[0] for mask in (whole[..., 3:], alone)
    ]
    assert torch.equal(*grads) and grads[0].any()


def test_an_instance_is_seen_as_the_mesh_itself_wherever_it_moved(scene, body, camera, true_pose):
    import mitsuba as mi

    plugin = {"type": "mesh_normals", "intersections": False, "flat_faces": False}
    integrator, sensor = mi.load_dict(plugin), mi.load_dict(sensor_of(camera))
    weight = torch.linspace(-1, 1, 96)[None, :, None].expand(96, 96, 4)
    for k in range(2):
        vertices = body(true_pose[k], Shape(torch.zeros(10))).vertices[0].detach().requires_grad_()
        image = scene.render(vertices, camera)
        (grad,) = torch.autograd.grad((image * weight).sum(), vertices)
        alone = integrator.view(scene_of(body.faces, vertices.detach()), sensor)
        assert torch.equal(image, alone.image().torch())
        expected = alone.adjoint(mi.TensorXf(weight.contiguous())).torch().T
        torch.testing.assert_close(grad, expected, rtol=1e-3, atol=1e-3)


def test_wrong_vertices_and_cameras_are_refused(scene, body, camera):
    with pytest.raises(ValueError, match="must be a pinhole, got fisheye"):
        scene.render(body.v_template, replace(camera, model="fisheye"))
    other = replace(camera, fy=1.01 * camera.fy)
    with pytest.raises(ValueError, match="crops of one picture"):
        scene.render_crops(body.v_template, camera, [other])
    with pytest.raises(ValueError, match="float32"):
        scene.render(body.v_template.double(), camera)
    with pytest.raises(ValueError, match="vertices must be"):
        scene.render(body.v_template[1:], camera)


def scaled(camera, scale):
    intrinsics = {name: scale * getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, **intrinsics)


@pytest.fixture
def whole(camera):
    return scaled(camera, 2.5).cropped(5, 10, 230, 220)


@pytest.fixture
def closer(camera):
    """A part of the picture at twice its resolution."""
    return scaled(camera, 5).cropped(210, 62, 70, 83)


def test_crops_seen_together_are_what_each_camera_sees(scene, body, whole, closer):
    with torch.no_grad():
        together = scene.render_crops(body.v_template, whole, [whole, closer])
        alone = [scene.render(body.v_template, view) for view in (whole, closer)]
    assert torch.equal(together[0], alone[0])
    assert together[1].shape == alone[1].shape and bool(alone[1].any())
    assert float((together[1] - alone[1]).abs().mean()) < 1e-5


def smooth(view, generator):
    """Weights (H, W, 4) that change within a few pixels."""
    noise = torch.rand(4, view.height, view.width, generator=generator)
    return torch.nn.functional.avg_pool2d(noise, 5, 1, 2).permute(1, 2, 0)


def test_the_gradient_of_a_crop_is_the_same_alone_and_together(scene, body, whole, closer):
    """Along motions of the whole body."""
    generator = torch.Generator().manual_seed(3)
    weights = smooth(closer, generator)
    turns = torch.randn(2, 1, 3, generator=generator)

    def slopes(image_of):
        x = body.v_template.clone().requires_grad_()
        (grad,) = torch.autograd.grad((image_of(x) * weights).sum(), x)
        turned = torch.linalg.cross(turns, body.v_template[None])
        return torch.cat([grad.sum(0), (turned * grad).sum((1, 2))])

    alone = slopes(lambda x: scene.render(x, closer))
    together = slopes(lambda x: scene.render_crops(x, whole, [closer])[0])
    assert float((together - alone).norm()) < 0.03 * float(alone.norm())


def test_vertices_that_come_apart_show_what_a_new_mesh_shows(camera):
    """A ball of faces that share no vertex: closed, then parted, then closed again."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    soup = torch.tensor(ball.triangles.reshape(-1, 3) + [0.0, 0.0, 2.0]).float()
    faces, noise = torch.arange(len(soup)).view(-1, 3), torch.randn(soup.shape).mul(0.01)
    view, kept = Camera(150.0, 150.0, 32.0, 32.0, np.eye(4), 64, 64), MeshScene(faces, soup)
    for vertices in (soup, soup + noise, soup):
        found = []
        for scene in (kept, MeshScene(faces, vertices)):
            leaf = vertices.clone().requires_grad_()
            image = scene.render(leaf, view)
            (grad,) = torch.autograd.grad((image * torch.linspace(-1, 1, 64)[:, None]).sum(), leaf)
            found.append((image.detach(), grad))
        assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))
