"""gsplat's ``rasterization`` on a CPU, with the ``meta`` that gsplat's strategies read.

==================  ==========================================================
``rasterization``   the function, a drop-in replacement for gsplat's
``views``           all pictures of one call, ``meta``, and ``meta["means2d"]``
                    as a node of torch's graph
==================  ==========================================================
"""

from gva_mi.splat.gsplat.rasterization import rasterization

__all__ = ["rasterization"]
