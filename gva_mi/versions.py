"""The versions that figures belong to: they are written beside every result."""

from __future__ import annotations

import platform
from importlib import metadata

PACKAGES = ("gva_mi", "torch", "drjit", "numpy")  # whose versions may change the figures


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that may change the figures, by name."""
    found = {"python": platform.python_version()}
    return found | {name: metadata.version(name) for name in PACKAGES}
