"""The floors of the house: which folder stands on which, checked and drawn from the code's imports.

Every folder has a floor of its own. A file imports from its own folder and from the floors below,
never from above; and within a folder, no circle of files. ``tests/test_architecture.py`` holds the code
to this table, and ``python docs/layers.py`` prints the drawing in architecture.md.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "gva_mi").rglob("*.py")) + sorted((ROOT / "plugins").rglob("*.py"))

# From the ground up: a name, what it is, and the modules that are there. A module belongs to the
# longest prefix that fits.
FLOORS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("ground", "errors, ranges, files, libLLVM, console, pages",
     ("gva_mi", "gva_mi.core.errors", "gva_mi.core.options", "gva_mi.core.atomic", "gva_mi.core.provenance",
      "gva_mi.core.options", "gva_mi.core.options", "gva_mi.core.arrays",
      "gva_mi.core.arrays", "gva_mi.core.files", "gva_mi.core.spill_cache", "gva_mi.core.lock", "gva_mi.core.llvm",
      "gva_mi.core.console", "gva_mi.page", "gva_mi.core.threads", "gva_mi.core.cpu",
      "gva_mi.core.workers")),
    ("pickles", "other people's pickles, without running any code", ("gva_mi.core.pickles",)),
    ("splat records", "Camera, Gaussians, SplatOptions",
     ("gva_mi.splat.camera", "gva_mi.splat.gaussians", "gva_mi.splat.geometry",
      "gva_mi.splat.options")),
    ("splat/kernels", "splatting in Dr.Jit: forward, adjoint, tangent", ("gva_mi.splat.kernels",)),
    ("splat/formats", "Gaussians in files of other programs", ("gva_mi.splat.formats",)),
    ("splat", "render, rasterization; the slow twin", ("gva_mi.splat",)),
    ("splat/gradcheck", "are the gradients right?", ("gva_mi.splat.gradcheck",)),
    ("splat/bench", "how fast is it?", ("gva_mi.splat.bench",)),
    ("plugins/mesh_normals", "normals and silhouettes in Mitsuba",
     ("gva_mi_plugins.mesh_normals",)),
    ("plugins/…/twins", "what mesh_normals is checked with",
     ("gva_mi_plugins.mesh_normals.twins",)),
    ("plugins/gaussian_splat", "splatting in Mitsuba", ("gva_mi_plugins.gaussian_splat",)),
    ("plugins", "register()", ("gva_mi_plugins",)),
    ("body", "SMPL-X, skinning, the puppet", ("gva_mi.body",)),
    ("mesh", "meshes seen by Mitsuba, differentiable in torch", ("gva_mi.mesh",)),
    ("data", "Video, Frame, the folder format", ("gva_mi.data",)),
    ("data/networks", "networks that people bring", ("gva_mi.data.networks",)),
    ("data/importers", "files of other programs", ("gva_mi.data.importers",)),
    ("check", "what is wrong with a subject's folder", ("gva_mi.data.check",)),
    ("synthetic people", "who they are: shape, colours, texture",
     ("gva_mi.synthetic.people", "gva_mi.synthetic.color",
      "gva_mi.synthetic.texture")),
    ("synthetic/clothes", "garments, hair, folds, on a body at rest",
     ("gva_mi.synthetic.clothes", "gva_mi.synthetic.rest_body")),
    ("synthetic/motion", "what subjects do: turns, steps, gestures",
     ("gva_mi.synthetic.motion",)),
    ("synthetic/noise", "families of what a pipeline gets wrong",
     ("gva_mi.synthetic.error_models",)),
    ("data/synthetic", "subjects and their pictures", ("gva_mi.synthetic",)),
    ("sculptor", "who makes the puppet", ("gva_mi.synthetic.body_generator",)),
    ("avatar", "Gaussians on a skeleton: what is learned", ("gva_mi.avatar",)),
    ("avatar/formats", "avatars in files of other programs", ("gva_mi.avatar.formats",)),
    ("avatar/gradcheck", "are an avatar's gradients right?", ("gva_mi.avatar.gradcheck",)),
    ("pose", "stage 2: poses that agree with the pictures", ("gva_mi.pose",)),
    ("pose/evaluation", "how well refined poses fit", ("gva_mi.pose.evaluation",)),
    ("fit", "the loop around it: losses, training, tracking", ("gva_mi.fit",)),
    ("fit/evaluation", "how close the avatar comes; the study", ("gva_mi.fit.evaluation",)),
    ("viewer", "an avatar in the browser", ("gva_mi.viewer",)),
    ("commands", "one verb a file", ("gva_mi.cli",)),
    ("gva-mi", "the command line", ("gva_mi.__main__", "gva_mi.cli.parse")),
)  # fmt: skip


def module(path: Path) -> str:
    """The name under which a file is imported."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[0] == "plugins":
        parts[0] = "gva_mi_plugins"
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module(path): path for path in SOURCES}


def floor(name: str) -> int:
    """The number of a module's floor, 0 at the ground; -1 where it has none."""
    best, found = "", -1
    for number, (_, _, prefixes) in enumerate(FLOORS):
        for prefix in prefixes:
            inside = name == prefix or (prefix != "gva_mi" and name.startswith(prefix + "."))
            if inside and len(prefix) > len(best):
                best, found = prefix, number
    return found


def imports(path: Path, *, top_level_only: bool = False) -> set[str]:
    """Every module that a file imports; ``from a import b`` counts as ``a.b`` if that is one."""
    found = set()
    tree = ast.parse(path.read_text())
    for node in tree.body if top_level_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide the floor"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in names}
    return found


def arrows() -> dict[int, set[int]]:
    """For each floor, the other ones that its files import from."""
    found: dict[int, set[int]] = {number: set() for number in range(len(FLOORS))}
    for name, path in MODULES.items():
        below = {floor(other) for other in imports(path) if other in MODULES}
        found[floor(name)] |= below - {floor(name)}
    return found


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Some circle of a graph, its first node repeated at the end; empty where there is none."""
    done: set[str] = set()

    def search(node: str, path: list[str]) -> list[str]:
        if node in path:
            return [*path[path.index(node) :], node]
        if node in done:
            return []
        for other in sorted(graph.get(node, ())):
            found = search(other, [*path, node])
            if found:
                return found
        done.add(node)
        return []

    return next((found for node in sorted(graph) if (found := search(node, []))), [])


def drawing() -> str:
    """The floors in mermaid: an arrow where one is needed by another and no third tells it."""
    graph = arrows()
    reached: dict[int, set[int]] = {}
    for number in range(len(FLOORS)):  # from the ground up: what is below is known
        below = {other for other in graph[number] if other < number}
        reached[number] = below.union(*(reached[other] for other in below))
    lines = ["flowchart TB"]
    for number in reversed(range(len(FLOORS))):
        name, what, _ = FLOORS[number]
        lines.append(f'    f{number}["<b>{name}</b><br/>{what}"]')
    for number in reversed(range(len(FLOORS))):
        told = set().union(*(reached[other] for other in graph[number] if other < number))
        lines += [f"    f{number} --> f{other}" for other in sorted(graph[number] - told)]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(f"```mermaid\n{drawing()}\n```\n")
