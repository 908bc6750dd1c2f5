"""What one camera can see: derivatives in forward mode, and laws of the covariance."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.so3 import compose
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.image_evidence import MaskAndNormals
from gva_mi.refine.uncertainty import (
    TURNS,
    Blocks,
    Posterior,
    blocks,
    covariance_of,
    motions,
    noise_scales,
    totals,
)
from gva_mi.splat import Camera

SHIFT, BETAS = slice(TURNS, TURNS + 3), slice(TURNS + 3, TURNS + 13)
F64 = torch.float64


@pytest.fixture(scope="module")
def person(coarse, true_pose):
    """A body in float64, one frame's pose, its shape and its offsets."""
    offsets = 0.02 * coarse.v_template
    betas = torch.tensor([0.5, -1.0] + 8 * [0.2])
    exact = copy.deepcopy(coarse).double()
    return exact, true_pose[[0]].to(F64), Shape(betas.double()), offsets.double()


@pytest.fixture(scope="module")
def stage1(true_pose, camera):
    return Stage1Poses.of(true_pose, [0], camera)


@pytest.fixture(scope="module")
def moving(person, stage1):
    body, pose, shape, offsets = person
    return motions(body, stage1, pose, shape, offsets)


@pytest.fixture(scope="module")
def seen(clip, outline_of, coarse, true_pose):
    points = coarse(true_pose[[0]], clip.shape).vertices[0]
    return MaskAndNormals.of(outline_of(next(clip.frames())), 1.0, points)


@pytest.fixture(scope="module")
def shown(coarse, person, moving, seen):
    """The scene, the body's vertices, and the evidence in blocks."""
    _, pose, shape, offsets = person
    scene = MeshScene(coarse.faces, coarse.v_template)
    single = pose.to(torch.float32), Shape(shape.betas.float()), offsets.float()
    vertices = coarse(*single).vertices[0]
    return scene, vertices, blocks(scene, vertices, moving.vertices, seen)


def moved(person, stage1, unknown, step):
    """Vertices (V, 3) after a step of one unknown."""
    body, pose, shape, offsets = person
    turns, shift, betas = torch.zeros(1, 55, 3).double(), torch.zeros(1, 3).double(), shape.betas
    if unknown < TURNS:
        turns[0, unknown // 3, unknown % 3] = step
    elif unknown < TURNS + 3:
        shift[0, unknown - TURNS] = step
    else:
        betas = betas + step * torch.eye(10, dtype=F64)[unknown - TURNS - 3]
    local = (stage1.R_joint_camera.double() @ turns[..., None])[..., 0]
    place = pose.transl + shift @ stage1.R_camera_world.double()
    turned = Pose(compose(pose.rotations, local), place, pose.expression)
    return body(turned, Shape(betas), offsets).vertices[0]


UNKNOWNS = {"pelvis": 1, "knee": 3 * JOINTS.index("left_knee"),
    "elbow": 3 * JOINTS.index("left_elbow") + 2, "depth": TURNS + 2, "beta": TURNS + 3}  # fmt: skip


@pytest.mark.parametrize("unknown", UNKNOWNS.values(), ids=UNKNOWNS)
def test_the_body_moves_as_central_differences_say(unknown, person, stage1, moving):
    step = 1e-5
    ends = [moved(person, stage1, unknown, s) for s in (step, -step)]
    torch.testing.assert_close(
        moving.vertices[unknown], (ends[0] - ends[1]) / (2 * step), rtol=1e-6, atol=1e-8
    )


def test_the_picture_changes_as_its_gradient_says(person, moving, shown, seen):
    """<J dx, w> = <dx, Jᵀ w>: forward mode and backward mode of the plugin are transposes."""
    scene, vertices, _ = shown
    w = torch.randn(*seen.mask.shape, 4, generator=torch.Generator().manual_seed(1))
    x = vertices.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((scene.render(x, seen.camera) * w).sum(), x)
    some = moving.vertices[list(UNKNOWNS.values())]
    for dx, change in zip(some, scene.tangents(vertices, seen.camera, some), strict=True):
        size = float(change.norm() * w.norm())
        assert float((change * w).sum()) == pytest.approx(
            float((dx.float() * gradient).sum()), abs=1e-5 * size
        )


def test_the_mask_changes_as_central_differences_say(person, stage1, moving, shown, seen):
    """By sums over blocks; the differences are of pictures with 64 rays a pixel.

    ``gva-mi gradcheck normals`` checks the normals, with references that are finer than these.
    """
    scene, vertices, _ = shown
    camera, k = seen.camera, 8
    enlarged = {name: k * getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
    finer = replace(camera, width=k * camera.width, height=k * camera.height, **enlarged)
    shrunk = lambda image: image.unflatten(1, (-1, k)).mean(2).unflatten(0, (-1, k)).mean(1)
    unknown, step = TURNS, 0.4 / camera.fx  # to the side
    ends = [moved(person, stage1, unknown, s).float() for s in (step, -step)]
    high, low = (shrunk(scene.render(x, finer).double()) for x in ends)
    (change,) = scene.tangents(vertices, camera, moving.vertices[[unknown]])
    found, truth = (totals(x, 8)[..., 3] for x in (change, (high - low) / (2 * step)))
    assert float((found - truth).norm()) < 0.1 * float(truth.norm())


def two_unknowns(scene, vertices, seen, camera):
    """``JᵀJ`` of the mask by the distance and the focal length, relative changes of both."""
    R = torch.from_numpy(camera.T_camera_world[:3, :3].copy())
    x = (vertices.double() - torch.from_numpy(camera.position)) @ R.T
    farther, longer = torch.zeros_like(x), x * torch.tensor([1.0, 1.0, 0.0])
    farther[:, 2] = x[:, 2].mean()
    return blocks(scene, vertices, torch.stack([farther, longer]) @ R, seen)["mask"].information


def test_a_longer_lens_farther_away_is_nearly_invisible(shown, seen):
    """Lens against distance: exact for a flat board that faces the camera, weak for a body."""
    scene, vertices, _ = shown
    values, vectors = torch.linalg.eigh(two_unknowns(scene, vertices, seen, seen.camera))
    assert float(values[0]) < 0.02 * float(values[1])
    null = vectors[:, 0] * vectors[0, 0].sign()
    torch.testing.assert_close(null, torch.full((2,), 0.5, dtype=F64).sqrt(), atol=0.1, rtol=0)

    corners = torch.tensor([[x, y, z] for x in (-0.4, 0.4) for y in (-0.6, 0.6) for z in (0, 1e-4)])
    hull = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
            [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    camera = Camera(60.0, 60.0, 32.0, 32.0, np.eye(4), 64, 64)
    corners[:, 2] += 2
    empty = MaskAndNormals(camera, torch.zeros(64, 64), None, 1.0)
    board = MeshScene(torch.tensor(hull), corners)
    values, vectors = torch.linalg.eigh(two_unknowns(board, corners, empty, camera))
    assert float(values[0]) < 1e-6 * float(values[1])
    torch.testing.assert_close(vectors[0, 0], vectors[1, 0], atol=1e-3, rtol=0)


def test_a_larger_person_farther_away_is_invisible(shown, moving, seen):
    """A scaling about the camera's centre changes no picture."""
    scene, vertices, found = shown
    away = (vertices.double() - torch.from_numpy(seen.camera.position))[None]
    for name, one in blocks(scene, vertices, away, seen).items():
        nearer = found[name].J[TURNS + 2] * float(away[0].norm(dim=1).mean())
        assert float(one.J[0].norm()) < 0.02 * float(nearer.norm()), name


def test_more_evidence_never_makes_anything_less_certain(shown):
    _, _, found = shown
    information = {name: x.information for name, x in found.items()}
    P, scale = torch.eye(TURNS + 13, dtype=F64), {"mask": 10.0, "normals": 1.0}
    known = [{}, {"mask": information["mask"]}, information]
    C = [covariance_of(some, scale, P) for some in known]
    for more, less in zip(C[1:], C, strict=False):
        assert float(torch.linalg.eigvalsh(less - more).min()) > -1e-9 * float(less.trace())
        assert torch.equal(more, more.T) and float(torch.linalg.eigvalsh(more).min()) > 0
    assert float(C[2].trace()) < 0.8 * float(C[0].trace())


def test_the_noise_is_found_whatever_the_unknowns_explain():
    """Residuals of a linear model after its fit, with the redundancy that the fit leaves."""
    g = torch.Generator().manual_seed(0)
    normal = lambda *size: torch.randn(*size, generator=g, dtype=F64)
    P, frames = torch.eye(20, dtype=F64), []
    for _ in range(40):
        J, pixels = 3 * normal(20, 60), 1 + 30 * torch.rand(60, generator=g, dtype=F64)
        noise = (0.5 * pixels).sqrt() * normal(60)
        y = J.T @ normal(20) + noise
        weight = J / (0.5 * pixels)
        fitted = torch.linalg.solve(weight @ J.T + P, weight @ y)
        frames.append({"mask": Blocks(J, y - J.T @ fitted, pixels)})
    information = [{name: x.information for name, x in one.items()} for one in frames]
    assert noise_scales(frames, information, [P] * 40)["mask"] == pytest.approx(0.5, rel=0.1)


@pytest.fixture(scope="module")
def upper_half(coarse, person, stage1, seen):
    """The posterior of a frame of which the upper half alone is seen."""
    _, pose, shape, offsets = person
    rows = seen.camera.height // 2
    half = MaskAndNormals(
        replace(seen.camera, height=rows), seen.mask[:rows], seen.normals[:rows], seen.area
    )
    of_person = pose.to(torch.float32), Shape(shape.betas.float()), offsets.float()
    variances = torch.full((1, 58), 0.01, dtype=F64)
    return Posterior.of({0: half}, coarse, of_person, stage1, variances, torch.eye(10, dtype=F64))


def test_a_joint_that_no_frame_shows_keeps_the_variance_of_the_prior(upper_half):
    variance = upper_half.C[0].diagonal()
    of = lambda name: variance[3 * JOINTS.index(name) :][:3]
    for name in ("left_ankle", "right_ankle", "left_foot", "right_foot"):
        torch.testing.assert_close(of(name), torch.full((3,), 0.01, dtype=F64), rtol=1e-3, atol=0)
    assert float(of("left_shoulder").min()) < 0.007


def test_covariances_of_joints_are_positive_and_between_frames_interpolated(upper_half):
    found = upper_half.uncertainty(3)
    for x in (found.joints, found.aligned):
        assert x.shape == (3, 55, 3, 3) and torch.equal(x[0], x[2])
        torch.testing.assert_close(x, x.mT)
    assert float(torch.linalg.eigvalsh(found.joints).min()) > 0
    assert float(torch.linalg.eigvalsh(found.aligned[:, 1:]).min()) > 0
    assert not bool(found.aligned[:, 0].any())  # the pelvis relative to itself
    size = found.aligned[0].diagonal(dim1=1, dim2=2).sum(1)
    assert float(size[JOINTS.index("left_foot")]) > 4 * float(size[JOINTS.index("left_elbow")])
