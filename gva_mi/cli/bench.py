"""The command ``gva-mi bench``: run the benchmarks of a checkout."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

import gva_mi
from gva_mi.cli.arguments import Switch
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room, write_json
from gva_mi.core.options import Seed, Within

CHECKOUT = Path(gva_mi.__file__).parents[1]
Repeats = Annotated[int, Within(1, 100_000)]


def bench(
    what: Positional[Literal["splat", "fit", "mesh", "viewer"]],
    *,
    repeats: Repeats = 20,
    seed: Seed = 0,
    scene: Path | None = None,
    no_growth: Switch = False,
    json_file: Annotated[Path | None, arg(name="json")] = None,
) -> None:
    """Measure the renderer, a fit, the rendered normals, or the viewer.

    Prints tables of milliseconds; on a shared machine trust only ratios within one run.

    Args:
        what: the part to measure.
        repeats: calls per figure.
        seed: seed of the random scene.
        scene: splat: a .ply, .splat, .spz or .npz file as for gradcheck; without it a synthetic
            person of 20,000 Gaussians at 512 px.
        no_growth: splat: leave larger scenes out.
        json_file: where to write all figures.
    """
    if what != "splat" and (scene is not None or no_growth):
        raise InputError(f"bench {what}: --scene and --no-growth are options of bench splat")
    if not (CHECKOUT / "benchmarks/splat.py").exists():
        raise InputError(
            "bench: benchmarks are in the repository and not in the installed package; clone it "
            f"and run there: python -m benchmarks {what}"
        )
    if json_file is not None:
        require_room(json_file, overwrite=True)
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))
    benchmark = import_module(f"benchmarks.{what}")
    options = {"path": scene, "growth": not no_growth} if what == "splat" else {}
    tables = []
    for table in benchmark.run(repeats, seed, **options):
        tables.append({"title": table.title, "rows": table.rows})
        say(f"{table}\n")
    if json_file is not None:
        write_json(json_file, tables)
        say(f"figures: {json_file}")
