"""Adam of a fit has the bits of torch's."""

import subprocess
import sys

import torch

from gva_mi.avatar.adam import Adam, Group


def leaves(seed):
    generator = torch.Generator().manual_seed(seed)
    shapes = (37, 3), (37,), (5, 4, 3)
    return [torch.randn(s, generator=generator).requires_grad_() for s in shapes]


def set_gradients(leaves, step):
    generator = torch.Generator().manual_seed(100 + step)
    for k, x in enumerate(leaves):
        scale = 10.0 ** (2 * k - 4)
        x.grad = None if (step, k) == (0, 2) else scale * torch.randn(x.shape, generator=generator)


def ours(x):
    return Adam([Group("first", x[:1], 0.01, 1e-5), Group("others", x[1:], 0.003)])


def test_steps_have_the_bits_of_torchs_fused_adam():
    """Also where a leaf lacks a gradient at first, and where a learning rate changes."""
    x, y = leaves(0), leaves(0)
    own = ours(x)
    groups = [{"params": y[:1], "lr": 0.01, "eps": 1e-5}, {"params": y[1:], "lr": 0.003}]
    reference = torch.optim.Adam(groups, eps=1e-15, fused=True)
    for step in range(5):
        own.groups[0].lr = reference.param_groups[0]["lr"] = 0.01 * 0.7**step
        set_gradients(x, step)
        set_gradients(y, step)
        own.step()
        reference.step()
        assert all(a.grad is None and torch.equal(a, b) for a, b in zip(x, y, strict=True))


def test_a_saved_state_continues_with_the_same_bits():
    x, y = leaves(0), leaves(0)
    whole, first = ours(x), ours(y)
    for step in range(6):
        if step == 3:
            state = first.state_dict()
            first = ours(y)
            first.load_state_dict(state)
        for optimizer, parameters in ((whole, x), (first, y)):
            set_gradients(parameters, step)
            optimizer.step()
    assert all(torch.equal(a, b) for a, b in zip(x, y, strict=True))


def test_a_step_does_not_import_the_compiler():
    program = (
        "import sys, torch; from gva_mi.avatar.adam import Adam, Group; x = torch.zeros(3)\n"
        "x.requires_grad_(); adam = Adam([Group('x', [x], 0.1)]); x.sum().backward(); adam.step()\n"
        "assert 'torch._dynamo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
