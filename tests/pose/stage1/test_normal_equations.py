"""The sparse solution of a video's normal equations is that of the dense matrix."""

import pytest
import torch

from gva_mi.stage1.normal_equations import NormalEquations

F, S = 3, 4


def equations_of(frames):
    """Random equations, and the same as a dense matrix and its right side."""
    torch.manual_seed(frames)
    equations = NormalEquations.zero(frames, F, S)
    data = torch.randn(frames, 12, F + S, dtype=torch.float64)
    errors = torch.randn(frames, 12, dtype=torch.float64)
    weights = 0.5 + torch.rand(frames, 12, dtype=torch.float64)
    equations.add(slice(None), errors, weights, data[..., :F], data[..., F:])
    equations.next[:-1] = -torch.rand(frames - 1, F) - 0.1
    equations.second[:-2] = torch.rand(max(frames - 2, 0), F)
    count = frames * F
    dense = torch.zeros(count + S, count + S, dtype=torch.float64)
    right = torch.zeros(count + S, dtype=torch.float64)
    for t in range(frames):
        own = [*range(t * F, t * F + F), *range(count, count + S)]
        dense[torch.meshgrid(torch.tensor(own), torch.tensor(own), indexing="ij")] += (
            data[t].T * weights[t]
        ) @ data[t]
        right[own] -= data[t].T @ (weights[t] * errors[t])
        for apart, links in ((1, equations.next), (2, equations.second)):
            if t + apart < frames:
                for f in range(F):
                    i, j = t * F + f, (t + apart) * F + f
                    dense[i, j] += links[t, f]
                    dense[j, i] += links[t, f]
    return equations, dense, right


@pytest.mark.parametrize("frames", [1, 2, 3, 6, 7])
def test_the_step_is_that_of_the_dense_matrix(frames):
    equations, dense, right = equations_of(frames)
    dense.diagonal().mul_(1.5)
    own, shared = equations.solve(0.5)
    expected = torch.linalg.solve(dense, right)
    assert torch.allclose(torch.cat([own.flatten(), shared]), expected, rtol=1e-4, atol=1e-6)
