"""The optimiser does not depend on axes, and steps follow lever arms."""

import roma
import torch

from gva_mi.body.pose import JAW_AND_EYES, JOINTS, PARENTS, Shape
from gva_mi.refine.single_frame import joint_weights
from gva_mi.refine.vector_adam import VectorAdam, lever_arms, turn_rates


def descend(start, target, scales, steps=300):
    x = start.clone().requires_grad_()
    adam = VectorAdam([x], [0.05])
    path = []
    for step in range(steps):
        ((x - target).square() @ scales).sum().backward()
        adam.step(0.1 ** (step / steps))
        path.append(x.detach().clone())
    return path


def test_the_first_step_points_along_the_gradient():
    target = torch.tensor([[0.1, 0.01, 0.0]])
    (first,) = descend(torch.zeros(1, 3), target, torch.ones(3), steps=1)
    torch.testing.assert_close(first, 0.05 * target / target.norm())


def test_rotating_the_problem_rotates_the_path():
    generator = torch.Generator().manual_seed(2)
    R = roma.rotvec_to_rotmat(torch.tensor([0.4, -0.8, 0.3]))
    start, target = torch.randn(2, 5, 3, generator=generator)
    plain = descend(start, target, torch.ones(3), 20)
    turned = descend(start @ R.T, target @ R.T, torch.ones(3), 20)
    torch.testing.assert_close(plain[-1] @ R.T, turned[-1], atol=1e-4, rtol=1e-4)


def test_leaves_without_gradient_and_rows_of_rate_zero_stay():
    x, y = (torch.ones(2, 3).requires_grad_() for _ in range(2))
    x.sum().backward()
    VectorAdam([x, y], [torch.tensor([[0.1], [0.0]]), 0.1]).step()
    assert (x[0] < 1).all() and (x[1] == 1).all() and (y == 1).all() and x.grad is None


def test_a_step_moves_the_surface_alike_at_every_joint_but_the_face():
    arms = torch.linspace(0.1, 1.0, len(JOINTS))
    rates = turn_rates(arms, step=0.01, largest_turn=0.05)[:, 0]
    assert not rates[JAW_AND_EYES].any()
    moved = torch.ones(len(JOINTS), dtype=bool)
    moved[JAW_AND_EYES] = False
    far = arms > 0.01 / 0.05
    surface = (rates * arms)[moved & far]
    torch.testing.assert_close(surface, torch.full_like(surface, 0.01))
    assert (rates[moved & ~far] == 0.05).all()


def test_lever_arms_and_weights_of_eq_8_fall_along_every_limb(body):
    arms = lever_arms(body.rest(Shape(torch.zeros(10))), body.weights, body.parents)
    weights = joint_weights(PARENTS)
    for side in ("left", "right"):
        for limb in (("shoulder", "elbow", "wrist", "index1", "index3"), ("hip", "knee", "ankle")):
            for values in (arms, weights):
                along = [float(values[JOINTS.index(f"{side}_{name}")]) for name in limb]
                assert along == sorted(along, reverse=True)
    assert float(weights[0]) == 1
