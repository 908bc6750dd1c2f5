"""The kernels of splatting; they depend on Dr.Jit and numpy alone.

In the order in which to read them, with the equations of each:

===============  ===================================================================
``lens``         projection of a mean, for three camera models: (2)-(3)
``ellipse``      shape and opacity in the picture: (4)-(7)
``sh``           colour: (8)-(10)
``project``      all three, for all Gaussians: (1)
``tiles``        which Gaussians touch which tile, front to back, and which lane works on it
``pixel``        one pixel meets one Gaussian: forward, adjoint and tangent step: (11)-(17)
``blend``        the loops around these steps, one tile per SIMD lane; the sums of (16)
``chunks``       wide colours, some channels at a time
``passes``       everything in order: forward, adjoint, tangent
===============  ===================================================================

Below them:

===============  ===================================================================
``inputs``       the Gaussians and the camera as arrays
``records``      what the kernels pass to one another
``vectors``      vectors and matrices with named entries
``tile_memory``  what a lane of compositing reads and writes
===============  ===================================================================

:mod:`gva_mi.jit` has records in memory, kernels that are traced once, and the lock.

Sources: the forward equations are 3D Gaussian splatting (Kerbl et al., 2023) after EWA splatting
(Zwicker et al., 2001), with the lenses and cut-offs of gsplat 1.5.3 (Ye et al., "gsplat: An
Open-Source Library for Gaussian Splatting", 2024). ``antialiased`` is Mip-Splatting's 2D filter (Yu
et al., 2024), the sums of absolute gradients are AbsGS's (Ye et al., 2024). The factor of (6), the
adjoint and the tangent are derived here.
"""
