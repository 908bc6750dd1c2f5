"""The command ``gva-mi bench``: run the benchmarks of a checkout."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

import gva_mi
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.options import Within

CHECKOUT = Path(gva_mi.__file__).parents[1]


def bench(
    what: Positional[Literal["splat", "growth", "fit"]],
    *,
    repeats: Annotated[int, Within(1, 100_000)] = 20,
    scene: Path | None = None,
) -> None:
    """Measure the speed of the renderer, of larger scenes, or of a fit and a refinement.

    Prints tables of milliseconds; on a shared machine trust only ratios within one run.

    Args:
        what: the part to measure; growth: larger scenes and more threads.
        repeats: calls per figure.
        scene: splat: a .ply of Gaussians; without it, a synthetic person of 20,000 Gaussians at
            512 px.
    """
    if what != "splat" and scene is not None:
        raise InputError(f"bench {what}: --scene is an option of bench splat")
    if not (CHECKOUT / "benchmarks/splat.py").exists():
        raise InputError(
            "bench: benchmarks are in the repository and not in the installed package; clone it "
            f"and run there: python -m gva_mi bench {what}"
        )
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))
    options = {} if scene is None else {"path": scene}
    for table in import_module(f"benchmarks.{what}").run(repeats, **options):
        say(f"{table}\n")
