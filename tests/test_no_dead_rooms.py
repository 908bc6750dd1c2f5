"""Every public function, class and method is reached from somewhere that is no test.

By name: from another place of the library, from a notebook, or from what README and docs show a
reader. What a folder's ``__all__`` exports is reached by definition, and so is what torch, Dr.Jit
or Mitsuba call by a name of their own.
"""

import ast
import json
import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "gva_mi").rglob("*.py")) + sorted((ROOT / "plugins").rglob("*.py"))
CALLED_FROM_OUTSIDE = {  # by torch's autograd, Dr.Jit's, torch.nn, Mitsuba, the command line
    "forward", "backward", "jvp", "vmap", "setup_context", "eval",
    "render", "render_forward", "render_backward", "aov_names", "to_string",
    "sample", "sample_radiance_difference", "traverse",
    "find_class", "persistent_load", "get_extension", "readline",  # by pickle's machine
    "main", "gradcheck_normals",  # a verb with a hyphen: gva_mi.cli.load knows its file
}  # fmt: skip


def names(tree):
    """How often each name is used, other than by being defined."""
    found = Counter()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            found[node.id] += 1
        elif isinstance(node, ast.Attribute):
            found[node.attr] += 1
        elif isinstance(node, ast.alias):
            found[node.name.rsplit(".")[-1]] += 1
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.update(re.findall(r"^\w+$", node.value))  # getattr, __all__, tables of names
    return found


def shown():
    """What a reader is shown: programs in README and docs, and the notebooks."""
    found = Counter()
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        for program in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
            found.update(re.findall(r"\w+", program))
    for notebook in (ROOT / "notebooks").glob("*.ipynb"):
        for cell in json.loads(notebook.read_text())["cells"]:
            if cell["cell_type"] == "code":
                found.update(re.findall(r"\w+", "".join(cell["source"])))
    return found


TREES = {path: ast.parse(path.read_text()) for path in SOURCES}
USED = sum((names(tree) for tree in TREES.values()), Counter())
SHOWN = shown()


def definitions(tree):
    """Public functions, classes, and the public methods of these."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
        if isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, ast.FunctionDef) and not inner.name.startswith("_"):
                    yield inner


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_whoever_lives_here_is_visited(path):
    alone = []
    for node in definitions(TREES[path]):
        elsewhere = USED[node.name] - names(node)[node.name]
        if not elsewhere and not SHOWN[node.name] and node.name not in CALLED_FROM_OUTSIDE:
            alone.append(f"{node.name} (line {node.lineno})")
    assert not alone, f"only tests reach {', '.join(alone)}: delete it, or give it a caller"


def test_a_dead_function_is_found():
    tree = ast.parse("def alive(): return 1\ndef dead(): return dead()\nx = alive()\n")
    used = names(tree)
    left = [n.name for n in definitions(tree) if not used[n.name] - names(n)[n.name]]
    assert left == ["dead"]
