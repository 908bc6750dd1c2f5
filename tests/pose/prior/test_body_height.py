"""A known height decides how far away a person stands."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.body.pose import Shape
from gva_mi.prior.body_height import Stature, with_height
from gva_mi.refine.refine import refine
from gva_mi.refine.sequence import SequenceOptions


@pytest.fixture(scope="module")
def stature(body):
    return Stature.of(body)


@pytest.fixture(scope="module")
def shape():
    return Shape(torch.randn(10, generator=torch.Generator().manual_seed(1)))


def test_the_height_is_that_of_the_body_at_rest(stature, body, shape):
    y = body.rest(shape).vertices[:, 1]
    assert float(stature.height(shape)) == pytest.approx(float(y.max() - y.min()), abs=0.005)


def test_the_nearest_shape_has_the_height(stature, shape):
    taller = stature.nearest(shape, 1.93)
    assert float(stature.height(taller)) == pytest.approx(1.93, abs=1e-4)
    assert float(stature.energy(taller, 1.93)) < 1e-8
    # It is the shortest step, because it is along the slope.
    step = torch.nn.functional.normalize(taller.betas - shape.betas, dim=0)
    slope = torch.nn.functional.normalize(stature.slope, dim=0)
    assert abs(float(step @ slope)) == pytest.approx(1, abs=1e-5)


def test_a_taller_person_is_farther_away_and_looks_the_same(
    stature, body, shape, camera, true_pose
):
    height = 1.15 * float(stature.height(shape))
    pose, taller = with_height(body, true_pose, shape, [camera] * 3, height)
    assert torch.equal(pose.rotations, true_pose.rotations)
    bodies = [body(p, s) for p, s in ((true_pose, shape), (pose, taller))]
    pelvis = [x.joints[:, 0].double().numpy() for x in bodies]
    np.testing.assert_allclose(camera.project(pelvis[1]), camera.project(pelvis[0]), atol=1e-3)
    distance = [np.linalg.norm(x - camera.position, axis=1) for x in pelvis]
    np.testing.assert_allclose(distance[1] / distance[0], 1.15, rtol=1e-4)
    seen = [np.ptp(camera.project(x.vertices[0].double().numpy())[:, 1]) for x in bodies]
    assert seen[1] == pytest.approx(seen[0], rel=0.01)


def test_a_body_of_one_height_keeps_its_shape_and_refuses_another(body, shape):
    """No beta moves crown or soles of it."""
    ends = body.v_template[:, 1]
    heights = Stature.of(body)
    one = Stature(float(ends.max() - ends.min()), torch.zeros_like(heights.slope))
    assert one.nearest(shape, one.mean + 0.005) is shape
    with pytest.raises(InputError, match=r"m tall in every shape; expected .*, got 1\.93 m"):
        one.nearest(shape, 1.93)


def test_hair_and_soles_do_not_bias_depth_if_the_height_is_known(stature, clip, body, scene):
    """Images show them, and the body does not have them."""
    pelvis, pictures = body.rest(clip.shape).joints[0], []
    for k in range(len(clip)):
        with torch.no_grad():
            vertices = body(clip.pose[k], clip.shape).vertices[0]
            centre = pelvis + clip.pose.transl[k]
            image = scene.render(centre + 1.04 * (vertices - centre), clip.camera).numpy()
        pictures.append((image[..., 3].copy(), image[..., :3].copy()))
    height = float(stature.height(clip.shape))
    options = SequenceOptions(size=64, faces=2000, passes=8, learn=3, height=height)
    refined = refine(replace(clip, pictures=pictures), body, options)
    sight = torch.from_numpy(clip.camera.T_camera_world[2]).float()
    nearer = (clip.pose.transl - refined.pose.transl) @ sight[:3]
    distance = (pelvis + clip.pose.transl) @ sight[:3] + sight[3]
    assert float((nearer / distance).mean().abs()) < 0.01


def test_a_refinement_keeps_the_height(stature, clip, body):
    height = 1.1 * float(stature.height(clip.shape))
    refined = refine(clip, body, SequenceOptions(size=48, faces=2000, passes=4, height=height))
    assert float(stature.height(refined.shape)) == pytest.approx(height, abs=0.005)
