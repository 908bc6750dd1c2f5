"""``python -m benchmarks splat|fit|mesh|viewer``: print tables of times."""

from __future__ import annotations

import os
import sys

if __name__ == "__main__":
    # torch's idle threads would spin on the cores that Dr.Jit's kernels need; read at its import.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    from gva_mi.__main__ import main

    main(["bench", *sys.argv[1:]])
