"""The command ``gva-mi bench``: how fast are the kernels?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg

from gva_mi.body.bench import bench_body
from gva_mi.commands.arguments import Flat
from gva_mi.console import bar, say
from gva_mi.errors import InputError
from gva_mi.files import require_room, write_json
from gva_mi.fit.bench import bench_fit
from gva_mi.mesh.bench import bench_normals
from gva_mi.splat.bench import BenchOptions
from gva_mi.splat.bench import bench as bench_splat
from gva_mi.splat.scene import Scene
from gva_mi.viewer.bench import bench_viewer


def bench(
    what: Positional[Literal["splat", "body", "normals", "fit", "viewer"]],
    options: Flat[FlagCreatePairsOff[BenchOptions]],
    *,
    scene: Path | None = None,
    json_file: Annotated[Path | None, arg(name="json")] = None,
) -> None:
    """Measure the renderer, the body model, the normals that refinement looks at, a fit, a viewer.

    Milliseconds per stage; of the renderer also shares of the machine's limits, and growth.

    Args:
        what: the part to measure. Of the options all but splat use repeats and seed only.
        options: what to measure, and how often.
        scene: a .ply, .splat, .spz or .npz file as for gradcheck; without it a person of 20,000
            Gaussians at 512 px.
        json_file: where to write all figures.
    """
    if what != "splat" and scene is not None:
        raise InputError(f"bench {what}: there is no --scene, the body is the command's own")
    if what != "splat" and options.against:
        raise InputError(f"bench {what}: --against is for splat, which has peers")
    for file in (json_file, options.plot):
        if file is not None:
            require_room(file, overwrite=True)
    if what == "body":
        found = bench_body(options.repeats, options.seed)
    elif what == "normals":
        found = bench_normals(options.repeats, options.seed)
    elif what == "fit":
        found = bench_fit(options.repeats, options.seed)
    elif what == "viewer":
        found = bench_viewer(options.repeats, options.seed)
    else:
        given = None if scene is None else Scene.load(scene)
        with bar("bench") as progress:
            found = bench_splat(given, options, progress)
    say(found.table())
    if json_file is not None:  # before the plot, which a full disk may have no room for
        write_json(json_file, found.to_dict())
        say(f"figures: {json_file}")
    if options.plot is not None:
        found.peers.draw(options.plot)
        say(f"plot: {options.plot}")
