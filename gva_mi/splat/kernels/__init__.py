"""The kernels of splatting; they depend on Dr.Jit and numpy alone.

| file | what | equations |
|---|---|---|
| project.py | projection of a Gaussian: lens.py, ellipse.py and sh.py together | (1) |
| lens.py | projection of its mean, for three camera models | (2)-(3) |
| ellipse.py | its shape and opacity in the picture | (4)-(7) |
| covariance.py | the shape where a covariance is given | (6)-(7) |
| sh.py | its colour | (8)-(10) |
| tiles.py | which Gaussians touch which tile, front to back | |
| schedule.py | which lane works on which tile | |
| pixel.py | one pixel meets one Gaussian: forward, adjoint and tangent step | (11)-(17) |
| pair_gradient.py | the sums over a tile's pixels | (16) |
| tile_iterator.py | iteration over a tile's list | |
| tile_pixels.py | a tile's pixels in memory of the lane | |
| blend.py | the loops around these steps, one tile per SIMD lane | |
| chunks.py | wide colours, some channels at a time | |
| composite.py | blend.py for all chunks: forward, adjoint, tangent | |
| passes.py | everything in order: forward, adjoint, tangent | |

Below them: geometry.py, inputs.py and camera_arrays.py (the Gaussians and the camera as arrays),
records.py (what the kernels pass to one another), saved.py (what a forward pass leaves), planes.py
(pictures). ``gva_mi.jit`` has records in memory, kernels that are traced once, and the lock.
"""
