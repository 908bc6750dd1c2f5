"""Hidden Gaussians are recognised: shares of Gaussians on one line of sight, by hand."""

import pytest
import torch

from gva_mi.avatar.canonical import CanonicalGaussians
from gva_mi.avatar.reinit import HIDDEN
from gva_mi.fit.shown import put_back, shown_shares
from gva_mi.splat import Camera, Gaussians
from gva_mi.splat.camera import look_at

ETA = 0.9
PLACES = [[0, 0, 1.0], [0, 0, 0], [9.0, 0, 0]]  # two on the z axis, and one beside the picture


class StandIn:
    """An avatar that is three Gaussians, whatever the pose."""

    canonical = PLACES

    def __init__(self, front: float) -> None:
        scales = torch.tensor([front, 0.1, 0.1])[:, None].expand(3, 3)
        quats = torch.tensor([[1.0, 0, 0, 0]]).expand(3, 4)
        opacities = torch.full((3,), ETA)
        self.shape = torch.tensor(PLACES), quats.contiguous(), scales.contiguous(), opacities

    def __call__(self, pose: None) -> Gaussians:
        return Gaussians(*self.shape, sh=torch.zeros(3, 1, 3))


def camera(z: float, target: tuple = (0, 0, 0)) -> Camera:
    return Camera(800.0, 800.0, 64.0, 64.0, look_at((0, 0, z), target), 128, 128)


@pytest.mark.parametrize("front, behind", [(0.08, 1 - ETA / 2), (2.0, 1 - ETA)])
def test_a_hidden_gaussian_shows_what_the_one_before_it_leaves(front, behind):
    """Of equal footprints g the rear one keeps Σ (1 - η g) g / Σ g = 1 - η / 2, of a wall 1 - η."""
    shares = shown_shares(StandIn(front), lambda frame: None, {0: camera(5)})
    assert shares[1:].tolist() == pytest.approx([behind, 0], abs=0.02)


def test_frames_count_by_what_they_show():
    """Seen before the other one, behind it, and not at all: (w + w' s') / (w + w') of the first."""
    cameras = {0: camera(5), 1: camera(-5), 2: camera(5, (0, 0, 9))}
    own, own_behind, other = ((0.08 / 4) ** 2, (0.08 / 6) ** 2, (0.1 / 5) ** 2)  # areas
    hidden = 1 - ETA * other / (other + own_behind)
    shown = own_behind * hidden
    shares = shown_shares(StandIn(0.08), lambda frame: None, cameras)
    expected = (own + shown * hidden) / (own + shown)
    assert shares[0].item() == pytest.approx(expected, abs=0.01) and shares[2] == 0


def test_hidden_gaussians_go_back_to_where_they_were_made():
    """Eq. 4: not at all, half, wholly; colours and opacities stay as they were learned."""
    now = CanonicalGaussians(
        means=torch.ones(3, 3),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(3, 1),
        log_scales=torch.ones(3, 3),
        logit_opacities=torch.ones(3),
        sh=torch.ones(3, 1, 3),
        weights=torch.ones(3, 1),
    )
    made = Gaussians(
        torch.zeros(3, 3), now.quats.detach(), torch.ones(3, 3), torch.ones(3), sh=now.sh.detach()
    )
    put_back(now, made, torch.tensor([0.4, HIDDEN / 4, 0]))
    expected = torch.tensor([1, 0.5, 0])[:, None].expand(3, 3)
    assert torch.equal(now.means, expected) and torch.equal(now.log_scales, expected)
    assert torch.equal(now.logit_opacities, torch.ones(3))
