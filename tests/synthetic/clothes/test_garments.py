"""Garments, bags and hoods."""

import numpy as np
import pytest
import torch
import trimesh

from gva_mi.body.pose import Shape
from gva_mi.synthetic.clothes import accessories, garments
from gva_mi.synthetic.rest_body import RestBody


@pytest.fixture(scope="module")
def rest(body):
    return RestBody.of(body, Shape(torch.zeros(10)))


def closed(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def test_a_thick_sole_is_lower_and_flat(rest):
    flat, thick = (garments.shoe(rest, "left", s) for s in (0, 0.04))
    lowest = [mesh.vertices[:, 1].min() for mesh in (flat, thick)]
    assert abs(lowest[0] - lowest[1] - 0.04) < 0.002  # metres
    sole = thick.vertices[thick.vertices[:, 1] < lowest[1] + 0.001]
    assert np.ptp(sole[:, 2]) > 0.15 and closed(thick).is_watertight  # it stands on all its length


@pytest.mark.slow
@pytest.mark.parametrize("make", [accessories.backpack, accessories.shoulder_bag])
def test_a_bag_hangs_outside_the_body_on_a_strap(rest, make):
    bag, strap, joint = make(rest, 0.02)
    assert joint in rest.joints and closed(bag).is_watertight and closed(bag).volume > 0.002
    assert (rest.surface.distance(bag.vertices.astype(float)) > 0).mean() > 0.95
    assert (rest.surface.distance(strap.vertices.astype(float)) > 0.01).all()
    apart = np.linalg.norm(bag.vertices[:, None, :] - strap.vertices[None, ::9], axis=-1)
    assert apart.min() < 0.02  # metres: the strap meets the bag


@pytest.mark.slow
def test_a_hood_leaves_the_face_free(rest):
    up = accessories.hood_up(rest, 0.02)
    eyes = (rest.joints["left_eye_smplhf"] + rest.joints["right_eye_smplhf"]) / 2
    before = up.vertices[up.vertices[:, 2] > eyes[2] - 0.02] - eyes
    assert (np.abs(before[:, :2]) > [0.03, 0.05]).any(1).all()  # metres beside the eyes
    assert up.vertices[:, 1].max() > rest.vertices[:, 1].max() + 0.01
    down = accessories.hood_down(rest, 0.02)
    assert down.vertices[:, 1].max() < eyes[1] and closed(down).is_watertight
