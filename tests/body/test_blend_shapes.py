"""Blend shapes: weighted sums, exact derivatives, the same bits on any number of cores."""

import pytest
import torch

from gva_mi.body.smplx import add_directions, as_rows

F64 = torch.float64


def sums(vertices, frames, count=7, given=7, surfaces=1):
    """Surface, coefficients, directions as a file holds them (V, 3, K), and in rows."""
    g = torch.Generator().manual_seed(vertices + frames)
    normal = lambda *size: torch.randn(*size, generator=g, dtype=F64)
    directions = normal(vertices, 3, count)
    rows = torch.from_numpy(as_rows(directions.numpy()))
    return normal(surfaces, 3 * vertices), normal(frames, given), directions, rows


@pytest.mark.parametrize("vertices", [10, 11], ids=["even", "odd"])
@pytest.mark.parametrize("frames", [1, 2])
@pytest.mark.parametrize("given", [7, 5, 0], ids=["all", "some", "none"])
def test_a_surface_moves_by_the_weighted_sum(vertices, frames, given):
    surface, coefficients, directions, rows = sums(vertices, frames, given=given)
    moved = add_directions(surface, coefficients, rows)
    assert moved.shape == (frames, 3 * vertices)
    wanted = surface.view(3, -1).T + torch.einsum(
        "vck,tk->tvc", directions[..., :given], coefficients
    )
    torch.testing.assert_close(moved.view(frames, 3, -1).mT, wanted)


@pytest.mark.parametrize("vertices", [4, 5], ids=["even", "odd"])
@pytest.mark.parametrize("frames, surfaces", [(1, 1), (3, 1), (3, 3)])
def test_gradients_against_differences(vertices, frames, surfaces):
    surface, coefficients, _, rows = sums(vertices, frames, surfaces=surfaces)
    leaves = [x.requires_grad_() for x in (surface, coefficients)]
    torch.autograd.gradcheck(lambda x, c: add_directions(x, c, rows), leaves, check_forward_ad=True)


@pytest.mark.parametrize("frames", [1, 5])
def test_the_same_bits_on_one_thread_and_on_two(frames):
    surface, coefficients, _, rows = (x.float() for x in sums(3001, frames, count=90, given=90))
    leaves = [x.requires_grad_() for x in (surface, coefficients)]

    def run():
        moved = add_directions(*leaves, rows)
        return [moved, *torch.autograd.grad(moved.sin().sum(), leaves)]

    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(run())
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))
