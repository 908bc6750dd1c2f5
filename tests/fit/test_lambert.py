"""What turning upright teaches of the light holds for a raised arm."""

import copy

import pytest
import torch

from gva_mi.avatar.skin_gaussians import light_vector
from gva_mi.body.pose import Pose
from gva_mi.body.so3 import to_matrix
from gva_mi.fit.lambert import Lambert
from gva_mi.splat.kernels.sh import C0


@pytest.fixture
def avatar(known):
    found = copy.deepcopy(known)
    with torch.no_grad():
        found.light.copy_(torch.tensor([0.5, 0.6, 0.7]))
    return found


def turned(*axis_angle):
    """A pose at rest, turned as a whole."""
    pose = Pose.rest()
    pose.rotations[0, 0] = torch.tensor(axis_angle)
    return pose


def test_without_differences_a_colour_depends_on_the_angle_between_light_and_normal(avatar):
    law = Lambert(avatar)
    law.strength.data.fill_(0.8)
    with torch.no_grad():
        avatar.canonical.sh[:, 1:] = 0
        pose = turned(0.4, 1.0, -0.3)
        found = avatar.animate(pose, law(avatar.canonical.sh)).gaussians.sh[:, 0]
        R, l = to_matrix(pose.rotations[0, 0]), light_vector(avatar.light)[0]
        mean = avatar.canonical.sh[:, 0] + 0.5 / C0
        angle = law.normals @ R.T @ l
        expected = mean * (1 + 0.8 * angle[:, None]) - 0.5 / C0
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=0)
    assert angle.max() > 0.25 and angle.min() < -0.25


def test_turning_upright_teaches_the_colours_of_other_turns(avatar):
    """Slopes that are learned alone know nothing of light from above or below."""
    law = Lambert(avatar)
    law.strength.data.fill_(1.2)
    with torch.no_grad():
        avatar.canonical.sh[:, 1:] = 0
        truth = law(avatar.canonical.sh)
    colours = lambda pose, sh: avatar.animate(pose, sh).gaussians.sh[:, 0]
    upright = [turned(0, angle, 0) for angle in torch.linspace(0, 6, 12).tolist()]
    lying, error = turned(1.4, 0, 0), {}
    for known_law in (True, False):
        law.strength.data.fill_(0.5)
        sh = torch.nn.Parameter(avatar.canonical.sh.detach() + 0.1)
        leaves = [sh, law.strength] if known_law else [sh]
        adam = torch.optim.Adam(leaves, lr=0.02)
        for step in range(240):
            pose = upright[step % len(upright)]
            found = colours(pose, law(sh) if known_law else sh)
            loss = (found - colours(pose, truth).detach()).square().mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
        with torch.no_grad():
            mine = law(sh) if known_law else sh
            error[known_law] = (colours(lying, mine) - colours(lying, truth)).abs().mean()
    assert error[True] < 0.5 * error[False]
