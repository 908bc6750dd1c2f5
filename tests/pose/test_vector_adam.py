"""An optimiser of vectors that does not see axes."""

import roma
import torch

from gva_mi.pose.vector_adam import VectorAdam


def descend(start, target, scales, steps=300):
    x = start.clone().requires_grad_()
    adam = VectorAdam([x], [0.05])
    path = []
    for step in range(steps):
        ((x - target).square() @ scales).sum().backward()
        adam.step(0.1 ** (step / steps))
        path.append(x.detach().clone())
    return path


def test_a_bowl_is_descended():
    target = torch.tensor([[0.3, -0.2, 0.5], [1.0, 0.0, -1.0]])
    end = descend(torch.zeros(2, 3), target, torch.tensor([1.0, 2.0, 4.0]))[-1]
    torch.testing.assert_close(end, target, atol=5e-3, rtol=0)


def test_the_first_step_points_along_the_gradient():
    target = torch.tensor([[0.1, 0.01, 0.0]])
    (first,) = descend(torch.zeros(1, 3), target, torch.ones(3), steps=1)
    torch.testing.assert_close(first, 0.05 * target / target.norm())


def test_turning_the_problem_turns_the_path():
    generator = torch.Generator().manual_seed(2)
    R = roma.rotvec_to_rotmat(torch.tensor([0.4, -0.8, 0.3]))
    start, target = torch.randn(2, 5, 3, generator=generator)
    scales = torch.ones(3)
    plain = descend(start, target, scales, 20)
    turned = descend(start @ R.T, target @ R.T, scales, 20)
    torch.testing.assert_close(plain[-1] @ R.T, turned[-1], atol=1e-4, rtol=1e-4)


def test_a_leaf_without_a_gradient_rests():
    x, y = (torch.ones(2, 3).requires_grad_() for _ in range(2))
    adam = VectorAdam([x, y], [0.1, 0.1])
    x.sum().backward()
    adam.step()
    assert (x < 1).all() and (y == 1).all() and x.grad is None


def test_rates_can_differ_by_row():
    x = torch.zeros(2, 3).requires_grad_()
    x.sum().backward()
    VectorAdam([x], [torch.tensor([[0.1], [0.0]])]).step()
    assert (x[0] != 0).all() and (x[1] == 0).all()
