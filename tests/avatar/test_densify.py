"""Density control: counts add up, and Adam's moments follow their rows."""

import pytest
import torch

from gva_mi.avatar.canonical import PARAMETERS
from gva_mi.avatar.densify import DensifyOptions, ScreenGradients, densify
from gva_mi.body.pose import Pose
from gva_mi.splat import Camera, Gaussians, Screen, SplatOptions, look_at, render

NO_STEPS = SplatOptions(alpha_min=1e-9)  # a cut-off that moves would spoil differences
LARGE, SMALL = 0.03, 0.003  # metres, on either side of split_scale


def adam(avatar):
    """One group per parameter, as in the fit, and one step taken so that there are moments."""
    groups = [{"params": [p], "lr": 1e-3, "name": n} for n, p in avatar.named_parameters()]
    optimizer = torch.optim.Adam(groups)
    for _, parameter in avatar.named_parameters():
        rows = torch.arange(parameter.numel(), dtype=parameter.dtype).view(parameter.shape)
        parameter.grad = 1 + rows / rows.numel()
    optimizer.step()
    optimizer.zero_grad()
    return optimizer


def wants(avatar, rows):
    """Gradients that single out some rows."""
    gradients = ScreenGradients(len(avatar.canonical))
    gradients.total[rows], gradients.views[:] = 1.0, 1
    return gradients


@pytest.fixture
def avatar(make_avatar):
    avatar = make_avatar()
    with torch.no_grad():
        avatar.canonical.log_scales.fill_(SMALL).log_()
    return avatar


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(0)


def values(canonical):
    return {name: getattr(canonical, name).detach().clone() for name in (*PARAMETERS, "weights")}


def test_clone_doubles_the_rows_with_large_gradients(avatar, generator):
    optimizer, before = adam(avatar), values(avatar.canonical)
    rows = torch.tensor([3, 10, 11])
    densify(avatar, optimizer, wants(avatar, rows), generator=generator)
    for name, value in values(avatar.canonical).items():
        assert torch.equal(value, torch.cat([before[name], before[name][rows]])), name


def test_split_replaces_one_by_two_smaller_within_its_extent(avatar, generator):
    with torch.no_grad():
        avatar.canonical.log_scales[5] = torch.tensor([LARGE, LARGE, LARGE / 100]).log()
    optimizer = adam(avatar)
    before = values(avatar.canonical)
    densify(avatar, optimizer, wants(avatar, [5]), generator=generator)
    after, G = values(avatar.canonical), avatar.canonical
    assert len(G) == 643
    rest = torch.arange(642) != 5
    assert torch.equal(after["means"][:641], before["means"][rest])
    assert torch.allclose(G.scales[641:], before["log_scales"][5].exp() / 1.6)
    assert torch.equal(after["weights"][641:], before["weights"][[5, 5]])
    away = after["means"][641:] - before["means"][5]
    assert 0 < away.norm(dim=1).min() and away.norm(dim=1).max() < 4 * LARGE
    normal = torch.nn.functional.normalize(
        before["means"][5] / torch.tensor([0.64, 0.81, 0.09]), dim=0
    )
    assert (away @ normal).abs().max() < 0.1 * away.norm(dim=1).max()  # a flat one stays flat


def test_prune_removes_the_transparent_and_the_huge(avatar, generator):
    with torch.no_grad():
        avatar.canonical.logit_opacities[:7] = -5
        avatar.canonical.log_scales[20] = 0
    optimizer = adam(avatar)
    before = values(avatar.canonical)
    densify(avatar, optimizer, wants(avatar, [0, 20]), generator=generator)
    kept = torch.tensor([i for i in range(642) if i > 6 and i != 20])
    assert torch.equal(avatar.canonical.means, before["means"][kept])


def test_optimiser_follows(avatar, generator):
    """Moments stay with their rows, new rows have none, old tensors are gone, and a step works."""
    with torch.no_grad():
        avatar.canonical.logit_opacities[0] = -5
    optimizer = adam(avatar)
    moments = {n: optimizer.state[getattr(avatar.canonical, n)]["exp_avg"] for n in PARAMETERS}
    residual = optimizer.state[avatar.residual.offset.weight]["exp_avg"]
    densify(avatar, optimizer, wants(avatar, [1, 2]), generator=generator)
    for name in PARAMETERS:
        state = optimizer.state[getattr(avatar.canonical, name)]
        assert torch.equal(state["exp_avg"][:641], moments[name][1:]), name
        assert (state["exp_avg"][641:] == 0).all() and len(state["exp_avg_sq"]) == 643, name
        assert state["step"] == 1, name
    assert optimizer.state[avatar.residual.offset.weight]["exp_avg"] is residual
    held = {id(p) for group in optimizer.param_groups for p in group["params"]}
    assert held == {id(p) for p in avatar.parameters()}
    assert set(map(id, optimizer.state)) == held

    before = values(avatar.canonical)
    avatar(Pose.rest()).means.sum().backward()
    optimizer.step()
    assert not torch.equal(avatar.canonical.means, before["means"])


def test_screen_gradient_is_the_force_on_an_image_coordinate():
    """dL/du of a lone Gaussian, in halves of the person: move it sideways and measure."""
    T = look_at([0, 0, 3.0], [0, 0, 0])
    camera = Camera(40.0, 40.0, 16.0, 12.0, T, 32, 24)
    means = torch.tensor([[0.1, 0.05, 0.0], [0.0, 0.0, 50.0]], dtype=torch.float64)

    def loss_of(shift, screen=None):
        one = torch.ones(2, dtype=torch.float64)
        quats = torch.tensor([[1.0, 0, 0, 0]] * 2, dtype=torch.float64)
        moved = (means + shift * torch.tensor([1.0, 0.0, 0.0]).double()).requires_grad_()
        g = Gaussians(moved, quats, 0.06 * one[:, None].expand(2, 3).contiguous(), 0.5 * one,
                      colors=one[:, None].expand(2, 3).contiguous())  # fmt: skip
        columns = torch.linspace(0, 1, 32, dtype=torch.float64)
        return (render(g, camera, NO_STEPS, screen=screen).alpha * columns).mean()

    screen = Screen()
    loss_of(0.0, screen).backward()
    gradients = ScreenGradients(2)
    gradients.add(screen, 100)
    per_metre = (loss_of(1e-3) - loss_of(-1e-3)) / 2e-3  # a metre there is 40 / 3 pixels
    expected = per_metre.abs() * 3 / 40 * 5
    assert gradients.mean()[0] == pytest.approx(expected.item(), rel=2e-2)
    assert gradients.mean()[1] == 0 and gradients.views.tolist() == [1, 0]  # behind the camera


def test_growth_stops_at_the_cap_with_the_largest_gradients(avatar, generator):
    optimizer, before = adam(avatar), values(avatar.canonical)
    gradients = ScreenGradients(642)
    gradients.total, gradients.views = torch.arange(642.0), torch.ones(642)
    densify(avatar, optimizer, gradients, DensifyOptions(max_count=650), generator)
    assert len(avatar.canonical) == 650
    chosen = avatar.canonical.means[642:].sort(dim=0).values
    assert torch.equal(chosen, before["means"][-8:].sort(dim=0).values)
