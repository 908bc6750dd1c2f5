"""Hidden Gaussians are recognised: shares of Gaussians on one line of sight, by hand."""

import pytest
import torch

from gva_mi.fit.shown import shown_shares
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


def camera(z: float) -> Camera:
    return Camera(800.0, 800.0, 64.0, 64.0, look_at((0, 0, z), (0, 0, 0)), 128, 128)


@pytest.mark.parametrize("front, behind", [(0.08, 1 - ETA / 2), (2.0, 1 - ETA)])
def test_a_hidden_gaussian_shows_what_the_one_before_it_leaves(front, behind):
    """Of equal footprints g the rear one keeps Σ (1 - η g) g / Σ g = 1 - η / 2, of a wall 1 - η."""
    shares = shown_shares(StandIn(front), lambda frame: None, {0: camera(5)})
    assert shares[1:].tolist() == pytest.approx([behind, 0], abs=0.02)


def test_the_frame_that_shows_most_counts():
    shares = shown_shares(StandIn(0.08), lambda frame: None, {0: camera(5), 1: camera(-5)})
    assert shares[:2].tolist() == pytest.approx([1, 1], abs=0.02) and shares[2] == 0
