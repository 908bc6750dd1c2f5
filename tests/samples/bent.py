"""Planted errors of derivatives."""

import torch


def bent(gradient=1.0, tangent=1.0):
    """The identity, whose gradients and tangents are so many times too long."""

    class Bent(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            return x.clone()

        @staticmethod
        def backward(ctx, g):
            return gradient * g

        @staticmethod
        def jvp(ctx, t):
            return tangent * t

    return Bent.apply
