"""The kernels of splatting, and what they are made of; they know Dr.Jit and numpy alone.

| file | what | equations |
|---|---|---|
| project.py | a Gaussian in the picture: lens.py, ellipse.py and sh.py together | (1) |
| lens.py | where its mean falls, for three camera models | (2)-(3) |
| ellipse.py | its shape and opacity there | (4)-(7) |
| covariance.py | the same where its covariance is given | (6)-(7) |
| sh.py | its colour from there | (8)-(10) |
| tiles.py | which Gaussians touch which tile, front to back | |
| pixel.py | one pixel meets one Gaussian: step, step back, step of the tangent | (11)-(17) |
| blend.py | the loops around these steps, a tile for each SIMD lane | |
| chunks.py | wide colours, some channels at a time | |
| composite.py | blend.py for all chunks, there and back | |
| passes.py | all of it in order: forward, adjoint, tangent | |

Below them: inputs.py (the Gaussians as flat arrays), records.py (what the kernels hand to one
another), planes.py (pictures), packets.py (how records lie in memory), frozen.py (kernels that are
traced once).
"""
