"""The kernels of splatting; they depend on Dr.Jit and numpy alone.

| file | what | equations |
|---|---|---|
| project.py | projection of a Gaussian: lens.py, ellipse.py and sh.py together | (1) |
| lens.py | projection of its mean, for three camera models | (2)-(3) |
| ellipse.py | its shape and opacity in the picture | (4)-(7) |
| sh.py | its colour | (8)-(10) |
| tiles.py | which Gaussians touch which tile, front to back, and which lane works on it | |
| pixel.py | one pixel meets one Gaussian: forward, adjoint and tangent step | (11)-(17) |
| blend.py | the loops around these steps, one tile per SIMD lane; the sums of eq. 16 | (16) |
| chunks.py | wide colours, some channels at a time | |
| passes.py | everything in order: forward, adjoint, tangent | |

Below them: inputs.py (the Gaussians and the camera as arrays), records.py (what the kernels pass to
one another), vectors.py (vectors and matrices with named entries), tile_memory.py (what a lane of
compositing reads and writes). ``gva_mi.jit`` has
records in memory, kernels that are traced once, and the lock.
"""
