"""``python -m benchmarks splat|fit|mesh|viewer``: print tables of times."""

from __future__ import annotations

import sys

from gva_mi.__main__ import main

if __name__ == "__main__":
    main(["bench", *sys.argv[1:]])
