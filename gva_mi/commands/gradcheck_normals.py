"""The command ``gva-mi gradcheck-normals``: are the gradients of the rendered normals right?"""

from __future__ import annotations

from gva_mi.commands.arguments import Flat
from gva_mi.console import bar, say
from gva_mi.errors import InputError
from gva_mi.mesh.gradcheck import LIMITS, GradientOptions, check_gradients, table


def gradcheck_normals(options: Flat[GradientOptions]) -> None:
    """Compare the gradients of mesh_normals by the body's pose with exact ones.

    Mask, interior and boundary apart, for limbs that are free, occlude, cross and pierce. Ends with
    an error where one is further off than allowed.
    """
    rows = []
    with bar("gradcheck") as progress:
        for row in check_gradients(options):
            rows.append(row)
            progress(len(rows), options.count)
    say(table(rows))
    failed = [f"{row.pose} {row.moves}" for row in rows if not row.passed]
    if failed:
        limits = ", ".join(f"{name} {limit:.0%}" for name, limit in LIMITS.items())
        raise InputError(f"gradcheck-normals: above {limits}: {'; '.join(failed)}")
