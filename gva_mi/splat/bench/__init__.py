"""How fast the renderer is: per stage, against the machine's limits, and as the scene grows.

Times are wall clock, the least and the median of repeated calls; on a shared machine trust ratios
of figures of one run. timing.py says what is timed; stages.py, changes.py and growth.py each
measure one thing, first_call.py a process's first picture, and results.py all of them; machine.py
is what they are compared with, and peers.py other people's renderers beside ours: gsplat_peer.py,
opensplat_peer.py.
"""

from gva_mi.splat.bench.results import Bench, BenchOptions, bench

__all__ = ["Bench", "BenchOptions", "bench"]
