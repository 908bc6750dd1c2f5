"""The layers of gva_mi: which package may import which, checked and drawn from the code's imports.

A file imports only from its own layer and from layers below. ``tests/test_architecture.py`` checks
this, and ``python docs/layers.py`` prints the drawing in architecture.md.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "gva_mi").rglob("*.py")) + sorted((ROOT / "plugins").rglob("*.py"))

# From the bottom up: name, purpose, packages. A module belongs to the longest prefix that fits.
LAYERS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("core", "errors, files, options, result stamps, workers, libLLVM", ("gva_mi", "gva_mi.core")),
    ("jit", "between Dr.Jit and torch: the lock, frozen kernels, memory", ("gva_mi.jit",)),
    ("splat", "Gaussian splatting: kernels; entry points for torch and Dr.Jit", ("gva_mi.splat",)),
    ("plugins", "Mitsuba plugins: mesh normals, Gaussian splats", ("gva_mi_plugins",)),
    ("body", "SMPL-X, skinning, the built-in body", ("gva_mi.body",)),
    ("mesh", "a mesh rendered by Mitsuba, as a torch function", ("gva_mi.mesh",)),
    ("subject", "the folder of a person's video: read, write, check", ("gva_mi.subject",)),
    ("networks", "landmarks and masks from pictures", ("gva_mi.networks", "gva_mi.matting")),
    ("readers", "files of other programs, as a subject", ("gva_mi.readers",)),
    ("synthetic", "synthetic subjects with ground truth", ("gva_mi.synthetic",)),
    ("prior", "pose prior: error model, motion, anatomy; for both stages", ("gva_mi.prior",)),
    ("observe", "landmarks as evidence of poses; for both stages and the fit", ("gva_mi.observe",)),
    ("stage1", "stage 1: poses of a video, from landmarks", ("gva_mi.stage1",)),
    ("refine", "stage 2: poses refined by masks, normals and landmarks", ("gva_mi.refine",)),
    ("avatar", "Gaussians on a skeleton: the trained model", ("gva_mi.avatar",)),
    ("fit", "training and tracking of an avatar", ("gva_mi.fit",)),
    ("gradcheck", "gradients compared with references", ("gva_mi.gradcheck",)),
    ("evaluate", "metrics and reports of a run", ("gva_mi.evaluate",)),
    ("study", "studies over many subjects", ("gva_mi.study",)),
    ("app", "the steps from a video to an avatar, as functions", ("gva_mi.app",)),
    ("cli", "the command line and the viewer", ("gva_mi.cli", "gva_mi.viewer", "gva_mi.__main__")),
)


def module_name(path: Path) -> str:
    """Return the name under which a file is imported."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[0] == "plugins":
        parts[0] = "gva_mi_plugins"
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in SOURCES}


def layer_of(name: str) -> int:
    """Return the index of a module's layer in LAYERS, or -1 if it has none."""
    best, found = "", -1
    for index, (_, _, prefixes) in enumerate(LAYERS):
        for prefix in prefixes:
            inside = name == prefix or (prefix != "gva_mi" and name.startswith(prefix + "."))
            if inside and len(prefix) > len(best):
                best, found = prefix, index
    return found


def imports(path: Path, *, top_level_only: bool = False) -> set[str]:
    """Return the modules that a file imports; ``from a import b`` is ``a.b`` if that is one."""
    found = set()
    tree = ast.parse(path.read_text())
    for node in tree.body if top_level_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: write imports in full, relative ones hide the layer"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in names}
    return found


def drawing() -> str:
    """Return the layers in mermaid, without the arrows that follow from others."""
    graph: dict[int, set[int]] = {index: set() for index in range(len(LAYERS))}
    for name, path in MODULES.items():
        graph[layer_of(name)] |= {layer_of(other) for other in imports(path) if other in MODULES}
    reached: dict[int, set[int]] = {}
    for index in range(len(LAYERS)):
        below = {other for other in graph[index] if other < index}
        reached[index] = below.union(*(reached[other] for other in below))
    lines = ["flowchart TB"]
    for index in reversed(range(len(LAYERS))):
        name, purpose, _ = LAYERS[index]
        lines.append(f'    {name}["<b>{name}</b><br/>{purpose}"]')
    for index in reversed(range(len(LAYERS))):
        below = sorted(other for other in graph[index] if other < index)
        implied = set().union(*(reached[other] for other in below))
        lines += [f"    {LAYERS[index][0]} --> {LAYERS[o][0]}" for o in below if o not in implied]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(f"```mermaid\n{drawing()}\n```\n")
